"""Rest: the seconds of a sensor that count as rest, with faulty stamps and readings."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ticks import COUNT, RATE_HZ, even_s, lost_at_random

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.rest import Rest, RestWindow

START_NS = 1_767_225_600 * 10**9
SEEDS = st.integers(0, 2**32 - 1)


# --- the window ------------------------------------------------------------------------------------------------------


def noisy(count: int, rms_mps2: float = 0.02, seed: int = 1) -> np.ndarray:
    """Readings (n, 3) at rest, up last."""
    return [0.0, 0.0, naive.GRAVITY] + rms_mps2 / np.sqrt(3.0) * np.random.default_rng(seed).standard_normal((count, 3))


def stamps(seconds: np.ndarray) -> np.ndarray:
    """Header stamps (n,) ns."""
    return START_NS + np.rint(seconds * 1e9).astype(np.int64)


def window(rest_s: float = 0.8, patience_s: float = 10.0) -> RestWindow:
    """Such as a conditioner has by default."""
    return RestWindow(rest_s, patience_s, 0.3, 0.05, 1568.0)


def looked(stamps_ns: np.ndarray, samples: np.ndarray, cuts=()) -> tuple[Rest | None, list[str], int, int]:
    """The result of a window: the rest, the faults before it, samples dropped until then, remaining samples."""
    made, faults = window(), []
    parts = list(zip(np.split(stamps_ns, cuts), np.split(samples, cuts), strict=True))
    for n, part in enumerate(parts):
        made.add(*part)
        while True:
            try:
                rest = made.find()
            except InputError as error:
                faults.append(str(error))
                continue
            break
        if rest is not None:
            dropped = made.dropped
            return rest, faults, dropped, made.clear() + sum(len(left) for left, _ in parts[n + 1 :])
    return None, faults, made.dropped, made.collected - made.dropped


def test_rest_is_the_first_still_window():
    samples = noisy(COUNT + 1)
    rest, faults, dropped, left = looked(stamps(even_s(COUNT + 1)), samples)
    assert faults == [] and (dropped, left) == (904, 1)
    assert rest.epoch_ns == START_NS and rest.samples == 904 and not rest.in_motion and not rest.coarse
    assert rest.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-6) and rest.jitter_s < 1e-9
    assert rest.last_time_s == pytest.approx(903 / RATE_HZ, abs=1e-9)
    np.testing.assert_allclose(rest.mean_mps2, samples[:904].mean(axis=0), rtol=1e-12)
    assert rest.last_mps2 == tuple(samples[903])


@pytest.mark.parametrize(("rms_mps2", "still"), [(0.28, True), (0.32, False)])
def test_the_rms_about_the_mean_of_all_axes_decides(rms_mps2, still):
    rest, *_ = looked(stamps(even_s(2000)), noisy(2000, rms_mps2))
    assert (rest is not None) is still


def test_after_patience_motion_is_averaged():
    rest, _, dropped, _ = looked(stamps(even_s(15_000)), noisy(15_000, 2.0))
    assert rest.in_motion and rest.samples == dropped == pytest.approx(10.4 * RATE_HZ, abs=0.4 * RATE_HZ + 1)
    np.testing.assert_allclose(rest.mean_mps2, [0.0, 0.0, naive.GRAVITY], atol=0.1)


@pytest.mark.parametrize("step_s", [0.06, 1.0, 3600.0, -0.06, -0.3, -0.9, -1.1, -3600.0])
def test_no_window_spans_a_break(step_s):
    late = even_s(3000)
    late[500:] += step_s
    rest, _, dropped, _ = looked(stamps(late), noisy(3000))
    assert rest.epoch_ns == stamps(late)[500] and rest.samples == 904 and dropped == 1404


def test_a_few_samples_before_breaks_are_not_kept():
    made, index = window(), np.arange(200_000)
    for part in np.split(index, 200):
        made.add(stamps(part / RATE_HZ + part // 400), noisy(1000))
        assert made.find() is None
        assert made.collected - made.dropped <= 400


@pytest.mark.parametrize("slow_hz", [1.0, 2.0, 4.0, 9.0])
def test_a_slow_sensor_has_a_rest(slow_hz):
    rest, faults, dropped, _ = looked(stamps(even_s(30, slow_hz)), noisy(30))
    assert faults == [] and not rest.in_motion and dropped == 10
    assert rest.period_s == pytest.approx(1.0 / slow_hz, rel=1e-9)


@pytest.mark.parametrize("share", [0.01, 0.2, 0.4])
def test_lost_samples_at_rest_count_as_time(share):
    kept_s = np.append(lost_at_random(share, 3), 0.84)
    rest, _, dropped, left = looked(stamps(kept_s), noisy(len(kept_s)))
    assert (dropped, left) == (COUNT, 1) and rest.samples == len(kept_s) - 1


# --- repeated and coarse stamps --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("behind", "rms_mps2"), [(0, 0.0), (0, 0.02), (1, 0.02), (7, 0.02)])
def test_repeated_samples_count_once(behind, rms_mps2):
    order = np.argsort(np.concatenate([np.arange(1000), np.arange(1000) + behind + 0.5]), kind="stable") % 1000
    rest, _, dropped, _ = looked(stamps(even_s(1000))[order], noisy(1000, rms_mps2)[order])
    assert rest.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-6) and rest.jitter_s < 1e-9
    assert dropped == rest.samples == COUNT and not rest.coarse


@pytest.mark.parametrize("quantum_ms", [1, 2, 10])
@pytest.mark.parametrize("step_mps2", [0.0, 0.0077, 0.0766, 1.0])
def test_readings_that_repeat_within_a_coarse_stamp_are_not_dropped(quantum_ms, step_mps2):
    samples = noisy(1000)
    if step_mps2:
        samples = np.rint(samples / step_mps2) * step_mps2  # of 16 and 12 bits, and one that never changes
    rest, *_ = looked(stamps(even_s(1000)) // (quantum_ms * 10**6) * (quantum_ms * 10**6), samples)
    assert rest.coarse and rest.period_s == pytest.approx(1.0 / RATE_HZ, rel=2e-3)


def test_samples_out_of_order_are_distinguished_from_jitter():
    order = np.argsort(even_s(1000) + np.random.default_rng(4).uniform(0.0, 0.02, 1000), kind="stable")
    disordered, *_ = looked(stamps(even_s(1000))[order], noisy(1000))
    assert disordered.jitter_s < 1e-6  # its stamps are good, and what comes late is late
    jitter_s = np.random.default_rng(4).uniform(0.0, 0.02, 1000)
    jittering, *_ = looked(stamps(even_s(1000) + jitter_s), noisy(1000))
    assert jittering.jitter_s == pytest.approx(0.005, rel=0.1)  # the mean of |uniform| about its mean


# --- faults, and any cut ---------------------------------------------------------------------------------------------

FAULTS = {
    "frozen": (np.full(50_000, START_NS), "stamps stand still"),
    "by turns": (START_NS + np.arange(100_000) % 2, "stamps stand still"),
    "creeping": (START_NS + np.arange(100_000), "stamps stand still"),
    "backward": (START_NS - 1000 * np.arange(100_000), "stamps stand still"),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_stamps_that_stand_still_are_reported_and_dropped(kind):
    stamps_ns, message = FAULTS[kind]
    rest, faults, dropped, left = looked(stamps_ns, noisy(len(stamps_ns)))
    assert rest is None and faults and all(message in fault for fault in faults)
    assert left < 40_000 and dropped + left == len(stamps_ns)


def test_missing_readings_are_reported_after_patience():
    rest, faults, _, _ = looked(stamps(even_s(15_000)), np.full((15_000, 3), np.nan))
    assert rest is None and faults == ["no finite sample arrived: check the sensor"]


@st.composite
def records(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Rest somewhere in a record of breaks, losses, motion, repeated, frozen and disordered stamps."""
    rng = np.random.default_rng(draw(SEEDS))
    samples, stamps_ns = noisy(3000, seed=5), stamps(even_s(3000))
    for kind in draw(
        st.lists(st.sampled_from(["gap", "back", "lost", "moving", "frozen", "swapped", "ahead"]), max_size=5)
    ):
        at, length = int(rng.integers(0, 2000)), int(rng.integers(1, 300))
        if kind in ("gap", "back"):
            stamps_ns[at:] += int(rng.integers(10**7, 3 * 10**9)) * (1 if kind == "gap" else -1)
        elif kind == "lost":
            stamps_ns, samples = (
                np.delete(stamps_ns, slice(at, at + length)),
                np.delete(samples, slice(at, at + length), 0),
            )
        elif kind == "moving":
            samples[at : at + length] += 5.0 * rng.standard_normal(samples[at : at + length].shape)
        elif kind == "frozen":
            stamps_ns[at : at + 5 * length] = stamps_ns[at]
        elif kind == "swapped":
            stamps_ns[at : at + length] = stamps_ns[at : at + length][::-1]
        else:
            stamps_ns[at] += int(rng.integers(1, 10**13))
    return stamps_ns, samples


@settings(max_examples=150)
@given(records(), st.lists(st.integers(0, 3000), max_size=10).map(sorted))
def test_any_cut_gives_the_same_rest(record, cuts):
    assert looked(*record, cuts) == looked(*record)


@settings(max_examples=8)
@given(records())
def test_sample_by_sample_gives_the_same_rest(record):
    assert looked(*record, range(1, len(record[0]))) == looked(*record)
