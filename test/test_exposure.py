"""Meters: formulas and closed forms of doses, and streaming, breaks and reset of every meter."""

from __future__ import annotations

import math
from functools import cache

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.exposure.injury import DriMeter, HicMeter
from biodyn_core.exposure.meters import SHORTEST_MSDV_S, Dose, DoseMeter, HorizontalMeter, motion_sickness_mps15
from biodyn_core.exposure.sensor_meters import FIRST_LEVEL_S, SensorMeters
from biodyn_core.exposure.tally import BIN_S
from biodyn_core.pipeline.comparison import ResidualMeter
from biodyn_core.signals.weighting import weighting_sections

RATE_HZ = 1129.3
WINDOW_S = 2.0
LEVEL_S = 5.0 / (2.0 * math.pi * 0.4)
"""Time constant of the slow level by Wk and Wd: five times that of their high-pass."""
SEEDS = st.integers(0, 2**32 - 1)
CUTS = st.lists(st.integers(0, 900), max_size=10).map(sorted)
ROUNDING = 1e-9


def noise(seed: int, seconds: float, rate_hz: float = RATE_HZ, columns: int = 1) -> np.ndarray:
    """Rough riding, m/s^2, with a few shocks."""
    rng = np.random.default_rng(seed)
    values = 3.0 * rng.standard_normal((round(seconds * rate_hz), columns))
    values[rng.integers(0, len(values), 3)] *= 10.0
    return values


def sine(frequency_hz: float, amplitude: float, seconds: float, rate_hz: float = RATE_HZ) -> np.ndarray:
    """A sine, (n, 1)."""
    return amplitude * np.sin(2.0 * np.pi * frequency_hz * np.arange(round(seconds * rate_hz)) / rate_hz)[:, None]


def dose(accel: np.ndarray, weighting: str = "Wk", rate_hz: float = RATE_HZ) -> Dose:
    """The dose of one channel (n,) or (n, 1)."""
    meter = DoseMeter(weighting, rate_hz, 1, WINDOW_S)
    meter.push(accel.reshape(-1, 1))
    return meter.since_reset()[0]


# --- aw, VDV, MTVV ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("weighting", ["Wk", "Wd"])
@pytest.mark.parametrize(("rate_hz", "share"), [(500.0, 1e-3), (RATE_HZ, 2e-4), (4000.0, 1e-4)])
def test_doses_are_those_of_the_weighted_spectrum(weighting, rate_hz, share):
    accel = noise(1, 20.0, rate_hz)[:, 0]
    smooth = np.convolve(accel, np.ones(9) / 9.0, "same")  # vehicles do not shake at the Nyquist frequency
    wanted = naive.weighted(weighting, smooth, rate_hz)
    found = dose(smooth, weighting, rate_hz)
    # share: effect of the filter's error of magnitude and phase (see test_weighting).
    assert found.aw_mps2 == pytest.approx(math.sqrt((wanted**2).mean()), rel=share)
    assert found.vdv_mps175 == pytest.approx(((wanted**4).sum() / rate_hz) ** 0.25, rel=share)
    assert found.peak_mps2 == pytest.approx(np.abs(wanted).max(), rel=3.0 * share)
    assert found.mtvv_linear_mps2 == pytest.approx(naive.linear_running_rms(wanted, rate_hz).max(), rel=share)
    assert found.mtvv_exponential_mps2 == pytest.approx(naive.running_rms(wanted, rate_hz).max(), rel=share)
    assert found.crest_factor == pytest.approx(found.peak_mps2 / found.aw_mps2)
    assert found.seconds == pytest.approx(len(accel) / rate_hz)


@pytest.mark.parametrize(("weighting", "frequency_hz"), [("Wk", 8.0), ("Wk", 1.0), ("Wd", 4.0)])
def test_a_steady_sine_has_the_doses_of_its_weighted_amplitude(weighting, frequency_hz):
    seconds = 200.0
    found = dose(sine(frequency_hz, 2.0, seconds), weighting)
    amplitude = 2.0 * abs(naive.weighting(weighting, frequency_hz))
    # The start takes a second or two of 200: 0.5 %.
    assert found.aw_mps2 == pytest.approx(amplitude / math.sqrt(2.0), rel=5e-3)
    assert found.vdv_mps175 == pytest.approx((3.0 / 8.0 * amplitude**4 * seconds) ** 0.25, rel=5e-3)


SHOCKS = {
    "a half-sine of 10 ms, 8 g": [(-80j, 1j * math.pi / 0.01, 0.2, 0.21)],
    "a half-sine of 100 ms, 2 g": [(-20j, 1j * math.pi / 0.1, 0.2, 0.3)],
    "five cycles of 5 Hz": [(-10j, 2j * math.pi * 5.0, 0.2, 1.2)],
    "a decaying 4 Hz": [(-15j, -6.0 + 2j * math.pi * 4.0, 0.2, math.inf)],
    "a step": [(1.7, 0.0, 0.2, math.inf)],
}


@cache
def closed_form(weighting, shock):
    """The instants of samples, s, and the weighted shock 16 times as often."""
    seconds = 4.0
    # A sampled step has its edge half a sample before its first instant.
    time = 0.2 + (np.arange(-226, round((seconds - 0.2) * RATE_HZ)) + 0.5) / RATE_HZ
    fine = np.arange(time[0], time[-1], 1.0 / (16.0 * RATE_HZ))
    return time, naive.response_to_pulses(*naive.weighting_quotient(weighting), SHOCKS[shock], fine)


@pytest.mark.parametrize("weighting", ["Wk", "Wd", "Wb"])
@pytest.mark.parametrize("shock", SHOCKS)
@pytest.mark.parametrize("cuts", [(), (1, 225, 226, 227, 300, 301, 2000)])
def test_shocks_have_the_doses_of_the_closed_form_however_they_are_cut(weighting, shock, cuts):
    time, wanted = closed_form(weighting, shock)
    meter = DoseMeter(weighting, RATE_HZ, 1, WINDOW_S)
    for part in np.split(naive.pulses(SHOCKS[shock], time)[:, None], cuts):
        meter.push(np.ascontiguousarray(part))
    found = meter.since_reset()[0]
    near = 2e-3 if "10 ms" in shock else 5e-4  # 11 samples do not hold all of a half-sine
    assert found.vdv_mps175 == pytest.approx(((wanted**4).sum() / 16.0 / RATE_HZ) ** 0.25, rel=near)
    assert found.aw_mps2**2 * found.seconds == pytest.approx((wanted**2).sum() / 16.0 / RATE_HZ, rel=2.0 * near)
    assert found.peak_mps2 == pytest.approx(np.abs(wanted).max(), rel=3e-3)  # a peak between two samples


def test_a_step_of_level_raises_mtvv_over_a_second():
    # 16 Hz: the mean square of a sine ripples by 1 / (4 pi 16) = 0.5 % around the exponential.
    amplitude = 3.0 * abs(naive.weighting("Wk", 16.0))
    for seconds in (0.5, 1.0, 2.0, 4.0):
        quiet_then_loud = np.concatenate([np.zeros((2000, 1)), sine(16.0, 3.0, seconds)])
        found, rms = dose(quiet_then_loud), amplitude / math.sqrt(2.0)
        assert found.mtvv_linear_mps2 == pytest.approx(rms * math.sqrt(min(seconds, 1.0)), rel=1.5e-2)
        assert found.mtvv_exponential_mps2 == pytest.approx(rms * math.sqrt(1.0 - math.exp(-seconds)), rel=1.5e-2)


def as_weighted(accel: np.ndarray, rate_hz: float = RATE_HZ) -> Dose:
    """The dose of a signal (n,) that is weighted already."""
    meter = DoseMeter("Wk", rate_hz, 1, WINDOW_S)
    meter._weighting.sos = np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    meter.push(accel[:, None])
    return meter.since_reset()[0]


@pytest.mark.parametrize("rate_hz", [250.0, 250.5, RATE_HZ])
@pytest.mark.parametrize("burst_s", [0.1, 0.5, 1.0, 3.0])
def test_both_mtvv_of_a_rectangular_burst_are_the_closed_form(rate_hz, burst_s):
    samples, rest = round(burst_s * rate_hz), np.zeros(round(2.2 * rate_hz))
    held_s = samples / rate_hz
    found = as_weighted(np.concatenate([rest, np.full(samples, 3.0), rest]), rate_hz)
    assert found.mtvv_linear_mps2 == pytest.approx(3.0 * math.sqrt(min(held_s, 1.0)), rel=ROUNDING)
    assert found.mtvv_exponential_mps2 == pytest.approx(3.0 * math.sqrt(1.0 - math.exp(-held_s)), rel=ROUNDING)
    assert found.mtvv_mps2 == found.mtvv_linear_mps2  # the exponential one is 0.2 to 20 % less


@pytest.mark.parametrize(("frequency_hz", "tau_s"), [(4.0, 0.2), (12.0, 0.09), (2.0, 0.8)])
def test_the_linear_mtvv_of_a_decaying_sine_is_the_closed_form(frequency_hz, tau_s):
    rate_hz, omega = 4000.5, 2.0 * math.pi * frequency_hz
    time = (np.arange(round(3.0 * rate_hz)) + 0.5) / rate_hz
    found = as_weighted(5.0 * np.exp(-time / tau_s) * np.sin(omega * time), rate_hz)
    # The integral of exp(-2 t / tau) sin(w t)^2 over its first second: whole cycles, so no later one holds more.
    rates = complex(2.0 / tau_s, 0.0), complex(2.0 / tau_s, -2.0 * omega)
    level, ripple = ((1.0 - np.exp(-rate)) / rate for rate in rates)
    assert found.mtvv_linear_mps2 == pytest.approx(5.0 * math.sqrt(0.5 * (level - ripple).real), rel=1e-4)


def test_of_shocks_further_apart_than_a_second_the_exponential_mtvv_is_the_larger():
    apart_s, energy = 1.25, 2.0  # of each shock, m^2/s^3
    accel = np.zeros(round(20.0 * 400.0))
    accel[:: round(apart_s * 400.0)] = math.sqrt(energy * 400.0)
    found = as_weighted(accel, 400.0)
    assert found.mtvv_linear_mps2 == pytest.approx(math.sqrt(energy), rel=ROUNDING)
    wanted = math.sqrt(energy / (1.0 - math.exp(-apart_s)))
    assert found.mtvv_exponential_mps2 == pytest.approx(wanted, rel=2e-3)  # decay within a sample
    assert found.mtvv_mps2 == found.mtvv_exponential_mps2 > 1.1 * found.mtvv_linear_mps2


def test_a_shock_that_has_left_the_second_leaves_no_rounding_error():
    meter = DoseMeter("Wk", RATE_HZ, 1, 0.2)
    meter._weighting.sos = np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    meter.push(np.full((300, 1), 1e9))
    meter.push(np.full((round(1.3 * RATE_HZ), 1), 1e-3))
    assert meter.rolling()[0].mtvv_linear_mps2 == pytest.approx(1e-3, rel=ROUNDING)


def test_mtvv_keeps_the_maximum_and_aw_averages():
    loud = dose(sine(16.0, 3.0, 4.0))
    then_quiet = dose(np.concatenate([sine(16.0, 3.0, 4.0), np.zeros((30_000, 1))]))
    assert then_quiet.mtvv_mps2 == pytest.approx(loud.mtvv_mps2, rel=1e-3)  # the filter's ringing
    assert then_quiet.aw_mps2 < 0.5 * loud.aw_mps2
    assert then_quiet.vdv_mps175 == pytest.approx(loud.vdv_mps175, rel=1e-3)  # the filter's ringing


@given(SEEDS, st.floats(-1e3, 1e3).filter(lambda k: abs(k) > 1e-3))
def test_scaling_the_input_scales_every_figure(seed, factor):
    accel = noise(seed, 0.8)
    one, many = dose(accel), dose(factor * accel)
    for name in ("aw_mps2", "mtvv_linear_mps2", "mtvv_exponential_mps2", "vdv_mps175", "peak_mps2"):
        assert getattr(many, name) == pytest.approx(abs(factor) * getattr(one, name), rel=ROUNDING)
    assert many.crest_factor == pytest.approx(one.crest_factor, rel=ROUNDING)
    assert many.seconds == one.seconds


@given(SEEDS, st.integers(1, 900), st.integers(1, 900))
def test_concatenated_records_add_fourth_powers_and_squares(seed, first, second):
    accel = noise(seed, 2.0)[: first + second]
    # After the break the second record counts minus the level that the first has left.
    level = naive.slow_level(accel[:first, 0], RATE_HZ, LEVEL_S)
    apart = [dose(part) for part in (accel[:first], accel[first:] - level)]
    together = dose(np.insert(accel, first, np.nan, axis=0))
    assert together.vdv_mps175**4 == pytest.approx(sum(d.vdv_mps175**4 for d in apart), rel=ROUNDING)
    squares = sum(d.aw_mps2**2 * d.seconds for d in apart)
    assert together.aw_mps2**2 * together.seconds == pytest.approx(squares, rel=ROUNDING)
    assert together.seconds == pytest.approx(sum(d.seconds for d in apart), rel=ROUNDING)
    assert together.peak_mps2 == pytest.approx(max(d.peak_mps2 for d in apart), rel=ROUNDING)
    for name in ("mtvv_linear_mps2", "mtvv_exponential_mps2"):
        assert getattr(together, name) == pytest.approx(max(getattr(d, name) for d in apart), rel=ROUNDING)


def test_a_channel_of_nothing_has_no_crest_factor():
    assert dose(np.zeros(100)).crest_factor is None
    fresh = DoseMeter("Wk", RATE_HZ, 2, WINDOW_S)
    assert [d.seconds for d in fresh.since_reset()] == [0.0, 0.0]
    assert [d.aw_mps2 for d in fresh.rolling()] == [0.0, 0.0]


def test_channels_are_independent():
    accel = noise(3, 1.0, columns=3)
    accel[200, 1] = np.nan
    meter = DoseMeter("Wk", RATE_HZ, 3, WINDOW_S)
    meter.push(accel)
    for found, column in zip(meter.since_reset(), accel.T, strict=True):
        assert found == dose(column.copy())


def test_gravity_that_appears_at_the_first_sample_is_no_exposure():
    rng = np.random.default_rng(4)
    raw = np.tile([0.0, 0.0, naive.GRAVITY], (6000, 1)) + 0.01 * rng.standard_normal((6000, 3))
    stamps = np.rint(np.arange(6000) * 1e9 / RATE_HZ).astype(np.int64)
    levelled = np.concatenate([block.levelled_mps2 for block in Conditioner("seat").push(stamps, raw)])
    after = dose(levelled[:, 2].copy())
    assert after.peak_mps2 < 0.05 and after.mtvv_mps2 < 0.01 and after.vdv_mps175 < 0.02  # the noise alone
    assert dose(raw[:, 2].copy()).vdv_mps175 > 1.0  # what an unconditioned record would have cost


# --- every meter: cuts, breaks, reset, rolling -----------------------------------------------------------------------


class _Residual(ResidualMeter):
    """Takes prediction and measurement as one block, as the other meters do."""

    def __init__(self) -> None:
        super().__init__(RATE_HZ, 2, WINDOW_S)

    def push(self, both):
        super().push(both[:, :2], both[:, 2:])


METERS = {
    "dose": (2, lambda: DoseMeter("Wk", RATE_HZ, 2, WINDOW_S)),
    "horizontal": (2, lambda: HorizontalMeter(RATE_HZ, WINDOW_S)),
    "dri": (1, lambda: DriMeter(RATE_HZ, WINDOW_S)),
    "hic": (3, lambda: HicMeter(RATE_HZ, 0.015, WINDOW_S)),
    "residual": (4, _Residual),
}


def figures(meter) -> list[float]:
    """Every figure of a meter, since reset and rolling."""
    found: list[float] = []
    for rolling in (False, True):
        if isinstance(meter, HorizontalMeter):
            answer = meter.along(np.linspace(0.0, np.pi, 7), rolling=rolling)
        else:
            answer = meter.rolling() if rolling else meter.since_reset()
        found += np.ravel([_numbers(a) if hasattr(a, "__dict__") else a for a in _flat(answer)]).tolist()
    return found


def _numbers(answer) -> list[float]:
    """Every number of a dose or an injury criterion, behind them the windows of HIC."""
    numbers = list(vars(answer).values())
    if isinstance(numbers[-1], dict):
        spans = numbers.pop().values()
        numbers += [edge for span in spans for edge in (span or (math.nan, math.nan))]
    return numbers


def _flat(answer) -> list:
    return list(answer) if isinstance(answer, tuple) else [answer]


def fed(name: str, accel: np.ndarray, cuts: list[int], reset_at: int | None = None):
    """A meter that was given a record in blocks, and reset once it had seen `reset_at` rows."""
    meter = METERS[name][1]()
    for begin, end in zip([0, *cuts], [*cuts, len(accel)], strict=True):
        meter.push(np.ascontiguousarray(accel[begin:end]))
        if end == reset_at:
            meter.reset()
            reset_at = None
    return meter


@pytest.mark.parametrize("name", METERS)
@settings(max_examples=40)
@given(SEEDS, CUTS, st.lists(st.integers(0, 899), max_size=4), st.integers(0, 900))
def test_any_cut_into_blocks_gives_the_same_bits(name, seed, cuts, breaks, reset_at):
    accel = noise(seed, 0.8, columns=METERS[name][0])[:900]
    accel[breaks] = np.nan
    whole = fed(name, accel, [reset_at], reset_at)
    cut = fed(name, accel, sorted([*cuts, reset_at]), reset_at)
    np.testing.assert_array_equal(figures(cut), figures(whole))


def broken(name: str, accel: np.ndarray, at: int, seconds: float | None):
    """A meter that was reset at a break, which is a NaN row in the record, or a known number of seconds behind it."""
    meter = METERS[name][1]()
    meter.push(np.ascontiguousarray(accel[:at]))
    if seconds is None:
        meter.push(np.full((1, accel.shape[1]), np.nan))
    else:
        meter.skip(seconds)
    meter.reset()
    meter.push(np.ascontiguousarray(accel[at:]))
    return meter


BREAKS = st.one_of(st.none(), st.sampled_from([0.0, 0.3 / RATE_HZ, 0.5, 1e5]))


@pytest.mark.parametrize("name", METERS)
@given(SEEDS, st.integers(1, 899), BREAKS)
@settings(max_examples=40)
def test_only_the_level_survives_a_break(name, seed, at, seconds):
    accel = noise(seed, 0.8, columns=METERS[name][0])[:900]
    accel[:at] += 50.0  # a record that ends far from rest
    since_reset = figures(broken(name, accel, at, seconds))
    since_reset = since_reset[: len(since_reset) // 2]
    levels = np.zeros(accel.shape[1])
    if name in ("dose", "horizontal"):
        levels = np.array([naive.slow_level(column, RATE_HZ, LEVEL_S) for column in accel[:at].T])
    fresh = figures(fed(name, accel[at:] - levels, []))[: len(since_reset)]
    # Bins are cut elsewhere, so sums are rounded elsewhere.
    np.testing.assert_allclose(since_reset, fresh, rtol=ROUNDING, atol=1e-12)


@pytest.mark.parametrize("name", METERS)
@settings(max_examples=40)
@given(SEEDS, st.integers(0, 900), st.one_of(st.integers(1, 700), st.just(9999)), st.integers(0, 900))
def test_a_break_of_known_length_is_that_many_missing_samples(name, seed, at, missing, reset_at):
    accel = noise(seed, 0.8, columns=METERS[name][0])[:900]
    skipped, filled = METERS[name][1](), METERS[name][1]()
    for meter in (skipped, filled):
        meter.push(np.ascontiguousarray(accel[:at]))
        if meter is skipped:
            meter.skip(missing / RATE_HZ)
        else:
            meter.push(np.full((missing, accel.shape[1]), np.nan))
        if reset_at < at:
            meter.reset()
        meter.push(np.ascontiguousarray(accel[at:]))
    np.testing.assert_array_equal(figures(skipped), figures(filled))


@pytest.mark.parametrize("name", METERS)
def test_the_rolling_window_moves_on_over_a_break(name):
    accel = noise(3, 0.5, columns=METERS[name][0])
    meter = fed(name, accel, [])
    half = len(figures(meter)) // 2
    before = figures(meter)
    meter.skip(0.5 * WINDOW_S)
    np.testing.assert_allclose(figures(meter), before, rtol=ROUNDING)  # still in the window
    meter.skip(0.5 * WINDOW_S + 2.0 * BIN_S)
    after = np.array(figures(meter))
    np.testing.assert_allclose(after[:half], before[:half], rtol=ROUNDING)  # and since reset it stays
    gone = after[half:][: {"dri": 2, "hic": 3}.get(name)]  # time and bandwidth are no doses
    assert np.isin(gone, [0.0, np.nan]).all() or np.isnan(gone).all()


@pytest.mark.parametrize("name", METERS)
@pytest.mark.parametrize("bins", [0, 1, 4, 9, 500])
def test_the_rolling_window_ends_now_although_the_sensor_is_silent(name, bins):
    length = round(BIN_S * RATE_HZ)
    accel, absent_s = noise(5, 1.0, columns=METERS[name][0])[: 9 * length], bins * length / RATE_HZ
    silent, skipped, present = (fed(name, accel, []) for _ in range(3))
    silent.end_window(absent_s)
    skipped.skip(absent_s)
    np.testing.assert_allclose(figures(silent), figures(skipped), rtol=1e-9)
    silent.end_window(0.0)
    np.testing.assert_array_equal(figures(silent), figures(present))


def test_parts_of_a_sample_add_up_over_many_breaks():
    meter = DriMeter(1000.0, WINDOW_S)
    for _ in range(1000):
        meter.skip(0.0123456)
    meter.push(naive.half_sine(30.0, 0.04, 0.1, 1000.0)[:, None])
    unbroken = DriMeter(1000.0, WINDOW_S)
    unbroken.push(naive.half_sine(30.0, 0.04, 0.1, 1000.0)[:, None])
    wanted = 12.3456 + unbroken.since_reset().time_s
    assert meter.since_reset().time_s == pytest.approx(wanted, abs=0.5001e-3)  # in whole samples


@pytest.mark.parametrize("seconds", [-1e-9, -5.0, math.inf, math.nan])
def test_an_impossible_break_is_refused(seconds):
    meter = DoseMeter("Wk", RATE_HZ, 1, WINDOW_S)
    with pytest.raises(InputError, match="it lasts 0 s or longer"):
        meter.skip(seconds)


@pytest.mark.parametrize("name", METERS)
def test_reset_zeroes_since_reset_and_keeps_rolling(name):
    accel = noise(7, 1.5, columns=METERS[name][0])
    meter, untouched = (fed(name, accel, []) for _ in range(2))
    half = len(figures(meter)) // 2
    meter.reset()
    after = np.array(figures(meter))
    counted = after[:half][~np.isnan(after[:half])]
    bandwidth = RATE_HZ / 2.0  # the only figure that is no result
    assert ((counted == 0.0) | (counted == bandwidth)).all()
    if name == "dri":
        after[-1], untouched._seen[1] = 0.0, 0  # its time counts since reset
    np.testing.assert_allclose(after[half:], figures(untouched)[half:], rtol=ROUNDING)


# --- effect of a tilt after a break ----------------------------------------------------------------------------------


def leaning(at_s: float, seconds: float, rate_hz: float = RATE_HZ) -> np.ndarray:
    """The horizontal acceleration of a body that tilts by 10 degrees within a second, (n,)."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    return naive.GRAVITY * math.sin(math.radians(10.0)) * np.clip(time - at_s, 0.0, 1.0)


def behind_a_break(meter, accel: np.ndarray, at_s: float, gap_s: float) -> float:
    """VDV of a record (n, c) whose middle is lost."""
    begin, end = round(at_s * RATE_HZ), round((at_s + gap_s) * RATE_HZ)
    meter.push(np.ascontiguousarray(accel[:begin]))
    meter.skip(gap_s)
    meter.push(np.ascontiguousarray(accel[end:]))
    return vdv_of(meter)


def vdv_of(meter) -> float:
    """VDV of one channel, or along the first axis."""
    return float(meter.along([0.0])[1][0]) if isinstance(meter, HorizontalMeter) else meter.since_reset()[0].vdv_mps175


@pytest.mark.parametrize("plane", [False, True])
def test_a_settled_tilt_adds_no_dose_behind_a_break(plane):
    def fresh():
        return HorizontalMeter(RATE_HZ, WINDOW_S) if plane else DoseMeter("Wd", RATE_HZ, 1, WINDOW_S)

    lean = leaning(2.0, 40.0)[:, None] * np.ones((1, 1 + plane))
    whole = fresh()
    whole.push(lean)
    for gap_s in (0.05, 1.0, 10.0):
        assert behind_a_break(fresh(), lean, 25.0, gap_s) == pytest.approx(vdv_of(whole), rel=1e-6)
    step = fresh()
    step.push(np.ascontiguousarray(lean[-10 * 1129 :]))
    assert vdv_of(step) > 0.7 > 2.0 * vdv_of(whole)  # what every break would cost that starts from zero


@pytest.mark.parametrize("behind_s", [0.5, 1.0, 2.0])
def test_an_unsettled_tilt_adds_less_dose_than_a_start_from_zero(behind_s):
    lean = leaning(2.0, 20.0)
    found = behind_a_break(DoseMeter("Wd", RATE_HZ, 1, WINDOW_S), lean[:, None], 3.0 + behind_s, 0.5)
    from_zero = dose(lean[round((3.5 + behind_s) * RATE_HZ) :], "Wd").vdv_mps175
    # The remaining step is that of the first-order mean, largest right after the tilt.
    left = math.exp(-(0.5 + behind_s) / LEVEL_S)
    leant = dose(lean[: round((3.0 + behind_s) * RATE_HZ)], "Wd").vdv_mps175
    assert found <= (leant**4 + (1.05 * left * from_zero) ** 4) ** 0.25 < from_zero


def in_a_bend(seconds: float, bend_mps2: float) -> np.ndarray:
    """Slow vibration in the plane, (n, 2), with the steady acceleration of a bend along its first axis."""
    ride = np.hstack([sine(1.5, 0.3, seconds), sine(2.5, 0.2, seconds)])
    return ride + np.array([bend_mps2, 0.0])


@pytest.mark.parametrize("plane", [False, True])
def test_a_run_that_begins_in_a_bend_has_the_dose_of_its_vibration(plane):
    def fresh():
        return HorizontalMeter(RATE_HZ, WINDOW_S) if plane else DoseMeter("Wd", RATE_HZ, 2, WINDOW_S)

    straight, begun, from_zero = fresh(), fresh(), fresh()
    straight.push(in_a_bend(30.0, 0.0))
    bent = in_a_bend(30.0, 2.0)
    begun.begin(bent[: math.ceil(FIRST_LEVEL_S * RATE_HZ)])
    for meter in (begun, from_zero):
        meter.push(bent)
    assert vdv_of(begun) == pytest.approx(vdv_of(straight), rel=0.02)
    assert vdv_of(from_zero) > 1.3 * vdv_of(straight)


def block_of(rows: np.ndarray, begins_run: bool = False) -> Block:
    """Levelled samples as a block, with nothing else."""
    none = np.empty(0)
    return Block(none.astype(np.int64), none, rows, none, begins_run, 0.0, 0, RATE_HZ, 100.0)


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(0, 11_000), max_size=8).map(sorted), reads=st.integers(0, 8))
def test_the_first_level_is_the_same_for_any_cut_and_any_reading(cuts, reads):
    rows = np.hstack([in_a_bend(10.0, 2.0), sine(5.0, 1.0, 10.0) - 0.4])
    whole, cut = (SensorMeters("seat", RATE_HZ, WINDOW_S, begins_in_motion=True) for _ in range(2))
    whole.push(block_of(rows))
    for i, part in enumerate(np.split(rows, cuts)):
        cut.push(block_of(part))
        if i <= reads:
            cut.vertical(), cut.plane().along([0.0])
    assert cut.vertical() == whole.vertical()
    assert cut.plane().along([0.3])[1] == whole.plane().along([0.3])[1]


def test_a_checkpoint_or_a_reset_does_not_end_the_wait_for_the_first_level():
    rows = np.hstack([in_a_bend(10.0, 2.0), sine(5.0, 1.0, 10.0)])
    whole, stored, reset = (SensorMeters("seat", RATE_HZ, WINDOW_S, begins_in_motion=True) for _ in range(3))
    at = round(0.7 * RATE_HZ)
    whole.push(block_of(rows))
    stored.push(block_of(rows[:at]))
    assert not stored.totals()["vertical"].any()
    stored.push(block_of(rows[at:]))
    assert stored.vertical() == whole.vertical() and stored.plane().along([0.3])[1] == whole.plane().along([0.3])[1]
    reset.push(block_of(rows[:at]))
    reset.reset()
    reset.push(block_of(rows[at:]))
    assert reset.vertical().seconds == pytest.approx(10.0 - at / RATE_HZ)
    assert vdv_of(reset.plane()) == pytest.approx(vdv_of(whole.plane()), rel=0.05)


def test_the_first_readings_wait_for_their_level_and_are_counted_all_the_same():
    rows = np.hstack([in_a_bend(1.5, 2.0), sine(5.0, 1.0, 1.5)])
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S, begins_in_motion=True)
    meters.push(block_of(rows))
    assert not meters.has_level and meters.vertical().seconds == 0.0
    meters.push(block_of(rows, begins_run=True))
    assert meters.has_level and meters.vertical().seconds == pytest.approx(3.0, abs=2.0 / RATE_HZ)


@pytest.mark.parametrize("weighting", ["Wk", "Wd"])
@pytest.mark.parametrize(("length_s", "gap_s"), [(0.02, 0.005), (0.1, 0.03), (1.0, 0.2)])
def test_a_gap_in_the_middle_of_a_shock_adds_nothing_to_it(weighting, length_s, gap_s):
    shock = naive.half_sine(60.0, length_s, 6.0, RATE_HZ)
    found = behind_a_break(DoseMeter(weighting, RATE_HZ, 1, WINDOW_S), shock[:, None], 0.02 + 0.4 * length_s, gap_s)
    end = round((0.02 + 0.4 * length_s) * RATE_HZ), round((0.02 + 0.4 * length_s + gap_s) * RATE_HZ)
    parts = [dose(part, weighting).vdv_mps175 for part in (shock[: end[0]], shock[end[1] :])]
    from_zero = sum(part**4 for part in parts) ** 0.25
    assert found < 1.01 * from_zero


@pytest.mark.parametrize("lost", [1e12, 1e200, -1e200, math.inf])
@pytest.mark.parametrize("name", ["dose", "horizontal"])
def test_a_model_that_has_diverged_leaves_no_more_than_1_g_behind_the_break(name, lost):
    columns = METERS[name][0]
    meter = METERS[name][1]()
    with np.errstate(all="ignore"):  # where kernels run uncompiled
        meter.push(np.full((1, columns), lost))
    meter.push(np.full((1, columns), np.nan))
    meter.reset()
    rest = noise(1, 3.0, columns=columns)
    meter.push(rest)
    half = len(figures(meter)) // 2
    fresh = figures(fed(name, rest, []))[:half]
    # One sample of 1 g is a level of 4 mm/s^2.
    np.testing.assert_allclose(figures(meter)[:half], fresh, rtol=1e-2)


def test_the_running_mean_square_behind_a_break_is_a_lower_bound():
    loud = sine(16.0, 3.0, 6.0)
    whole = dose(loud)
    meter = DoseMeter("Wk", RATE_HZ, 1, WINDOW_S)
    for part in np.array_split(loud, 6):
        meter.push(np.ascontiguousarray(part))
        meter.skip(0.0)
    broken_up = meter.since_reset()[0]
    share = broken_up.mtvv_exponential_mps2 / whole.mtvv_exponential_mps2
    assert 0.7 < share < 0.85  # sqrt(1 - 1/e) = 0.80
    assert broken_up.mtvv_linear_mps2 <= whole.mtvv_linear_mps2 * (1.0 + ROUNDING)


# --- motion sickness -------------------------------------------------------------------------------------------------


def sickness(accel: np.ndarray, rate_hz: float, cuts: tuple[int, ...] = ()):
    """The motion sickness dose of a vertical (n,)."""
    meter = DoseMeter("Wf", rate_hz, 1, WINDOW_S)
    for part in np.split(accel[:, None], cuts):
        meter.push(np.ascontiguousarray(part))
    return motion_sickness_mps15(meter.since_reset()[0])


@pytest.mark.parametrize("rate_hz", [250.0, 500.0, RATE_HZ, 4000.0])
@pytest.mark.parametrize("frequency_hz", [0.1, 0.167, 0.5])
def test_msdv_of_a_slow_sine_is_its_weighted_amplitude_times_the_root_of_half_the_time(rate_hz, frequency_hz):
    seconds = 600.0
    found = sickness(sine(frequency_hz, 1.5, seconds, rate_hz)[:, 0], rate_hz)
    wanted = 1.5 * abs(naive.weighting("Wf", frequency_hz)) * math.sqrt(seconds / 2.0)
    assert found == pytest.approx(wanted, rel=5e-3)  # the start is a few seconds of 600
    # With its start the answer is exact.
    time = np.arange(round(seconds * 20.0)) / 20.0
    pieces = [(-1.5j, 2j * math.pi * frequency_hz, 0.0, math.inf)]
    closed = naive.response_to_pulses(*naive.weighting_quotient("Wf"), pieces, time)
    assert found == pytest.approx(math.sqrt((closed**2).sum() / 20.0), rel=5e-4)


@settings(max_examples=10)
@given(st.lists(st.integers(0, 30_000), max_size=6).map(sorted), SEEDS)
def test_msdv_is_the_same_for_any_cut(cuts, seed):
    accel = noise(seed, 120.0, 250.0)[:, 0]
    assert sickness(accel, 250.0, tuple(cuts)) == sickness(accel, 250.0)


def test_a_short_record_has_no_msdv_and_a_break_does_not_lengthen_it():
    meter = DoseMeter("Wf", 250.0, 1, WINDOW_S)
    meter.push(sine(0.2, 1.0, SHORTEST_MSDV_S - 1.0, 250.0))
    meter.skip(1000.0)
    assert motion_sickness_mps15(meter.since_reset()[0]) is None
    meter.push(sine(0.2, 1.0, 1.0, 250.0))
    assert motion_sickness_mps15(meter.since_reset()[0]) > 1.0
    meter.reset()
    assert motion_sickness_mps15(meter.since_reset()[0]) is None


def test_a_tilt_adds_no_motion_sickness_dose_behind_a_break():
    sway = 0.3 * sine(0.167, 1.0, 300.0, 250.0) + leaning(20.0, 300.0, 250.0)[:, None]
    whole = sickness(sway[:, 0], 250.0)
    meter = DoseMeter("Wf", 250.0, 1, WINDOW_S)
    for part in np.split(sway, [100 * 250, 200 * 250]):
        meter.push(np.ascontiguousarray(part))
        meter.skip(0.0)
    assert motion_sickness_mps15(meter.since_reset()[0]) == pytest.approx(whole, rel=0.02)  # two starts amid the sway


# --- reset, rolling --------------------------------------------------------------------------------------------------


def test_mtvv_since_a_reset_is_without_what_was_before():
    """A jolt, half a second of rest, a reset, and then rest: a running rms cannot exceed the largest value."""
    rate_hz = 1000.0
    accel = np.zeros((12000, 1))
    accel[1000:1100, 0] = 30.0 * np.sin(np.pi * np.arange(100) / 100.0)
    accel[1600:, 0] += 0.05 * np.random.default_rng(1).standard_normal(10400)
    meter = DoseMeter("Wk", rate_hz, 1, 60.0)
    meter.push(accel[:1600])
    (before,) = meter.since_reset()
    meter.reset()
    meter.push(accel[1600:])
    (found,) = meter.since_reset()
    assert found.mtvv_mps2 < found.peak_mps2 < 0.2 * before.mtvv_mps2


def test_filters_and_oscillators_continue_over_a_reset():
    accel = noise(8, 2.0)
    sections = naive.weighted("Wk", np.convolve(accel[:, 0], np.ones(9) / 9.0, "same"), RATE_HZ)
    meter = DoseMeter("Wk", RATE_HZ, 1, WINDOW_S)
    smooth = np.convolve(accel[:, 0], np.ones(9) / 9.0, "same")[:, None]
    meter.push(smooth[:1000])
    meter.reset()
    meter.push(smooth[1000:])
    wanted = math.sqrt((sections[1000:] ** 2).mean())
    assert meter.since_reset()[0].aw_mps2 == pytest.approx(wanted, rel=5e-3)  # a fresh filter would be 5 % off and more
    swinging = DriMeter(RATE_HZ, WINDOW_S)
    swinging.push(naive.half_sine(50.0, 0.05, 0.07, RATE_HZ)[:, None])
    swinging.reset()
    swinging.push(np.zeros((200, 1)))
    assert swinging.since_reset().compression > 1.0


class Bins:
    """The rolling window's bins, stored as index ranges."""

    def __init__(self, window_s: float) -> None:
        self.length = round(BIN_S * RATE_HZ)
        self.kept = math.ceil(window_s * RATE_HZ / self.length)
        self.closed, self.begin, self.end = [], 0, 0

    def push(self, count: int) -> None:
        """Let samples come."""
        for _ in range(count):
            self.end += 1
            if self.end - self.begin == self.length:
                self.close()

    def close(self) -> None:
        """End the bin here."""
        self.closed.append((self.begin, self.end))
        self.begin = self.end

    @property
    def span(self) -> slice:
        """The samples in the window."""
        recent = self.closed[-self.kept :]
        return slice(recent[0][0] if recent else 0, self.end)


@settings(max_examples=50)
@given(SEEDS, st.lists(st.tuples(st.integers(0, 700), st.booleans()), min_size=1, max_size=8), st.floats(0.3, 1.5))
def test_rolling_figures_are_those_of_the_last_bins(seed, pieces, window_s):
    accel = noise(seed, 8 * 700 / RATE_HZ)
    meter, bins = DoseMeter("Wk", RATE_HZ, 1, window_s), Bins(window_s)
    at, resets = 0, []
    for count, reset in pieces:
        meter.push(np.ascontiguousarray(accel[at : at + count]))
        bins.push(count)
        at += count
        if reset:
            meter.reset()
            resets.append(at)
    weighted = filtered(accel[:at])
    span = weighted[bins.span]
    # The running averages begin again at a reset.
    linear, exponential = (
        np.concatenate([running(part, RATE_HZ) for part in np.split(weighted, resets) if part.size] or [span])[
            bins.span
        ]
        for running in (naive.linear_running_rms, naive.running_rms)
    )
    found = meter.rolling()[0]
    assert found.seconds == pytest.approx(len(span) / RATE_HZ)
    if len(span):
        assert found.aw_mps2 == pytest.approx(math.sqrt((span**2).mean()), rel=ROUNDING)
        assert found.vdv_mps175 == pytest.approx(((span**4).sum() / RATE_HZ) ** 0.25, rel=ROUNDING)
        assert found.peak_mps2 == pytest.approx(np.abs(span).max(), rel=ROUNDING)
        assert found.mtvv_linear_mps2 == pytest.approx(linear.max(), rel=ROUNDING)
        assert found.mtvv_exponential_mps2 == pytest.approx(exponential.max(), rel=ROUNDING)


@settings(max_examples=40)
@given(SEEDS, st.lists(st.integers(0, 300), min_size=1, max_size=30), st.floats(0.2, 1.5))
def test_resets_change_no_rolling_dose(seed, pieces, window_s):
    accel = noise(seed, 30 * 300 / RATE_HZ)
    meter, plain, at = DoseMeter("Wk", RATE_HZ, 1, window_s), DoseMeter("Wk", RATE_HZ, 1, window_s), 0
    for number, count in enumerate(pieces):
        for one in (meter, plain):
            one.push(np.ascontiguousarray(accel[at : at + count]))
            if number % 5 == 4:
                one.skip(0.03 * number)
        at += count
        meter.reset()
        found, expected = meter.rolling()[0], plain.rolling()[0]
        for field in ("aw_mps2", "vdv_mps175", "peak_mps2", "seconds"):
            assert getattr(found, field) == pytest.approx(getattr(expected, field), rel=1e-12), field
        assert meter.since_reset()[0].seconds == 0.0


def filtered(accel: np.ndarray) -> np.ndarray:
    """The package's sections filtered by SciPy; test_weighting checks the sections."""
    return signal.sosfilt(weighting_sections("Wk", RATE_HZ), accel[:, 0]) if len(accel) else np.empty(0)


@pytest.mark.parametrize("window_s", [0.5, 3.0])
def test_a_shock_leaves_the_rolling_window(window_s):
    meters = [
        DoseMeter("Wk", RATE_HZ, 1, window_s),
        DriMeter(RATE_HZ, window_s),
        HicMeter(RATE_HZ, 0.015, window_s),
    ]
    shock = naive.half_sine(80.0, 0.04, 0.1, RATE_HZ)[:, None]
    for meter, columns in zip(meters, (1, 1, 3), strict=True):
        meter.push(np.repeat(shock, columns, axis=1))
        meter.push(np.zeros((round((window_s + 1.0) * RATE_HZ), columns)))
    assert meters[0].rolling()[0].peak_mps2 < 0.2 * meters[0].since_reset()[0].peak_mps2
    assert meters[1].rolling().compression < 0.05 * meters[1].since_reset().compression
    assert meters[2].rolling().vertical == 0.0 < meters[2].since_reset().vertical


# --- horizontal ------------------------------------------------------------------------------------------------------


@given(SEEDS, st.floats(-10.0, 10.0))
def test_a_direction_is_the_rotated_plane(seed, angle):
    accel = noise(seed, 0.7, columns=2)
    meter = HorizontalMeter(RATE_HZ, WINDOW_S)
    meter.push(accel)
    along = accel @ [math.cos(angle), math.sin(angle)]
    wanted = dose(along, "Wd")
    for rolling in (False, True):
        aw, vdv = meter.along([angle], rolling=rolling)
        assert aw[0] == pytest.approx(wanted.aw_mps2, rel=1e-7)  # moments cancel where little moves that way
        assert vdv[0] == pytest.approx(wanted.vdv_mps175, rel=1e-6)


@given(SEEDS)
def test_half_a_turn_changes_nothing(seed):
    meter = HorizontalMeter(RATE_HZ, WINDOW_S)
    meter.push(noise(seed, 0.5, columns=2))
    angles = np.linspace(0.0, np.pi, 13)
    np.testing.assert_allclose(meter.along(angles), meter.along(angles + np.pi), rtol=1e-9)


def test_motion_along_one_line_has_no_dose_across_it():
    meter = HorizontalMeter(RATE_HZ, WINDOW_S)
    meter.push(noise(1, 1.0) * [[math.cos(0.7), math.sin(0.7)]])
    aw, vdv = meter.along([0.7, 0.7 + np.pi / 2.0])
    assert aw[0] > 0.1 and vdv[0] > 0.1
    assert aw[1] < 1e-6 * aw[0] and vdv[1] < 1e-3 * vdv[0]  # the root and the fourth root of rounding


def test_one_missing_axis_is_a_break_for_both():
    accel = noise(2, 0.5, columns=2)
    both, one = accel.copy(), accel.copy()
    both[100], one[100, 1] = np.nan, np.nan
    meters = [fed("horizontal", record, []) for record in (both, one)]
    assert figures(meters[0]) == figures(meters[1])


# --- residual --------------------------------------------------------------------------------------------------------


def test_residual_is_the_rms_over_common_rows():
    rng = np.random.default_rng(9)
    predicted, measured = rng.standard_normal((2, 500, 3))
    predicted[10:30, 0], measured[20:40, 0], measured[:, 2] = np.nan, np.nan, np.nan
    meter = ResidualMeter(RATE_HZ, 3, WINDOW_S)
    meter.push(predicted, measured)
    rms, percent = meter.since_reset()
    for channel in (0, 1):
        both = ~np.isnan(predicted[:, channel] - measured[:, channel])
        gap, truth = (predicted - measured)[both, channel], measured[both, channel]
        assert rms[channel] == pytest.approx(math.sqrt((gap**2).mean()), rel=ROUNDING)
        assert percent[channel] == pytest.approx(100.0 * np.linalg.norm(gap) / np.linalg.norm(truth), rel=ROUNDING)
    assert np.isnan(rms[2]) and np.isnan(percent[2])


def test_a_perfect_prediction_leaves_no_residual():
    measured = noise(1, 0.5, columns=2)
    meter = ResidualMeter(RATE_HZ, 2, WINDOW_S)
    meter.push(measured, measured)
    for figure in (*meter.since_reset(), *meter.rolling()):
        np.testing.assert_array_equal(figure, 0.0)
