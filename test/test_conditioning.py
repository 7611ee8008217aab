"""Conditioning: gravity and vertical of any mounting, the filter's delay, stamps and samples as bad as the field's."""

from __future__ import annotations

import tracemalloc

import naive
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.spatial.transform import Rotation

from biodyn_core.conditioning import Conditioner, ConditioningSettings, group_delay_s
from biodyn_core.errors import InputError
from biodyn_core.levelling import rotation_to_vertical

RATE_HZ = 1129.3
START_NS = 1_767_225_600 * 10**9
REST_S = 0.8
SEEDS = st.integers(0, 2**32 - 1)
ROUNDING = 1e-9
HOUR_NS = 3600 * 10**9


def stamps(count: int, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Even header stamps, ns."""
    return START_NS + np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64)


def ride(seconds: float, rate_hz: float = RATE_HZ, frequency_hz: float = 5.0, size: float = 2.0) -> np.ndarray:
    """A second at rest, then a sine up and down with smaller ones sideways; acceleration (n, 3), up last."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    swing = np.where(time > 1.0, np.sin(2.0 * np.pi * frequency_hz * (time - 1.0)), 0.0)
    return size * swing[:, None] * [0.3, -0.2, 1.0]


def raw(accel: np.ndarray, mounting: np.ndarray | None = None) -> np.ndarray:
    """What a sensor mounted so reports: specific force, (n, 3)."""
    force = accel + np.array([0.0, 0.0, naive.GRAVITY])
    return force if mounting is None else force @ mounting.T


class Conditioned:
    """One conditioner's blocks, joined."""

    def __init__(self, stamps_ns, samples, cuts=(), conditioning=None, mode="causal", vertical=None) -> None:
        self.conditioner = Conditioner("seat", conditioning, mode, vertical)
        parts = zip(np.split(stamps_ns, cuts), np.split(samples, cuts), strict=True)
        self.blocks = [block for s, x in parts for block in self.conditioner.push(s, x)] + self.conditioner.finish()
        self.status = self.conditioner.status()
        self.stamps_ns = np.concatenate([b.stamps_ns for b in self.blocks] or [np.empty(0, dtype=np.int64)])
        self.time_s = np.concatenate([b.time_s for b in self.blocks] or [np.empty(0)])
        self.levelled = np.concatenate([b.levelled_mps2 for b in self.blocks] or [np.empty((0, 3))])
        self.low_passed = np.concatenate([b.low_passed_mps2 for b in self.blocks] or [np.empty(0)])
        begins = [np.arange(b.time_s.size) == 0 if b.begins_run else np.zeros(b.time_s.size, bool) for b in self.blocks]
        self.begins = np.flatnonzero(np.concatenate(begins or [np.empty(0, dtype=bool)]))


# --- gravity and vertical --------------------------------------------------------------------------------------------

MOUNTINGS = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


@settings(max_examples=60)
@given(MOUNTINGS)
@example((0.0, 1.0, 6e-8, 0.0))
@example((1.0, 0.0, 0.0, 0.0))  # upside down about x (scalar last)
@example((0.0, 1.0, 0.0, 0.0))  # upside down about y
@example((1.0, 1.0, 0.0, 0.0))
@example((1.0, 0.0, 0.0, 1e-3))  # nearly so
@example((0.0, 0.0, 0.0, 1.0))  # as it should be
@example((1.0, 0.0, 0.0, 1.0))  # on its side
def test_any_mounting_is_levelled(quaternion):
    mounting = Rotation.from_quat(quaternion).as_matrix()
    accel = ride(2.0)
    found = Conditioned(stamps(len(accel)), raw(accel, mounting))
    status = found.status
    assert status.gravity_mps2 == pytest.approx(naive.GRAVITY, rel=ROUNDING)
    np.testing.assert_allclose(status.vertical, mounting[:, 2], atol=ROUNDING)
    truth = accel[-len(found.levelled) :]
    # Within 4.5e-5 rad of upside down that much of 1 g leaks sideways, see the next test.
    close = 1e-6 if mounting[2, 2] > -1.0 + 1e-8 else 5e-4
    np.testing.assert_allclose(found.levelled[:, 2], truth[:, 2], atol=close)
    # The yaw is unknown, so sideways only the length is.
    sideways = np.hypot(*found.levelled[:, :2].T)
    np.testing.assert_allclose(sideways, np.hypot(*truth[:, :2].T), atol=close)
    assert status.warnings == () and status.fault is None


@pytest.mark.parametrize("off", [1e-3, 1e-4, 4e-5, 1e-6, 0.0])
def test_around_upside_down_the_rotation_stays_one(off):
    up = np.array([off, 0.0, -np.sqrt(1.0 - off**2)])
    turn = rotation_to_vertical(up)
    # Within 4.5e-5 rad of straight down the direction is rounded: that much of 1 g, 0.4 mm/s^2, leaks sideways.
    np.testing.assert_allclose(turn @ up, [0.0, 0.0, 1.0], atol=5e-5)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-7)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-7)


def test_a_gain_error_is_levelled_all_the_same_and_told():
    accel = ride(2.0)
    found = Conditioned(stamps(len(accel)), 1.08 * raw(accel))
    assert found.status.gravity_mps2 == pytest.approx(1.08 * naive.GRAVITY)
    np.testing.assert_allclose(found.levelled[-1000:], 1.08 * accel[-1000:], atol=ROUNDING)
    assert any("gravity at rest reads 10.59" in warning for warning in found.status.warnings)


def test_gravity_is_taken_from_the_first_rest_and_what_was_before_is_not_counted():
    accel = np.concatenate([ride(4.0)[2000:], np.zeros((2000, 3)), ride(3.0)])
    found = Conditioned(stamps(len(accel)), raw(accel))
    assert found.status.gravity_mps2 == pytest.approx(naive.GRAVITY, rel=1e-3)
    assert found.status.warnings == ()
    moving_s = (len(ride(4.0)) - 2000) / RATE_HZ
    assert moving_s + REST_S <= found.status.uncounted_s <= moving_s + 2.0 * REST_S + 0.01
    np.testing.assert_allclose(found.levelled[-1000:], accel[-1000:], atol=0.02)


def test_without_rest_motion_is_averaged_and_told():
    seconds = 14.0
    accel = ride(seconds + 1.0)[1130:][: round(seconds * RATE_HZ)]
    found = Conditioned(stamps(len(accel)), raw(accel))
    assert any("no rest found" in warning for warning in found.status.warnings)
    # Ten seconds of whole periods average out; the last window is cut anywhere.
    assert found.status.gravity_mps2 == pytest.approx(naive.GRAVITY, abs=0.05)
    assert 10.0 <= found.status.uncounted_s < 11.0


def test_gravity_is_frozen():
    accel = np.concatenate([np.zeros((1200, 3)), np.full((6000, 3), 0.5)])
    found = Conditioned(stamps(len(accel)), raw(accel))
    np.testing.assert_allclose(found.levelled[-100:], 0.5, atol=ROUNDING)


# --- faults ----------------------------------------------------------------------------------------------------------

STILL = raw(np.zeros((20_000, 3)))

FAULTS = [
    (stamps(2000), STILL[:2000] * 0.01, "without gravity the vertical is unknown"),
    (stamps(2000, 100.0), STILL[:2000], "a rate of 100 Hz does not fit, 250 to 20000 Hz"),
    (stamps(60_000, 30_000.0), np.tile(STILL[0], (60_000, 1)), "a rate of 3e+04 Hz does not fit"),
    (np.full(61_000, START_NS), np.tile(STILL[0], (61_000, 1)), "stamps stand still"),
    (stamps(20_000), STILL * np.nan, "no finite sample arrived"),
]


@pytest.mark.parametrize(
    ("stamps_ns", "samples", "told"), FAULTS, ids=lambda value: value if type(value) is str else ""
)
def test_a_hopeless_sensor_is_told_in_one_line_and_answers_nothing(stamps_ns, samples, told):
    found = Conditioned(stamps_ns, samples)
    assert found.blocks == []
    assert found.status.fault.startswith("seat: ") and told in found.status.fault
    assert "\n" not in found.status.fault


@pytest.mark.parametrize(
    ("stamps_ns", "samples", "told"), FAULTS, ids=lambda value: value if type(value) is str else ""
)
def test_a_sensor_that_is_mended_meanwhile_is_believed(stamps_ns, samples, told):
    found = Conditioned(stamps_ns, samples)
    later = int(stamps_ns[-1]) - START_NS + 10**9
    accel = ride(3.0)
    (block,) = found.conditioner.push(stamps(len(accel)) + later, raw(accel))
    status = found.conditioner.status()
    assert status.fault is None and status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6)
    np.testing.assert_allclose(block.levelled_mps2[-500:], accel[-500:], atol=1e-6)
    assert status.uncounted_s > 0.99 * len(samples) / RATE_HZ  # what was waited through is told


@pytest.mark.parametrize(("cutoff_hz", "fits"), [(100.0, True), (150.0, False)])
def test_the_rate_must_carry_the_low_pass(cutoff_hz, fits):
    found = Conditioned(stamps(1000, 300.0), STILL[:1000], conditioning=ConditioningSettings(cutoff_hz=cutoff_hz))
    assert (found.status.fault is None) is fits
    assert fits or "375 to 20000 Hz are needed" in found.status.fault


@pytest.mark.parametrize(
    "name", ["cutoff_hz", "rest_s", "rest_patience_s", "rest_rms_mps2", "max_gap_s", "saturation_mps2"]
)
@pytest.mark.parametrize("value", [-1.0, 1e6, np.nan, np.inf])
def test_a_setting_out_of_range_is_named(name, value):
    with pytest.raises(InputError, match=f"{name} is "):
        ConditioningSettings(**{name: value})


# --- the filter ------------------------------------------------------------------------------------------------------


def test_the_delay_at_the_native_rate_is_4_05_ms():
    assert Conditioned(stamps(2000), STILL[:2000]).status.filter_delay_s == pytest.approx(4.05e-3, abs=5e-6)


@pytest.mark.parametrize("rate_hz", [300.0, 500.0, RATE_HZ, 4000.0])
@pytest.mark.parametrize("cutoff_hz", [20.0, 100.0])
def test_the_group_delay_is_the_slope_of_the_phase(rate_hz, cutoff_hz):
    sections = signal.butter(4, cutoff_hz, fs=rate_hz, output="sos")
    frequency = np.array([0.01, 0.02]) * cutoff_hz
    phase = np.unwrap(np.angle(signal.sosfreqz(sections, frequency, fs=rate_hz)[1]))
    slope = -np.diff(phase)[0] / np.diff(2.0 * np.pi * frequency)[0]
    assert group_delay_s(sections, rate_hz) == pytest.approx(slope, rel=1e-3)  # the delay grows with (f / fc)^2


@pytest.mark.parametrize("rate_hz", [400.0, RATE_HZ, 4000.0])
@pytest.mark.parametrize("frequency_hz", [1.0, 5.0])
def test_a_slow_sine_comes_out_in_phase_at_its_stamps(rate_hz, frequency_hz):
    accel = ride(5.0, rate_hz, frequency_hz)
    found = Conditioned(stamps(len(accel), rate_hz), raw(accel))
    late = found.time_s > 2.0  # transients of the start have gone
    for time in (found.time_s, (found.stamps_ns - START_NS) * 1e-9):
        truth = 2.0 * np.sin(2.0 * np.pi * frequency_hz * (time - 1.0))
        assert np.abs(found.low_passed - truth)[late].max() < 1e-3 * 2.0
    # Uncompensated it would be 13 % at 5 Hz.
    delayed = found.time_s + found.status.filter_delay_s
    error = np.abs(found.low_passed - 2.0 * np.sin(2.0 * np.pi * frequency_hz * (delayed - 1.0)))[late].max()
    assert error > 0.02 * 2.0 * frequency_hz


def test_the_low_pass_is_scipys_butterworth_from_rest():
    rng = np.random.default_rng(1)
    accel = np.concatenate([np.zeros((1000, 3)), rng.standard_normal((3000, 3))])
    found = Conditioned(stamps(len(accel)), raw(accel))
    sections = signal.butter(4, 100.0, fs=found.conditioner.rate_hz, output="sos")
    np.testing.assert_allclose(found.low_passed, signal.sosfilt(sections, found.levelled[:, 2]), atol=ROUNDING)


def test_one_g_at_the_first_sample_never_reaches_the_filter():
    found = Conditioned(stamps(3000), STILL[:3000])
    assert np.abs(found.low_passed).max() < ROUNDING and np.abs(found.levelled).max() < ROUNDING


# --- time ------------------------------------------------------------------------------------------------------------


def test_even_stamps_come_back_less_the_delay():
    found = Conditioned(stamps(5000), STILL[:5000])
    delay_ns = round(found.status.filter_delay_s * 1e9)
    np.testing.assert_array_equal(found.stamps_ns, stamps(5000)[-len(found.stamps_ns) :] - delay_ns)
    np.testing.assert_allclose(found.time_s, (found.stamps_ns - START_NS) * 1e-9, atol=2e-9)  # stamps in whole ns
    assert found.status.uncounted_s == pytest.approx((5000 - len(found.stamps_ns)) / RATE_HZ, abs=1e-6)
    assert found.blocks[0].epoch_ns == START_NS
    assert found.status.accepted == len(found.stamps_ns) and found.status.runs == 1


@pytest.mark.parametrize("rate_hz", [500.0, RATE_HZ, 1600.0])
@pytest.mark.parametrize("ppm", [-200.0, 0.0, 50.0])
def test_rate_and_time_are_recovered_from_jittering_stamps(rate_hz, ppm):
    own_hz, count = rate_hz * (1.0 + ppm * 1e-6), round(20.0 * rate_hz)
    jitter_ns = np.random.default_rng(3).normal(0.0, 0.06e9 / rate_hz, count)  # 6 % of a period: 0.05 ms
    true_ns = np.arange(count) * 1e9 / own_hz
    jittered = START_NS + np.maximum.accumulate(np.rint(true_ns + jitter_ns)).astype(np.int64)
    found = Conditioned(jittered, np.tile(STILL[0], (count, 1)))
    assert found.status.rate_hz == pytest.approx(own_hz, rel=20e-6)
    truth_s = true_ns[-len(found.time_s) :] * 1e-9 - found.status.filter_delay_s
    offset_s = (jittered[0] - START_NS) * 1e-9  # inside, time counts from the first stamp
    # Averaged over a second, white jitter of 0.12 ms at most leaves 0.12 / sqrt(500 / 2) = 0.008 ms.
    assert np.abs(found.time_s + offset_s - truth_s).max() < 0.04e-3
    assert (found.status.filled, found.status.late, found.status.runs) == (0, 0, 1)


def test_a_clock_whose_rate_changes_is_followed():
    # 300 ppm faster after five seconds, which no quartz does; never more than 0.6 ms behind, and then followed.
    count = round(60.0 * RATE_HZ)
    period_s = np.where(np.arange(count) < 5.0 * RATE_HZ, 1.0, 1.0 - 300e-6) / RATE_HZ
    true_s = np.cumsum(period_s) - period_s[0]
    found = Conditioned(START_NS + np.rint(true_s * 1e9).astype(np.int64), np.tile(STILL[0], (count, 1)))
    behind = found.time_s + found.status.filter_delay_s - true_s[-len(found.time_s) :]
    assert np.abs(behind).max() < 0.6e-3 and np.abs(behind[-1000:]).max() < 0.01e-3
    assert found.status.rate_hz == pytest.approx(RATE_HZ * (1.0 + 300e-6), rel=10e-6)


def test_missing_stamps_at_rest_do_not_spoil_the_rate():
    lost = np.delete(np.arange(2000), [100, 101, 300, 500])
    found = Conditioned(stamps(2000)[lost], STILL[lost])
    assert found.conditioner.rate_hz == pytest.approx(RATE_HZ, rel=1e-6)


# --- lost, bad and late samples --------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(st.lists(st.tuples(st.integers(1300, 3800), st.integers(1, 54)), max_size=4))
def test_lost_samples_are_drawn_in_and_counted(gaps):
    accel = ride(3.5, frequency_hz=2.0)
    lost = np.zeros(len(accel), dtype=bool)
    for begin, length in gaps:
        lost[begin : begin + length] = True
    if any(end - begin > 54 for begin, end in runs_of(lost)):  # merged into one longer than max_gap_s
        return
    kept = ~lost
    found = Conditioned(stamps(len(accel))[kept], raw(accel)[kept])
    whole = Conditioned(stamps(len(accel)), raw(accel))
    assert found.status.filled == lost.sum() and found.status.runs == 1
    assert len(found.time_s) == len(whole.time_s)
    np.testing.assert_allclose(found.time_s, whole.time_s, atol=1e-8)
    np.testing.assert_allclose(found.stamps_ns, whole.stamps_ns, atol=10)
    # A straight line over 55 samples of a 2 Hz sine: 2 (2 pi 2)^2 (55 / 1129.3)^2 / 8.
    np.testing.assert_allclose(found.levelled, whole.levelled, atol=0.1)
    there = kept[-len(found.levelled) :]
    np.testing.assert_array_equal(found.levelled[there], whole.levelled[there])


def runs_of(flags: np.ndarray) -> list[tuple[int, int]]:
    """(first, end) of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def test_what_is_drawn_in_is_a_straight_line():
    accel = ride(3.0)
    kept = np.delete(np.arange(len(accel)), np.arange(2000, 2030))
    found = Conditioned(stamps(len(accel))[kept], raw(accel)[kept])
    at = 1999 - (len(accel) - len(found.levelled))
    wanted = np.linspace(accel[1999], accel[2030], 32)
    np.testing.assert_allclose(found.levelled[at : at + 32], wanted, atol=1e-6)


@pytest.mark.parametrize("gap_s", [0.06, 1.0, 100.0])
def test_a_long_gap_splits_the_run_and_nothing_integrates_across(gap_s):
    accel = ride(4.0)
    late = stamps(len(accel))
    late[3000:] += round(gap_s * 1e9)
    found = Conditioned(late, raw(accel))
    assert found.status.runs == 2 and found.status.filled == 0
    assert found.status.gap_s == pytest.approx(gap_s, abs=2.0 / RATE_HZ)
    assert found.begins.tolist() == [0, len(found.time_s) - (len(accel) - 3000)]
    assert found.status.rejected == 0
    sections = signal.butter(4, 100.0, fs=found.conditioner.rate_hz, output="sos")
    second = slice(found.begins[1], None)
    fresh = signal.sosfilt(sections, found.levelled[second, 2])
    np.testing.assert_allclose(found.low_passed[second], fresh, atol=ROUNDING)
    assert np.diff(found.time_s).min() > 0.0


BAD = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e5, np.float64(np.finfo(float).max)]


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_sample_that_cannot_be_is_as_good_as_lost(value, axis):
    accel = ride(3.0)
    samples, kept = raw(accel), np.ones(len(accel), dtype=bool)
    for at in (300, 1800, 1801, 2500):  # the first while it looks for rest
        samples[at, axis], kept[at] = value, False
    found = Conditioned(stamps(len(accel)), samples)
    wanted = Conditioned(stamps(len(accel))[kept], raw(accel)[kept])
    assert found.status.non_finite == 3 and found.status.filled == 3 and found.status.runs == 1
    np.testing.assert_allclose(found.levelled, wanted.levelled, atol=ROUNDING)
    np.testing.assert_allclose(found.low_passed, wanted.low_passed, atol=ROUNDING)


@settings(max_examples=60)
@given(st.integers(880, 925), st.integers(1, 40), st.sampled_from(BAD))
def test_bad_samples_around_the_end_of_rest_poison_nothing(begin, length, value):
    accel = ride(2.0)
    samples = raw(accel)
    samples[begin : begin + length] = value
    found = Conditioned(stamps(len(accel)), samples)
    assert np.isfinite(found.low_passed).all() and np.isfinite(found.levelled).all()
    np.testing.assert_allclose(found.levelled[-500:], accel[-500:], atol=1e-6)


def test_an_impossible_sample_does_not_bend_gravity_averaged_over_motion():
    accel = ride(15.0)[1130:]
    samples = raw(accel)
    samples[500] = 1e6
    found = Conditioned(stamps(len(accel)), samples)
    assert found.status.gravity_mps2 == pytest.approx(naive.GRAVITY, abs=0.05)


def test_a_clipped_sample_is_used_and_counted():
    accel = ride(3.0)
    samples = raw(accel)
    full_scale = 16.0 * 9.80665  # of 12 bits with a sign the largest reading is one step below
    samples[2000, 1], samples[2001, 2], samples[2002, 0] = full_scale * 2047 / 2048, -full_scale, 156.7
    found = Conditioned(stamps(len(accel)), samples)
    assert found.status.clipped == 2 and found.status.non_finite == 0 and found.status.filled == 0


@settings(max_examples=40)
@given(st.lists(st.tuples(st.integers(1000, 3300), st.integers(0, 15)), min_size=1, max_size=10))
def test_duplicates_and_late_samples_change_nothing(extra):
    accel = ride(3.0)
    order = np.arange(len(accel))
    for at, behind in sorted(extra, reverse=True):
        order = np.insert(order, at + 1, order[at] - behind)
    found = Conditioned(stamps(len(accel))[order], raw(accel)[order])
    wanted = Conditioned(stamps(len(accel)), raw(accel))
    assert found.status.late + found.status.duplicate == found.status.rejected == len(extra)
    np.testing.assert_array_equal(found.levelled, wanted.levelled)
    np.testing.assert_array_equal(found.stamps_ns, wanted.stamps_ns)
    np.testing.assert_array_equal(found.low_passed, wanted.low_passed)


def test_stamps_that_jump_back_begin_a_new_run_and_time_inside_goes_on():
    accel = ride(3.0)
    laps = 4
    found = Conditioned(np.tile(stamps(len(accel)), laps), np.tile(raw(accel), (laps, 1)))
    assert found.status.runs == laps and found.status.fault is None
    assert np.diff(found.time_s).min() > 0.0
    ends = [*found.begins[1:], len(found.time_s)]
    second, third = (slice(found.begins[lap], ends[lap]) for lap in (1, 2))
    assert ends[1] - found.begins[1] == len(accel)  # twenty stamps in a row tell a jump, and none of them is lost
    np.testing.assert_array_equal(found.low_passed[second], found.low_passed[third])
    np.testing.assert_array_equal(found.stamps_ns[second], found.stamps_ns[third])


# --- cuts ------------------------------------------------------------------------------------------------------------


KINDS = [
    "lost",
    "bad",
    "late",
    "same",
    "gap",
    "back",
    "ahead",
    "zero",
    "leap",
    "return",
    "frozen",
    "quantised",
    "twice",
]


@st.composite
def faulty(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """A ride with jitter and any mixture of what stamps and samples suffer in the field, rest not spared."""
    rng = np.random.default_rng(draw(SEEDS))
    accel = ride(3.0)
    stamps_ns = stamps(len(accel)) + np.rint(rng.normal(0.0, 2e4, len(accel))).astype(np.int64)
    samples = raw(accel) + 0.05 * rng.standard_normal(accel.shape)
    for kind in draw(st.lists(st.sampled_from(KINDS), max_size=6)):
        at, length = int(rng.integers(0, len(stamps_ns) - 60)), int(rng.integers(1, 60))
        here, sign = slice(at, at + length), int(rng.choice([-1, 1]))
        if kind == "lost":
            stamps_ns, samples = np.delete(stamps_ns, here), np.delete(samples, here, axis=0)
        elif kind == "bad":
            samples[here, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, 1e300])
        elif kind == "late":
            stamps_ns[here] = stamps_ns[here][::-1]
        elif kind == "same":
            stamps_ns[here] = stamps_ns[at]
        elif kind == "ahead":
            stamps_ns[at] += int(rng.integers(1, 10**8))
        elif kind == "zero":
            stamps_ns[here] = 0
        elif kind in ("leap", "return"):
            stamps_ns[here if kind == "return" else slice(at, None)] += sign * int(rng.choice([HOUR_NS, 10**16]))
        elif kind == "frozen":
            stamps_ns[at : at + 20 * length] = stamps_ns[at]
        elif kind == "quantised":
            stamps_ns = stamps_ns // 10**7 * 10**7
        elif kind == "twice":
            stamps_ns, samples = np.repeat(stamps_ns, 2), np.repeat(samples, 2, axis=0)
        else:
            stamps_ns[at:] += int(rng.integers(10**7, 2 * 10**9)) * (1 if kind == "gap" else -1)
    return stamps_ns, samples


CUTS = st.lists(st.integers(0, 3400), max_size=12).map(sorted)


@settings(max_examples=200)
@given(faulty(), CUTS, st.sampled_from([None, 0.05]))
def test_any_cut_into_blocks_gives_the_same_bits_whatever_is_wrong(record, cuts, flat_s):
    conditioning = ConditioningSettings(flat_s=flat_s) if flat_s else None
    whole, cut = Conditioned(*record, conditioning=conditioning), Conditioned(*record, cuts, conditioning)
    assert_same(cut, whole)
    assert np.isfinite(whole.low_passed).all()
    # Between runs time inside jumps back only where stamps that had leapt ahead return.
    assert all((np.diff(run) > 0.0).all() for run in np.split(whole.time_s, whole.begins))
    assert whole.status.gap_s >= 0.0


@settings(max_examples=50)
@given(faulty(), CUTS, st.sampled_from(["zero_phase", "survey"]))
def test_any_cut_gives_the_same_in_the_other_modes_and_counts_alike(record, cuts, mode):
    whole, cut = Conditioned(*record, mode=mode), Conditioned(*record, cuts, mode=mode)
    assert_same(cut, whole)
    causal = Conditioned(*record)
    same = ["rate_hz", "jitter_s", "gravity_mps2", "accepted", "rejected", "filled", "runs", "uncounted_s", "gap_s"]
    for name in same:
        assert getattr(whole.status, name) == getattr(causal.status, name), name
    np.testing.assert_array_equal(whole.levelled, causal.levelled if mode == "zero_phase" else np.empty((0, 3)))


@settings(max_examples=10)
@given(faulty())
def test_sample_by_sample_it_is_the_same_whatever_is_wrong(record):
    assert_same(Conditioned(*record, cuts=range(1, len(record[0]))), Conditioned(*record))


def assert_same(found: Conditioned, wanted: Conditioned) -> None:
    for name in ("stamps_ns", "time_s", "levelled", "low_passed", "begins"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    assert found.status == wanted.status


def test_sample_by_sample_gives_the_same_bits():
    accel = ride(2.5)
    record = np.delete(stamps(len(accel)), np.arange(2000, 2010)), np.delete(raw(accel), np.arange(2000, 2010), axis=0)
    assert_same(Conditioned(*record, cuts=range(1, len(record[0]))), Conditioned(*record))


def test_nothing_in_nothing_out():
    conditioner = Conditioner("seat")
    assert conditioner.push(np.empty(0, dtype=np.int64), np.empty((0, 3))) == []
    status = conditioner.status()
    assert (status.rate_hz, status.gravity_mps2, status.vertical, status.filter_delay_s) == (None,) * 4
    assert (status.accepted, status.runs, status.uncounted_s, status.fault) == (0, 0, 0.0, None)


def test_arrays_as_messages_bring_them_are_taken():
    accel = ride(2.0)
    wide = np.zeros((len(accel), 6), dtype=">f8")
    wide[:, ::2] = raw(accel)
    view = wide[:, ::2]
    view.flags.writeable = False
    assert_same(Conditioned(stamps(len(accel)), view), Conditioned(stamps(len(accel)), raw(accel)))


# --- clocks that are not what they should be -------------------------------------------------------------------------


@pytest.mark.parametrize("ppm", [-20.0, -200.0])
def test_a_sensor_of_the_lowest_rate_is_accepted_though_its_clock_drifts(ppm):
    found = Conditioned(stamps(1000, 250.0 * (1.0 + ppm * 1e-6)), STILL[:1000])
    assert found.status.fault is None


def test_a_fifth_of_a_millisecond_of_jitter_invents_no_samples():
    count = round(20.0 * RATE_HZ)
    jitter_ns = np.random.default_rng(3).normal(0.0, 0.2e6, count)
    jittered = np.maximum.accumulate(stamps(count) + np.rint(jitter_ns).astype(np.int64))
    status = Conditioned(jittered, np.tile(STILL[0], (count, 1))).status
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert status.filled <= 0.005 * count


def test_three_samples_before_a_pause_are_no_rest():
    rng = np.random.default_rng(5)
    stamps_ns = stamps(3000) + np.rint(rng.normal(0.0, 3e4, 3000)).astype(np.int64)
    stamps_ns[3:] += 2 * 10**9
    assert Conditioned(stamps_ns, STILL[:3000]).conditioner.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)


def test_a_bag_that_loops_before_rest_was_found_is_no_fault():
    looping = np.concatenate([stamps(70_000)[-400:], stamps(20_000)])
    status = Conditioned(looping, STILL[np.zeros(20_400, dtype=int)], cuts=range(280, 20_400, 280)).status
    assert status.fault is None and status.accepted > 18_000


def test_one_zero_stamp_at_the_start_does_not_end_a_sensor():
    stamps_ns = stamps(3000)
    stamps_ns[0] = 0
    assert Conditioned(stamps_ns, STILL[:3000]).status.fault is None


# --- clocks against the truth ----------------------------------------------------------------------------------------

COUNT = 34_000
MARKED_FROM = 1200


def marked(count: int = COUNT) -> np.ndarray:
    """Readings (n, 3) at rest whose first axis counts samples once rest is over, so that each tells which it is."""
    samples = np.tile(STILL[0], (count, 1))
    samples[:, 0] = 1e-3 * np.maximum(np.arange(count) - MARKED_FROM, 0)
    return samples


MARKED = marked()
INDEX = np.arange(COUNT)


def off_s(found: Conditioned, stamps_ns: np.ndarray, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Smoothed time less the time at which each sample, interpolated ones too, was really taken."""
    marks = found.levelled[:, 0] / 1e-3
    told = marks > 100.0  # what lies between a sample that is marked and one that is not tells nothing
    assert (np.diff(marks[told]) > 0.0).all()  # in the true order
    begins_s = (stamps_ns[0] - START_NS) * 1e-9  # inside, time counts from the first stamp
    taken_s = (marks[told] + MARKED_FROM) / rate_hz
    return found.time_s[told] + found.status.filter_delay_s + begins_s - taken_s


def in_bursts(count: int = COUNT, many: int = 20) -> np.ndarray:
    """Stamps of arrival: `many` samples within 2 ms once the last of them was taken, then a pause."""
    index = np.arange(count)
    return stamps(count + many)[index // many * many + many - 1] + (index % many) * (2_000_000 // many)


def jittering(sigma_ms: float, count: int = COUNT) -> np.ndarray:
    """Stamps with Gaussian errors, in order of arrival, which from a millisecond on is not that of the stamps."""
    return stamps(count) + np.rint(np.random.default_rng(1).normal(0.0, sigma_ms * 1e6, count)).astype(np.int64)


# Stamps, the mean by which they are late, and how far the smoothed time may stray from that, both in seconds. A line
# through n stamps of scatter sigma is off by 2 sigma / sqrt(n) at its end, 0.067 sigma after 904 at rest: four times
# that. Quantised stamps are not random, and their sawtooth averages out within a few steps.
CLOCKS = {
    "even": (stamps(COUNT), 0.0, 1e-8),
    "to 1 ms": (stamps(COUNT) // 10**6 * 10**6, -0.5e-3, 0.01e-3),
    "to 10 ms": (stamps(COUNT) // 10**7 * 10**7, -5e-3, 0.1e-3),
    "bursts": (in_bursts(), (9.5 / RATE_HZ + 0.95e-3), 0.3e-3),
    "jitter 0.05 ms": (jittering(0.05), 0.0, 0.05e-3 * 0.27),
    "jitter 0.5 ms": (jittering(0.5), 0.0, 0.5e-3 * 0.27),
    "jitter 5 ms": (jittering(5.0), 0.0, 5e-3 * 0.27),
}
clocks = pytest.mark.parametrize("clock", CLOCKS)


@clocks
def test_time_is_recovered_from_any_clock(clock):
    stamps_ns, late_s, close_s = CLOCKS[clock]
    found = Conditioned(stamps_ns, MARKED)
    status = found.status
    assert status.rejected == status.filled == 0 and status.runs == 1
    # Where single stamps tell nothing of a lost sample it is said; coarse ones tell by how many share one.
    assert bool(status.warnings) is (clock in ("bursts", "jitter 0.5 ms", "jitter 5 ms"))
    assert all("jitter" in warning for warning in status.warnings)
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=20e-6)
    assert np.abs(off_s(found, stamps_ns) - late_s).max() < close_s
    np.testing.assert_allclose(np.diff(found.time_s), 1.0 / RATE_HZ, rtol=0.1)
    assert status.recorded_s == pytest.approx(COUNT / RATE_HZ, abs=0.01)


@pytest.mark.parametrize("rate_hz", [250.0, 400.0, 600.0, 800.0, 833.0, 952.0, 1000.0, 1100.0, 1600.0, 3200.0])
@pytest.mark.parametrize("quantum_ms", [1, 4, 10])
@pytest.mark.parametrize("step_mps2", [0.0, 0.0766])
def test_coarse_stamps_of_any_rate_lose_and_invent_nothing(rate_hz, quantum_ms, step_mps2):
    # Coarse readings, of 12 bits, repeat as well: with their stamp they look like messages sent twice.
    count, quantum_ns = round(4.0 * rate_hz), quantum_ms * 10**6
    samples = STILL[:1] + 0.02 * np.random.default_rng(2).standard_normal((count, 3))
    if step_mps2:
        samples = np.rint(samples / step_mps2) * step_mps2
    status = Conditioned(stamps(count, rate_hz) // quantum_ns * quantum_ns, samples).status
    assert status.rate_hz == pytest.approx(rate_hz, rel=100e-6)
    assert status.rejected == status.filled == 0 and status.runs == 1


@pytest.mark.parametrize("ppm", [-500.0, -50.0, 500.0])
@pytest.mark.parametrize("jitter_ms", [0.0, 0.05])
def test_a_drifting_clock_is_followed_and_told_in_ppm(ppm, jitter_ms):
    own_hz = RATE_HZ * (1.0 + ppm * 1e-6)
    stamps_ns = stamps(COUNT, own_hz) + (jittering(jitter_ms) - stamps(COUNT))
    found = Conditioned(stamps_ns, MARKED)
    assert found.status.rate_hz == pytest.approx(own_hz, rel=1e-9 + 20e-6 * jitter_ms)
    assert np.abs(off_s(found, stamps_ns, own_hz)).max() < 1e-8 + 0.27e-3 * jitter_ms


@pytest.mark.parametrize("delay_ms", [0.1, 1.0])
def test_callbacks_that_are_sent_late_lose_and_invent_nothing(delay_ms):
    # No stamp is earlier than the one before: a queue that stalls, and then empties in no time.
    delay_ns = np.random.default_rng(1).exponential(delay_ms * 1e6, COUNT)
    stamps_ns = np.maximum.accumulate(stamps(COUNT) + np.rint(delay_ns).astype(np.int64))
    found = Conditioned(stamps_ns, MARKED)
    assert found.status.rejected == found.status.filled < 1e-4 * COUNT and found.status.runs == 1
    mean_s = float((stamps_ns - stamps(COUNT)).mean()) * 1e-9
    far_s = np.abs(off_s(found, stamps_ns) - mean_s)
    # Of two with one stamp the second is late where the clock is that good: the first stands in its place.
    assert (far_s > 0.27e-3 * delay_ms).sum() <= 2 * found.status.late and far_s.max() < 1.05 / RATE_HZ


@pytest.mark.parametrize("stall_ms", [4.0, 15.0])
def test_one_stall_of_a_callback_is_no_loss(stall_ms):
    late = stamps(COUNT)
    stalled = slice(9000, 9000 + int(stall_ms * 1e-3 * RATE_HZ))
    late[stalled] = stamps(COUNT)[stalled.stop] + 20_000 * (np.arange(stalled.stop - stalled.start) - 20)
    found = Conditioned(late, MARKED)
    assert found.status.runs == 1
    assert np.abs(off_s(found, late)).max() < 2.1 / RATE_HZ  # the clock is never led astray by more than it tolerates
    assert np.abs(off_s(found, late)[-1000:]).max() < 0.1e-3


def test_a_backlog_after_a_long_stall_does_not_run_ahead_of_the_clock():
    late = stamps(COUNT)
    late[9000:11_000] = late[11_000] + 20_000 * (np.arange(2000) - 2000)
    found = Conditioned(late, MARKED)
    ahead_s = found.time_s + found.status.filter_delay_s - (found.stamps_ns - START_NS) * 1e-9
    assert np.abs(ahead_s - found.status.filter_delay_s).max() < 2.0 / RATE_HZ
    assert found.status.late > 1900 and found.status.gap_s == pytest.approx(2000 / RATE_HZ, abs=0.05)


@pytest.mark.parametrize("later_hz", [500.0, 900.0, 1600.0, 3000.0])
def test_a_rate_that_left_that_at_rest_is_told(later_hz):
    stamps_ns = np.concatenate([stamps(3000), stamps(3000)[-1] + stamps(20_000, later_hz)[1:] - START_NS])
    status = Conditioned(stamps_ns, STILL[np.zeros(len(stamps_ns), dtype=int)]).status
    # Faster than at rest, what is too much comes late; slower, it is drawn in or the clock cannot follow.
    counted = status.late if later_hz > RATE_HZ else status.filled
    told = any("rate is 2 % off" in warning for warning in status.warnings)
    assert told or counted > 0.8 * 20_000 * abs(RATE_HZ / later_hz - 1.0) > 4000


# --- lost, repeated and disordered messages --------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2, 0.4])
def test_random_loss_is_counted_and_costs_neither_rate_nor_time(share):
    kept = np.random.default_rng(4).random(COUNT) >= share
    kept[[0, -1]] = True
    found = Conditioned(stamps(COUNT)[kept], MARKED[kept])
    status = found.status
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6) and status.rejected == 0
    assert np.abs(off_s(found, stamps(COUNT))).max() < 1e-7
    assert status.filled == (~kept[COUNT - len(found.time_s) :]).sum()
    assert status.uncounted_s == pytest.approx((COUNT - len(found.time_s)) / RATE_HZ, abs=1e-6)
    assert status.recorded_s == pytest.approx(COUNT / RATE_HZ, abs=1e-4)


@pytest.mark.parametrize("behind", [0, 1, 5, 30])
def test_a_second_publisher_of_every_message_changes_nothing(behind):
    order = np.argsort(np.concatenate([INDEX, INDEX + behind + 0.5]), kind="stable") % COUNT
    noisy = MARKED + 0.02 * np.random.default_rng(5).standard_normal(MARKED.shape)
    found = Conditioned(stamps(COUNT)[order], noisy[order])
    wanted = Conditioned(stamps(COUNT), noisy)
    np.testing.assert_allclose(found.levelled, wanted.levelled, atol=1e-4)  # the mean at rest counts what came by then
    np.testing.assert_array_equal(found.stamps_ns, wanted.stamps_ns)
    status = found.status
    assert status.rejected == status.duplicate + status.late
    assert abs(status.rejected - len(found.time_s)) <= behind
    for name in ("rate_hz", "accepted", "filled", "runs", "uncounted_s"):
        assert getattr(status, name) == pytest.approx(getattr(wanted.status, name), rel=1e-9), name


def test_a_second_publisher_and_a_gap_are_told_apart():
    kept = np.delete(INDEX, np.arange(9000, 9030))
    found = Conditioned(np.repeat(stamps(COUNT)[kept], 2), np.repeat(MARKED[kept], 2, axis=0))
    assert found.status.filled == 30 and found.status.duplicate == found.status.accepted
    assert np.abs(off_s(found, stamps(COUNT))).max() < 1e-7


@pytest.mark.parametrize("late_s", [0.002, 0.05])
def test_the_few_that_come_out_of_order_are_as_good_as_lost(late_s):
    rng = np.random.default_rng(6)
    arrival = INDEX / RATE_HZ
    out = rng.random(COUNT) < 0.01
    out[:1000] = False
    arrival[out] += rng.uniform(1.0 / RATE_HZ, late_s, out.sum())
    order = np.argsort(arrival, kind="stable")
    late = int((order < np.maximum.accumulate(order)).sum())
    found = Conditioned(stamps(COUNT)[order], MARKED[order])
    status = found.status
    assert late > 100 and status.filled == status.rejected == status.late + status.stray
    assert late <= status.rejected < 1.3 * late  # where samples changed places one of each pair is used, or nearly so
    assert status.runs == 1 and np.abs(off_s(found, stamps(COUNT))).max() < 1e-7


@pytest.mark.parametrize("within_s", [0.002, 0.02, 0.05])
def test_a_stream_all_out_of_order_is_never_taken_for_one_that_jitters(within_s):
    order = np.argsort(INDEX / RATE_HZ + np.random.default_rng(7).uniform(0.0, within_s, COUNT), kind="stable")
    found = Conditioned(stamps(COUNT)[order], MARKED[order])
    status = found.status
    # What is used is used in the true order (which `off_s` asserts) and at the true time; the rest is told.
    assert np.abs(off_s(found, stamps(COUNT)[order])).max() < 1e-4
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6)
    assert status.rejected > 0.1 * COUNT and status.filled == pytest.approx(status.rejected, rel=0.05)


# --- stamps that leap, stand still, or were never set ----------------------------------------------------------------

signs = pytest.mark.parametrize("sign", [-1, 1])


@clocks
@signs
@pytest.mark.parametrize("many", [1, 5, 19])
def test_a_few_stamps_an_hour_away_cost_themselves_and_nothing_else(clock, sign, many):
    stamps_ns = CLOCKS[clock][0].copy()
    stamps_ns[9000 : 9000 + many] += sign * HOUR_NS
    found, whole = Conditioned(stamps_ns, MARKED), Conditioned(CLOCKS[clock][0], MARKED)
    status = found.status
    assert (status.stray if sign > 0 else status.late) == status.rejected == status.filled == many
    assert status.runs == 1 and status.gap_s == 0.0
    np.testing.assert_allclose(found.time_s, whole.time_s, atol=CLOCKS[clock][2])
    np.testing.assert_allclose(found.levelled, whole.levelled, atol=1e-9)  # a straight line, where marks lie on one


@clocks
@pytest.mark.parametrize("what", ["zero", "bad"])
def test_unset_stamps_and_bad_readings_cost_themselves_and_nothing_else(clock, what):
    hit = np.random.default_rng(8).random(COUNT) < 0.02
    hit[:1000] = hit[-1000:] = False
    hit[20_000:20_040] = True
    stamps_ns, samples = np.where(hit & (what == "zero"), 0, CLOCKS[clock][0]), MARKED.copy()
    if what == "bad":
        samples[hit, 1] = np.nan
    found, whole = Conditioned(stamps_ns, samples), Conditioned(CLOCKS[clock][0], MARKED)
    status = found.status
    assert (status.unset if what == "zero" else status.non_finite) == status.rejected == status.filled == hit.sum()
    assert status.runs == 1
    np.testing.assert_allclose(found.time_s, whole.time_s, atol=CLOCKS[clock][2])
    np.testing.assert_allclose(found.levelled, whole.levelled, atol=1e-9)


@clocks
@signs
@pytest.mark.parametrize("leap_ns", [2 * 10**9, HOUR_NS, 2 * 10**15, 10**18])
def test_thirty_stamps_in_a_row_are_believed_and_their_return_too(clock, sign, leap_ns):
    stamps_ns = CLOCKS[clock][0].copy()
    stamps_ns[9000:9030] += sign * leap_ns
    found = Conditioned(stamps_ns, MARKED)
    status = found.status
    assert status.runs == 3 and status.rejected == status.filled == 0  # none is lost
    straight = Conditioned(CLOCKS[clock][0], MARKED)
    assert len(found.time_s) == len(straight.time_s)
    # Once they have returned, time inside is what it was all along: other sensors are met again.
    np.testing.assert_allclose(found.time_s[-1000:], straight.time_s[-1000:], atol=0.015)
    # Nothing was missing, but that each run begins with a stamp that jitters as they do.
    assert status.gap_s == pytest.approx(0.0, abs=0.03) and status.recorded_s == pytest.approx(30.1, abs=0.05)
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=50e-6)
    # Before it returned, nobody could know.
    unreturned = Conditioned(stamps_ns[:9030], MARKED[:9030]).status
    assert unreturned.gap_s == pytest.approx(leap_ns * 1e-9 if sign > 0 else 0.0, abs=0.02)


def test_what_is_lost_while_stamps_leap_stays_missing():
    kept = np.delete(INDEX, np.concatenate([np.arange(9000, 9200), np.arange(9300, 9400)]))
    for sign in (1, -1):
        stamps_ns = stamps(COUNT)
        stamps_ns[9000:9350] += sign * HOUR_NS
        assert Conditioned(stamps_ns[kept], MARKED[kept]).status.gap_s == pytest.approx(300 / RATE_HZ, abs=1e-3)


@pytest.mark.parametrize("back_s", [2.0, 8.5, 11.5, 25.0])
def test_a_gap_stays_one_though_later_time_jumps_back(back_s):
    stamps_ns = stamps(COUNT)
    stamps_ns[9000:] += 10 * 10**9
    stamps_ns[15_000:] -= round(back_s * 1e9)
    assert Conditioned(stamps_ns, MARKED).status.gap_s == pytest.approx(10.0, abs=1e-3)


def test_a_looping_bag_with_a_gap_has_it_in_every_lap():
    lap = stamps(6000)
    lap[4000:] += 5 * 10**9
    status = Conditioned(np.tile(lap, 3), np.tile(marked(6000), (3, 1))).status
    assert status.gap_s == pytest.approx(15.0, abs=1e-3) and status.runs == 6 and status.rejected == 0


def test_thirty_stamps_from_the_start_of_a_looping_bag_are_no_second_lap_of_missing_seconds():
    status = Conditioned(np.tile(stamps(6000), 50), np.tile(marked(6000), (50, 1))).status
    assert status.gap_s == 0.0 and status.runs == 50 and status.rejected == 0


@pytest.mark.parametrize("restart_ns", [10**9, 10**12, START_NS + 10**18])
def test_a_sensor_that_restarts_with_another_epoch_goes_on(restart_ns):
    """Such as seconds since boot: 1.7e9 s back are more than seconds in a double resolve to a clock's ppm."""
    stamps_ns = stamps(COUNT)
    stamps_ns[9000:] += restart_ns - stamps_ns[9000]
    found = Conditioned(stamps_ns, MARKED)
    status = found.status
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6) and status.jitter_s < 1e-8
    assert status.runs == 2 and status.rejected == 0 and (np.diff(found.time_s) > 0.0).all()
    delay_ns = round(status.filter_delay_s * 1e9)
    np.testing.assert_array_equal(found.stamps_ns, stamps_ns[-len(found.stamps_ns) :] - delay_ns)
    np.testing.assert_allclose(np.diff(found.time_s[found.begins[1] :]), 1.0 / RATE_HZ, atol=3e-7)
    assert found.conditioner.newest_ns == pytest.approx(int(stamps_ns[-1]), abs=2)


@clocks
@pytest.mark.parametrize("many", [2, 40, 1000])
def test_stamps_that_freeze_for_a_while_are_followed_again(clock, many):
    stamps_ns, late_s, close_s = CLOCKS[clock]
    stamps_ns = stamps_ns.copy()
    stamps_ns[9000 : 9000 + many] = stamps_ns[9000]
    found = Conditioned(stamps_ns, MARKED)
    status = found.status
    # What the clock cannot explain by its jitter is late; those are interpolated, or lie in a gap.
    gap = round(status.gap_s * RATE_HZ)
    assert status.late == status.rejected < many and abs(status.filled + gap - status.late) <= 25
    assert status.runs == (1 if many <= 40 else 2)
    # Lost samples are counted in whole periods; what that is off by decays as (1 + t / 5 s) exp(-t / 5 s).
    last_s = off_s(found, stamps_ns)[-1000:] - late_s
    assert np.abs(last_s).max() < close_s + 0.1 * 0.5 / RATE_HZ


def test_a_driver_that_sets_no_stamps_is_told_and_believed_once_it_does():
    unset = Conditioned(np.zeros(2000, dtype=np.int64), STILL[:2000])
    assert unset.blocks == [] and unset.status.unset == 2000
    assert "header stamps are zero: use log time" in unset.status.fault
    unset.conditioner.push(stamps(COUNT), MARKED)
    status = unset.conditioner.status()
    assert status.fault is None and status.unset == 2000 and status.accepted > 30_000


@pytest.mark.parametrize("set_first", [0, 1, 15])
def test_the_unset_are_told_whatever_came_before(set_first):
    stamps_ns = np.concatenate([stamps(set_first), np.zeros(1000, dtype=np.int64)])
    for cuts in ((), range(1, len(stamps_ns))):
        assert "stamps are zero" in Conditioned(stamps_ns, STILL[: len(stamps_ns)], cuts).status.fault


# --- what waits ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("many", range(1, 20))
@pytest.mark.parametrize("gap_s", [0.005, 0.04, 0.9])
def test_a_record_that_ends_right_behind_a_gap_keeps_its_last_samples(many, gap_s):
    end = stamps(5000)
    end[-many:] += round(gap_s * 1e9)
    found = Conditioned(end, marked(5000))
    # A single stamp that nothing followed may be astray.
    assert found.status.stray == (many == 1) and found.status.accepted == len(found.time_s) - found.status.filled
    assert found.stamps_ns[-1] == (end[-1] if many > 1 else end[-2]) - round(found.status.filter_delay_s * 1e9)


def test_a_leap_that_the_record_ends_with_is_not_believed():
    end = stamps(5000)
    end[-10:] += HOUR_NS
    found = Conditioned(end, marked(5000))
    assert found.status.stray == 10 and found.status.gap_s == 0.0
    more = found.conditioner.push(stamps(6000)[5000:], marked(6000)[5000:])  # after the end as before it
    assert sum(block.time_s.size for block in more) == 1010 and found.conditioner.status().runs == 1
    assert found.conditioner.finish() == []


STREAMS = {
    "zero": lambda n: np.zeros(n.size, dtype=np.int64),
    "frozen": lambda n: np.full(n.size, START_NS + 10**10),
    "one leap, then zero": lambda n: np.where(n == 0, START_NS + HOUR_NS, 0),
    "two by turns": lambda n: START_NS + 10**10 + n % 2 * 10**6,
    "backward": lambda n: START_NS + 10**10 - n * 10**6,
    "creeping": lambda n: START_NS + 10**10 + n,
    "full of gaps": lambda n: START_NS + 10**10 + n * 885_000 + n // 500 * 10**9,
    "not finite": lambda n: START_NS + 10**10 + n * 885_000,
}


@pytest.mark.parametrize("kind", STREAMS)
@pytest.mark.parametrize("rested", [False, True])
def test_a_million_useless_samples_are_not_kept(kind, rested):
    conditioner = Conditioner("seat")
    if rested:
        conditioner.push(stamps(3000), STILL[:3000])
    samples = 5.0 * np.random.default_rng(9).standard_normal((1000, 3)) * (np.nan if kind == "not finite" else 1.0)
    tracemalloc.start()
    try:
        for first in range(0, 1_000_000, 1000):
            conditioner.push(STREAMS[kind](first + np.arange(1000)), samples)
        assert tracemalloc.get_traced_memory()[0] < 3e6  # waiting holds up to 40 000 samples; a million are 32 MB
    finally:
        tracemalloc.stop()
    assert kind == "full of gaps" or (conditioner.status().fault is None) is rested
    later = 10**12 + 10**16
    blocks = conditioner.push(stamps(5000) + later, STILL[:5000]) + conditioner.finish()
    assert sum(block.time_s.size for block in blocks) > 4000  # and after all that it still works


# --- flat lines ------------------------------------------------------------------------------------------------------


def stuck(begin: int, end: int, count: int = COUNT) -> np.ndarray:
    """Marked readings that do not change from the one at `begin` up to `end`."""
    samples = marked(count)
    samples[begin:end] = samples[begin]
    return samples


@pytest.mark.parametrize(("samples", "counted"), [(2257, 0), (2258, 0), (2260, 2259), (9000, 8999)])
def test_a_flat_line_counts_from_its_beginning_once_it_has_lasted(samples, counted):
    # The first of equal readings is news. Two seconds are 2258.6 periods.
    found = Conditioned(stamps(COUNT), stuck(5000, 5000 + samples))
    assert found.status.flat == counted
    assert found.status.flat_s == pytest.approx(counted / RATE_HZ)


def test_readings_that_repeat_now_and_then_are_no_flat_line():
    assert Conditioned(stamps(COUNT), MARKED[1100 + INDEX // 10]).status.flat == 0


@pytest.mark.parametrize("gap_s", [0.03, 1.5, 3600.0, -5.0, -3600.0])
def test_what_passes_between_runs_is_no_part_of_a_flat_line(gap_s):
    # Equal for 1.2 s before the break and for 0.6 s behind it, then for 1.2 s.
    stamps_ns = stamps(COUNT)
    stamps_ns[9000:] += round(gap_s * 1e9)
    before, behind = round(1.2 * RATE_HZ), round(0.6 * RATE_HZ)
    assert Conditioned(stamps_ns, stuck(9000 - before, 9000 + behind)).status.flat == 0
    assert Conditioned(stamps_ns, stuck(9000 - before, 9000 + 2 * behind)).status.flat == before + 2 * behind - 1


def test_a_flat_line_that_is_sent_twice_is_as_long_as_it_was():
    noisy = marked(COUNT) + 0.02 * np.random.default_rng(5).standard_normal(MARKED.shape)
    noisy[5000:9000] = noisy[5000]
    status = Conditioned(np.repeat(stamps(COUNT), 2), np.repeat(noisy, 2, axis=0)).status
    assert status.flat == 3999 and status.duplicate == status.accepted


def test_a_flat_line_under_coarse_stamps_is_not_taken_for_duplicates():
    stamps_ns = CLOCKS["to 10 ms"][0]
    found = Conditioned(stamps_ns, stuck(5000, 15_000))
    assert found.status.flat == 9999 and found.status.duplicate == 0 and found.status.filled == 0
    assert np.abs(found.time_s[-1] - Conditioned(stamps_ns, MARKED).time_s[-1]) < 1e-9


# --- the vertical, given ---------------------------------------------------------------------------------------------

AXES = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@settings(max_examples=40)
@given(AXES, st.sampled_from([1e-200, 1.0, 1e200]), st.booleans())
@example((0.0, 0.0, -1.0), 1.0, False)
@example((1.0, 0.0, 0.0), 1.0, True)
def test_a_given_vertical_of_any_length_levels_with_gravity_or_without(axes, length, gravity_free):
    up = np.array(axes) / np.linalg.norm(axes)
    mounting = rotation_to_vertical(up).T
    accel = ride(2.5)
    samples = raw(accel, mounting) - (naive.GRAVITY * up if gravity_free else 0.0)
    found = Conditioned(stamps(len(accel)), samples, vertical=tuple(length * up))
    status = found.status
    np.testing.assert_allclose(found.levelled, accel[-len(found.levelled) :], atol=1e-6)
    assert status.gravity_mps2 == pytest.approx(0.0 if gravity_free else naive.GRAVITY, abs=1e-6)
    np.testing.assert_allclose(status.vertical, up, atol=1e-9)
    # Without gravity neither gain nor unit can be checked, which is told.
    assert any("gravity at rest reads" in warning for warning in status.warnings) is gravity_free


@pytest.mark.parametrize("tilt_deg", [5.0, 30.0, 90.0])
def test_gravity_beside_a_given_vertical_is_no_step_at_the_start(tilt_deg):
    # A g sin(tilt) that appeared at the first sample would count as a shock.
    tilt = np.radians(tilt_deg)
    given_vertical = (np.sin(tilt), 0.0, np.cos(tilt))
    found = Conditioned(stamps(5000), STILL[:5000], vertical=given_vertical)
    assert np.abs(found.levelled).max() < 1e-9
    assert found.status.gravity_mps2 == pytest.approx(naive.GRAVITY * np.cos(tilt), abs=1e-9)


def test_without_gravity_and_without_a_vertical_the_fault_says_what_to_do():
    found = Conditioned(stamps(3000), STILL[:3000] - STILL[0])
    assert found.blocks == [] and "give it with the parameter vertical" in found.status.fault


@pytest.mark.parametrize("vertical", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (0.0, np.inf, 0.0)])
def test_a_vertical_that_is_no_direction_is_refused(vertical):
    with pytest.raises(InputError, match=r"seat: vertical .* is no direction"):
        Conditioner("seat", vertical=vertical)


# --- the gravity tracker ---------------------------------------------------------------------------------------------


def test_the_tracker_follows_a_step_with_its_time_constant_and_leaves_exposure_alone():
    count = round(200.0 * RATE_HZ)
    samples = np.tile(STILL[0], (count, 1))
    samples[2000:, 2] += 0.5
    record, tracked_s = (stamps(count), samples), 40.0
    off, on = Conditioned(*record), Conditioned(*record, conditioning=ConditioningSettings(gravity_tracker_s=tracked_s))
    np.testing.assert_array_equal(on.levelled, off.levelled)
    np.testing.assert_array_equal(on.time_s, off.time_s)
    since_s = on.time_s - 2000 / RATE_HZ
    wanted = 0.5 * np.exp(-np.maximum(since_s, 0.0) / tracked_s)
    settled = since_s > 0.1
    np.testing.assert_allclose(on.low_passed[settled], wanted[settled], atol=2e-4)
    np.testing.assert_allclose(off.low_passed[settled], 0.5, atol=1e-9)


@settings(max_examples=20)
@given(faulty(), CUTS)
def test_with_the_tracker_any_cut_gives_the_same_bits(record, cuts):
    tracking = ConditioningSettings(gravity_tracker_s=40.0)
    assert_same(Conditioned(*record, cuts, tracking), Conditioned(*record, conditioning=tracking))


def test_the_tracker_is_refused_with_zero_phase_filtering():
    with pytest.raises(InputError, match="gravity_tracker_s is causal"):
        Conditioner("seat", ConditioningSettings(gravity_tracker_s=60.0), "zero_phase")


# --- zero phase ------------------------------------------------------------------------------------------------------


def test_zero_phase_is_scipys_filter_run_by_run_and_delays_nothing():
    rng = np.random.default_rng(10)
    samples = np.concatenate([STILL[:1000], STILL[:5000] + rng.standard_normal((5000, 3))])
    stamps_ns = stamps(6000)
    stamps_ns[2500:] += 10**9
    stamps_ns[4000:] -= 100 * 10**9
    found = Conditioned(stamps_ns, samples, mode="zero_phase")
    assert len(found.blocks) == found.status.runs == 3 and found.status.filter_delay_s == 0.0
    np.testing.assert_array_equal(found.stamps_ns, stamps_ns[-len(found.stamps_ns) :])
    sections = signal.butter(4, 100.0, fs=found.conditioner.rate_hz, output="sos")
    for block in found.blocks:
        wanted = signal.sosfiltfilt(sections, block.levelled_mps2[:, 2])
        np.testing.assert_allclose(block.low_passed_mps2, wanted, atol=1e-12)
    assert [round(block.gap_s, 3) for block in found.blocks] == [0.0, 1.0, 0.0]


@pytest.mark.parametrize(("frequency_hz", "gain"), [(5.0, 1.0), (50.0, 1.0), (100.0, 0.5), (200.0, 0.0)])
def test_zero_phase_has_no_phase_and_6_db_at_the_cut_off(frequency_hz, gain):
    rate_hz = 4000.0
    accel = ride(6.0, rate_hz, frequency_hz)
    found = Conditioned(stamps(len(accel), rate_hz), raw(accel), mode="zero_phase")
    middle = (found.time_s > 2.0) & (found.time_s < 5.0)
    turn = np.exp(-2j * np.pi * frequency_hz * (found.time_s[middle] - 1.0))
    # |H|^2 = 1 / (1 + (f / fc)^8), of the digital filter with the bilinear transform's frequencies.
    warped = np.tan(np.pi * frequency_hz / rate_hz) / np.tan(np.pi * 100.0 / rate_hz)
    assert gain == pytest.approx(1.0 / (1.0 + warped**8), abs=5e-3)
    read = 2.0 * (found.low_passed[middle] * turn).mean() / 2.0
    assert abs(read - -1j / (1.0 + warped**8)) < 2e-4  # a sine is -j at phase 0


@pytest.mark.parametrize("length", [1, 2, 3, 14, 15, 16, 17, 30])
def test_zero_phase_takes_a_run_of_any_length(length):
    samples = np.concatenate([STILL[:1000], STILL[:1000] + np.linspace(0.0, 1.0, 1000)[:, None]])
    stamps_ns = stamps(2000)
    stamps_ns[2000 - length :] += 500_000_000
    found = Conditioned(stamps_ns, samples, mode="zero_phase")
    assert np.isfinite(found.low_passed).all()
    if length > 1:  # a last stamp that nothing follows is not believed
        assert found.blocks[-1].time_s.size == length
        np.testing.assert_allclose(found.blocks[-1].low_passed_mps2, found.blocks[-1].levelled_mps2[:, 2], atol=0.05)


def test_zero_phase_answers_a_run_once_it_has_ended():
    conditioner = Conditioner("seat", mode="zero_phase")
    assert conditioner.push(stamps(5000), STILL[:5000]) == []
    (block,) = conditioner.push(stamps(6000)[5000:] + 10**9, STILL[:1000])
    assert block.begins_run and block.time_s.size > 4000
    assert [b.time_s.size for b in conditioner.finish()] == [1000] and conditioner.finish() == []


# --- survey ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 2.5, 3.7, 10.0, 100.0, 249.0, RATE_HZ, 5000.0, 20_000.0])
def test_a_survey_tells_of_a_sensor_of_any_rate_and_answers_nothing(rate_hz):
    count = max(40, round(2.0 * rate_hz))
    kept = np.delete(np.arange(count), [count // 2, count // 2 + 1, count - 5])
    noisy = STILL[:1] + 0.02 * np.random.default_rng(11).standard_normal((count, 3))
    found = Conditioned(stamps(count, rate_hz)[kept], noisy[kept], mode="survey")
    status = found.status
    assert found.blocks == [] and status.fault is None and status.warnings == ()
    assert status.rate_hz == pytest.approx(rate_hz, rel=1e-6)
    # Two periods of less than 0.05 s are interpolated, of more they are a gap.
    missing_s = status.filled / rate_hz + status.gap_s
    assert missing_s == pytest.approx(3.0 / rate_hz, rel=1e-3) and status.rejected == 0
    assert status.gravity_mps2 == pytest.approx(naive.GRAVITY, rel=1e-2)
    assert status.recorded_s == pytest.approx(count / rate_hz, rel=1e-3)


def test_a_survey_needs_no_gravity():
    status = Conditioned(stamps(3000), STILL[:3000] * 0.01, mode="survey").status
    assert status.fault is None and status.vertical is None and status.gravity_mps2 == pytest.approx(0.0981, abs=1e-4)
