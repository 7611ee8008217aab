"""Rows of an event compared with sums by hand."""

import dataclasses

import fitting
import hiding
import numpy as np
import pytest

from biodyn_core.identification.problem import Case
from biodyn_core.tracing.nuisance_parameters import TypicalSettings
from biodyn_core.tracing.rows import Products, Rows, WeightSettings

RATE_HZ = fitting.RATE_HZ  # thinned to 300 Hz
USUAL = TypicalSettings()
LOUD = 10.0


def case(measured: np.ndarray, rate_hz: float = RATE_HZ) -> Case:
    """An event in which all segments show the same (n,), behind 2 s of warm-up."""
    begin = round(2.0 * rate_hz)
    compared = np.ones((len(measured), 5), dtype=bool)
    compared[:begin] = False
    whole = np.where(compared, measured[:, None], 0.0)
    return dataclasses.replace(
        hiding.events(6)[0],
        rate_hz=rate_hz,
        seat_mps2=np.zeros(len(measured)),
        measured_mps2=whole,
        compared=compared,
        energy=(whole**2).sum(axis=0),
    )


def steady(seconds: float, rate_hz: float = RATE_HZ) -> np.ndarray:
    """(n,) of constant size, so that all samples have one weight."""
    return np.full(round((2.0 + seconds) * rate_hz), LOUD)


def weight(s: WeightSettings) -> float:
    return 1.0 / np.sqrt(s.noise_mps2**2 + (s.local_share * LOUD) ** 2 + (s.event_share * LOUD) ** 2)


def rows_of(one: Case, answer: np.ndarray | None = None, weights: WeightSettings | None = None) -> Rows:
    return Rows(one, np.zeros_like(one.measured_mps2) if answer is None else answer, weights or WeightSettings(), USUAL)


@pytest.mark.parametrize(("rate_hz", "kept_hz"), [(600.0, 300.0), (300.0, 300.0), (1129.3, 1129.3 / 4.0)])
def test_rows_are_decimated_and_cut_into_whole_windows(rate_hz: float, kept_hz: float) -> None:
    one = case(steady(3.6, rate_hz), rate_hz)
    rows = rows_of(one)
    each = round(kept_hz)
    assert rows.windows == 3
    assert rows(np.ones((len(one.seat_mps2), 5, 2))).shape == (3, each * 5, 2)
    np.testing.assert_array_equal(rows.samples, np.full(3, 5.0 * each))


def test_a_sample_is_in_its_window_and_column() -> None:
    one = case(steady(3.0))
    values = np.zeros((len(one.seat_mps2), 5, 1))
    at = round(2.0 * RATE_HZ) + 2 * 310  # the 11th row of the second window
    values[at, 3, 0] = 1.0
    found = rows_of(one)(values)[:, :, 0].reshape(3, 300, 5)
    assert np.unravel_index(np.argmax(np.abs(found)), found.shape) == (1, 10, 3)
    assert found[1, 10, 3] == pytest.approx(weight(WeightSettings()), rel=0.02)
    assert (found[:, :, [0, 1, 2, 4]] == 0.0).all()


def test_quiet_samples_have_a_larger_weight_and_masked_ones_none() -> None:
    measured = steady(3.0)
    measured[round(3.5 * RATE_HZ) :] = 0.1
    one = case(measured)
    compared = one.compared.copy()
    compared[round(2.5 * RATE_HZ) : round(2.6 * RATE_HZ), 4] = False
    rows = rows_of(dataclasses.replace(one, compared=compared))
    fast = np.tile((-1.0) ** (np.arange(len(measured)) // 2), (5, 1)).T[:, :, None]  # no level, no clock
    size = np.abs(rows(fast)[:, :, 0].reshape(3, 300, 5))
    s, share = WeightSettings(), 0.5
    event = s.event_share * LOUD * np.sqrt(share)
    np.testing.assert_allclose(size[0, 50, 0], 1.0 / np.hypot(np.hypot(s.noise_mps2, 0.04 * LOUD), event), rtol=0.02)
    np.testing.assert_allclose(size[2, 250, 0], 1.0 / np.hypot(s.noise_mps2, event), rtol=0.02)
    assert (size[0, 150:180, 4] == 0.0).all() and rows.samples.tolist() == [1470.0, 1500.0, 1500.0]


def test_a_level_is_removed_up_to_its_prior() -> None:
    one = case(steady(3.0))
    found, s = rows_of(one)(np.ones((len(one.seat_mps2), 5, 1)))[:, :, 0], WeightSettings()
    held = 1.0 / (1.0 + USUAL.usual_level_mps2**2 * 900 * weight(s) ** 2)
    np.testing.assert_allclose(found, weight(s) * held, rtol=1e-9)
    assert held < 0.03


def test_a_linear_level_is_removed_and_a_motion_is_not() -> None:
    one = case(steady(3.0))
    n, begin = len(one.seat_mps2), round(2.0 * RATE_HZ)
    rows, time = rows_of(one), (np.arange(n) - begin) / RATE_HZ
    whole = {"growing": time, "moving": np.sin(2.0 * np.pi * 4.0 * time)}
    left = {
        name: np.linalg.norm(rows(np.tile(v, (5, 1)).T[:, :, None]))
        / (weight(WeightSettings()) * np.sqrt(5.0) * np.linalg.norm(v[begin::2]))
        for name, v in whole.items()
    }
    assert left["growing"] < 0.06 and left["moving"] > 0.98


@pytest.mark.parametrize("independent", [1e-3, 1.0])
def test_a_clock_offset_is_removed_up_to_its_prior(independent: float) -> None:
    """An answer A sin(wt) late by d is off by -d A w cos(wt): 1 / (1 + spread^2 sum of squares) of it remains."""
    s = WeightSettings(independent=independent)
    n, omega, late_s = len(steady(3.0)), 2.0 * np.pi * 5.0, 1e-4
    time = np.arange(n) / RATE_HZ
    answer = np.tile(LOUD * np.sin(omega * time), (5, 1)).T
    late = np.tile(LOUD * np.sin(omega * (time - late_s)), (5, 1)).T
    one = case(steady(3.0))
    found = Rows(one, answer, s, USUAL)((late - answer)[:, :, None])[:, :, 0]
    whole = rows_of(one)((late - answer)[:, :, None])[:, :, 0]  # a model at rest has no clock
    energy = 900 * 0.5 * (LOUD * omega * weight(s)) ** 2
    expected = 1.0 / (1.0 + independent * USUAL.usual_clock_s**2 * energy)
    assert np.linalg.norm(found) / np.linalg.norm(whole) == pytest.approx(expected, rel=0.03, abs=2e-3)


def test_the_residual_is_the_measurement_minus_the_answer() -> None:
    one = hiding.events(6)[1]
    answer = np.random.default_rng(1).standard_normal(one.measured_mps2.shape)
    rows = rows_of(one, answer)
    left = np.where(one.compared, one.measured_mps2 - answer, 0.0)
    np.testing.assert_allclose(rows.residual(answer), rows(left[:, :, None])[:, :, 0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("late_s", [[0.001] * 3, [0.001, -0.001, 0.001]])
def test_a_clock_fitted_by_window_changes_one_segment_and_gives_its_delays(late_s: list) -> None:
    time = np.arange(len(steady(3.0))) / RATE_HZ
    window = np.clip(time.astype(int) - 2, 0, 2)  # of a second, behind the warm-up
    motion, late = (LOUD * np.sin(2.0 * np.pi * 5.0 * (time - d)) for d in (0.0, np.array(late_s)[window]))
    answer = np.tile(motion, (5, 1)).T
    one = case(motion)
    measured = one.measured_mps2.copy()
    measured[:, 2] = np.where(one.compared[:, 2], late, 0.0)
    rows = Rows(dataclasses.replace(one, measured_mps2=measured), answer, WeightSettings(), USUAL)
    left = rows.residual(answer)
    on_time, said_s = rows.clock_corrected(left, 2)
    assert np.linalg.norm(on_time) < 0.05 * np.linalg.norm(left)
    np.testing.assert_allclose(said_s, late_s, rtol=0.05)
    other, said_s = rows.clock_corrected(left, 0)
    np.testing.assert_allclose(other, left, atol=1e-6 * np.abs(left).max())
    assert np.abs(said_s).max() < 1e-8


def test_the_residual_square_is_the_sum_by_window() -> None:
    rng = np.random.default_rng(3)
    columns = [rng.standard_normal((w, 20, 4)) for w in (2, 3)]
    missed = [rng.standard_normal((w, 20)) for w in (2, 3)]
    b = rng.standard_normal(4)
    products = Products.of(columns, missed, [np.full(2, 20.0), np.array([20.0, 20.0, 19.0])], 20)
    slow = [
        sum((missed[e][w][r] - sum(columns[e][w][r][k] * b[k] for k in range(4))) ** 2 for r in range(20))
        for e in range(2)
        for w in range(len(missed[e]))
    ]
    np.testing.assert_allclose(products.residual_square(b), slow, rtol=1e-10)
    assert products.event.tolist() == [0, 0, 1, 1, 1] and products.samples.tolist() == [20.0] * 4 + [19.0]
    assert products.counted.tolist() == [True] * 4 + [False]
