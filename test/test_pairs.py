"""Check of two channels of one structure: own faults on coloured noise, answers known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import interpolate, signal

from biodyn_core.base.errors import InputError
from biodyn_core.sensor_pairs import pairs

Floats = NDArray[np.float64]

RATE_HZ = 250.0
SECONDS = 12.0
BACKGROUND = 0.1


def coloured(count: int, rng: np.random.Generator, most_hz: float = 40.0) -> Floats:
    """Noise (count, 3) from 1 Hz on that fades above most_hz, 3 m/s^2 rms."""
    sos = signal.butter(2, (1.0, most_hz), "bandpass", fs=RATE_HZ, output="sos")
    made = signal.sosfilt(sos, rng.standard_normal((count, 3)), axis=0)
    return 3.0 * made / made.std(axis=0)


def two_stretches(seed: int) -> tuple[pairs.Pair, pairs.Pair]:
    """An earlier and a later stretch: a mount that rings at 45 Hz, some crosstalk, 10 % that the reference lacks."""
    rng = np.random.default_rng(seed)
    count = round(SECONDS * RATE_HZ)
    reference = coloured(2 * count, rng)
    b, a = signal.bilinear([2.0 * 0.4 * 283.0, 283.0**2], [1.0, 2.0 * 0.4 * 283.0, 283.0**2], RATE_HZ)
    up = signal.lfilter(b, a, 0.95 * reference[:, 2] + 0.08 * reference[:, 0])
    loudness = 0.5 + np.arange(2 * count) % (2 * round(RATE_HZ)) / (2 * RATE_HZ)  # the rest follows no bell curve
    up += BACKGROUND * loudness * coloured(2 * count, rng)[:, 0]
    own = reference[:, :2] + BACKGROUND * coloured(2 * count, rng)[:, :2]
    earlier, later = (
        pairs.Pair(RATE_HZ, reference[part], up[part] + 9.81, own[part])
        for part in (slice(0, count), slice(count, 2 * count))
    )
    return earlier, later


def late(values: Floats, late_s: Floats | float) -> Floats:
    time_s = np.arange(values.size) / RATE_HZ
    return interpolate.CubicSpline(time_s, values)(np.clip(time_s - late_s, 0.0, time_s[-1]))


def checked(seed: int, change: Callable[[pairs.Pair], Floats], keep_own: bool = True) -> pairs.PairCheck:
    """The check of a later stretch whose channel under test a function has changed."""
    earlier, later = two_stretches(seed)
    own = later.own if keep_own else None
    before = earlier if keep_own else dataclasses.replace(earlier, own=None)
    changed = dataclasses.replace(later, under_test=change(later), own=own)
    return pairs.check(changed, before, seed=seed)


def test_nothing_is_found_without_a_fault() -> None:
    found = [checked(seed, lambda pair: pair.under_test) for seed in range(4)]
    assert [one.verdict for one in found].count("none") >= 3
    for one in found:
        assert one.before_percent == one.after_percent
        assert 80.0 * BACKGROUND < one.before_percent < 160.0 * BACKGROUND
        assert set(one.gains or {}) == {"clock", "drift", "gain", "tilt", "skin"}


@cache
def louder(gain: float) -> pairs.PairCheck:
    """The check of a channel that reads too much."""
    return checked(1, lambda pair: (1.0 + gain) * pair.under_test)


@pytest.mark.parametrize("gain", [-0.08, 0.06])
def test_the_size_of_a_gain_is_within_a_few_percent(gain: float) -> None:
    found = louder(gain)
    assert (found.verdict, found.name, found.unit) == ("effect", "gain", "")
    assert found.size == pytest.approx(gain, abs=0.006)
    assert found.after_percent < found.before_percent
    assert found.after_percent == pytest.approx(found.background_percent, rel=0.2)


@pytest.mark.parametrize("gain", [0.33, -0.33, 0.06])
def test_the_interval_of_a_fault_beyond_the_searched_range_has_no_outer_end(gain: float) -> None:
    """The search ends at gains of 30 %."""
    found = louder(gain)
    inner, outer = (found.lower, found.upper) if gain > 0.0 else (found.upper, found.lower)
    assert (found.verdict, found.name) == ("effect", "gain")
    assert found.lower <= gain <= found.upper
    assert math.isfinite(inner) and math.isinf(outer) == (gain != 0.06)


@pytest.mark.parametrize("late_s", [-0.004, 0.0015])
def test_a_clock_is_found_to_a_fifth_of_a_millisecond(late_s: float) -> None:
    found = checked(2, lambda pair: late(pair.under_test, late_s))
    assert found.name == "clock"
    assert set(found.ambiguous_with) <= {"skin"}  # a stiff skin is a delay
    assert found.size == pytest.approx(late_s, abs=0.0002)


def test_a_drift_is_distinguished_from_a_clock_offset() -> None:
    found = checked(3, lambda pair: late(pair.under_test, 2.5e-4 * np.arange(pair.under_test.size) / RATE_HZ))
    assert (found.name, found.unit) == ("drift", "s/s")
    assert found.size == pytest.approx(2.5e-4, abs=3e-5)


def test_a_tilt_is_found_with_the_other_axes_of_the_sensor() -> None:
    def lean(pair: pairs.Pair) -> Floats:
        assert pair.own is not None
        return pair.under_test * np.cos(0.12) + np.sin(0.12) * pair.own[:, 0]

    found = checked(4, lean)
    assert (found.verdict, found.name, found.unit) == ("effect", "tilt", "rad")
    assert found.size == pytest.approx(0.12, abs=0.02)
    without = checked(4, lean, keep_own=False)
    assert without.name != "tilt"
    assert "tilt" not in (without.gains or {})


@pytest.mark.parametrize("pole_hz", [20.0, 45.0])
def test_a_first_order_skin_is_found_by_the_overdamped_one(pole_hz: float) -> None:
    def soft(pair: pairs.Pair) -> Floats:
        b, a = signal.bilinear([1.0], [1.0 / (2.0 * np.pi * pole_hz), 1.0], RATE_HZ)
        return np.asarray(signal.lfilter(b, a, pair.under_test - 9.81)) + 9.81

    found = checked(5, soft)
    assert (found.name, found.unit) == ("skin", "s")
    assert found.size == pytest.approx(1.0 / (2.0 * np.pi * pole_hz), rel=0.15)


def test_clipping_is_found_in_raw_samples_and_masked() -> None:
    found = checked(6, lambda pair: np.clip(pair.under_test, -14.0, 14.0))
    assert (found.verdict, found.name, found.size, found.unit) == ("effect", "saturation", 14.0, "m/s^2")
    assert found.after_percent < 0.5 * found.before_percent


def test_only_a_limit_reached_often_is_clipping() -> None:
    rng = np.random.default_rng(0)
    smooth = coloured(5000, rng)[:, 0]
    assert not pairs.clipped_samples(smooth).any()
    assert not pairs.clipped_samples(np.round(smooth * 4.0) / 4.0).any()  # coarse steps
    assert not pairs.clipped_samples(np.concatenate([np.zeros(60), smooth + 30.0])).any()  # a late start
    limited = np.minimum(smooth, 5.0)
    np.testing.assert_array_equal(pairs.clipped_samples(limited), limited == 5.0)


def test_without_an_earlier_stretch_only_a_drift_is_found() -> None:
    _, later = two_stretches(7)
    scaled = pairs.check(dataclasses.replace(later, under_test=1.1 * later.under_test))
    assert scaled.verdict == "not_decidable"
    assert "are part of the transfer" in scaled.reason
    drifting = late(later.under_test, 4e-4 * np.arange(later.under_test.size) / RATE_HZ)
    found = pairs.check(dataclasses.replace(later, under_test=drifting))
    assert (found.verdict, found.name) == ("ambiguous", "drift")
    assert found.size == pytest.approx(4e-4, abs=8e-5)


def test_a_changed_structure_is_unexplained_and_an_unrelated_one_not_decidable() -> None:
    earlier, later = two_stretches(8)
    rng = np.random.default_rng(8)
    other = coloured(later.under_test.size, rng)[:, 0]
    found = pairs.check(dataclasses.replace(later, under_test=later.under_test + 0.4 * other), earlier)
    assert (found.verdict, found.name) == ("unexplained", "")
    strange = dataclasses.replace(earlier, under_test=coloured(earlier.under_test.size, rng)[:, 0])
    assert pairs.check(later, strange).verdict == "not_decidable"


def test_short_stretches_are_not_decidable_and_other_channels_are_refused() -> None:
    earlier, later = two_stretches(9)
    short = pairs.Pair(RATE_HZ, later.reference[:500], later.under_test[:500])
    assert pairs.check(short, earlier).verdict == "not_decidable"
    with pytest.raises(InputError, match="another rate"):
        pairs.check(later, dataclasses.replace(earlier, rate_hz=500.0))
    with pytest.raises(InputError, match="differ in length"):
        pairs.Pair(RATE_HZ, later.reference[:-1], later.under_test)
    with pytest.raises(InputError, match="not finite"):
        pairs.Pair(RATE_HZ, later.reference * np.nan, later.under_test)


def test_a_dead_or_saturated_channel_is_not_explained() -> None:
    earlier, later = two_stretches(10)
    dead = pairs.check(dataclasses.replace(later, under_test=np.full_like(later.under_test, 9.81)), earlier)
    assert (dead.verdict, dead.name) == ("unexplained", "")
    flat = pairs.check(dataclasses.replace(later, under_test=np.clip(later.under_test, 9.7, 9.9)), earlier)
    assert (flat.verdict, flat.name) == ("effect", "saturation")
    assert np.isnan(flat.after_percent)
    short = dataclasses.replace(later, under_test=np.clip(later.under_test, None, 12.0))
    short = pairs.Pair(RATE_HZ, short.reference[:250], short.under_test[:250])
    assert pairs.check(short, earlier).name == "saturation"


def test_the_verdict_repeats() -> None:
    one, other = louder(0.06), louder.__wrapped__(0.06)
    assert dataclasses.asdict(one) == dataclasses.asdict(other)
