"""Conditioning: gravity and vertical of any mounting, faults, the filter, bad samples, and cuts into blocks."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from conditioned import HOUR_NS, RATE_HZ, REST_S, ROUNDING, START_NS, STILL, Conditioned, raw, ride, stamps
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.spatial.transform import Rotation
from uncompiled import Uncompiled

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioner import Conditioner, ConditioningSettings
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.low_pass import group_delay_s
from biodyn_core.conditioning.tilt import rotation_to_vertical
from biodyn_core.kernels import compiling

SEEDS = st.integers(0, 2**32 - 1)


# --- gravity and vertical --------------------------------------------------------------------------------------------

MOUNTINGS = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


@settings(max_examples=25)
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


def test_a_gain_error_is_levelled_and_reported():
    accel = ride(2.0)
    found = Conditioned(stamps(len(accel)), 1.08 * raw(accel))
    assert found.status.gravity_mps2 == pytest.approx(1.08 * naive.GRAVITY)
    np.testing.assert_allclose(found.levelled[-1000:], 1.08 * accel[-1000:], atol=ROUNDING)
    assert any("gravity at rest reads 10.59" in warning for warning in found.status.warnings)


def test_gravity_is_from_the_first_rest_and_earlier_samples_do_not_count():
    accel = np.concatenate([ride(4.0)[2000:], np.zeros((2000, 3)), ride(3.0)])
    found = Conditioned(stamps(len(accel)), raw(accel))
    assert found.status.gravity_mps2 == pytest.approx(naive.GRAVITY, rel=1e-3)
    assert found.status.warnings == ()
    moving_s = (len(ride(4.0)) - 2000) / RATE_HZ
    assert moving_s + REST_S <= found.status.uncounted_s <= moving_s + 2.0 * REST_S + 0.01
    np.testing.assert_allclose(found.levelled[-1000:], accel[-1000:], atol=0.02)


def test_without_rest_motion_is_averaged_and_reported():
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


FAULTS = [
    (stamps(2000), STILL[:2000] * 0.01, "without gravity the vertical is unknown"),
    (stamps(2000, 100.0), STILL[:2000], "a rate of 100 Hz does not fit, 250 to 20000 Hz"),
    (stamps(60_000, 30_000.0), np.tile(STILL[0], (60_000, 1)), "a rate of 3e+04 Hz does not fit"),
    (np.full(61_000, START_NS), np.tile(STILL[0], (61_000, 1)), "stamps stand still"),
    (stamps(20_000), STILL * np.nan, "no finite sample arrived"),
]


@pytest.mark.parametrize(
    ("stamps_ns", "samples", "cause"), FAULTS, ids=lambda value: value if type(value) is str else ""
)
def test_a_faulty_sensor_has_a_one_line_fault_and_no_blocks(stamps_ns, samples, cause):
    found = Conditioned(stamps_ns, samples)
    assert found.blocks == []
    assert found.status.fault.startswith("seat: ") and cause in found.status.fault
    assert "\n" not in found.status.fault


@pytest.mark.parametrize(
    ("stamps_ns", "samples", "cause"), FAULTS, ids=lambda value: value if type(value) is str else ""
)
def test_a_repaired_sensor_is_used(stamps_ns, samples, cause):
    found = Conditioned(stamps_ns, samples)
    later = int(stamps_ns[-1]) - START_NS + 10**9
    accel = ride(3.0)
    (block,) = found.conditioner.push(stamps(len(accel)) + later, raw(accel))
    status = found.conditioner.status()
    assert status.fault is None and status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6)
    np.testing.assert_allclose(block.levelled_mps2[-500:], accel[-500:], atol=1e-6)
    assert status.uncounted_s > 0.99 * len(samples) / RATE_HZ  # the time of waiting is reported


@pytest.mark.parametrize(("cutoff_hz", "fits"), [(100.0, True), (150.0, False)])
def test_the_rate_must_be_sufficient_for_the_low_pass(cutoff_hz, fits):
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


def test_even_stamps_are_kept_without_the_delay():
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


def test_a_drifting_clock_is_tracked():
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


@settings(max_examples=18)
@given(st.lists(st.tuples(st.integers(1300, 3800), st.integers(1, 54)), max_size=4))
def test_lost_samples_are_interpolated_and_counted(gaps):
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


def test_interpolation_is_linear():
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
def test_an_impossible_sample_counts_as_lost(value, axis):
    accel = ride(3.0)
    samples, kept = raw(accel), np.ones(len(accel), dtype=bool)
    for at in (300, 1800, 1801, 2500):  # the first while it looks for rest
        samples[at, axis], kept[at] = value, False
    found = Conditioned(stamps(len(accel)), samples)
    wanted = Conditioned(stamps(len(accel))[kept], raw(accel)[kept])
    assert found.status.non_finite == 4 and found.status.filled == 3 and found.status.runs == 1
    np.testing.assert_allclose(found.levelled, wanted.levelled, atol=ROUNDING)
    np.testing.assert_allclose(found.low_passed, wanted.low_passed, atol=ROUNDING)


@settings(max_examples=30)
@given(st.integers(880, 925), st.integers(1, 40), st.sampled_from(BAD))
def test_bad_samples_around_the_end_of_rest_have_no_effect(begin, length, value):
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


@settings(max_examples=20)
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


def test_stamps_that_jump_back_begin_a_new_run_with_increasing_time():
    accel = ride(3.0)
    laps = 4
    found = Conditioned(np.tile(stamps(len(accel)), laps), np.tile(raw(accel), (laps, 1)))
    assert found.status.runs == laps and found.status.fault is None
    assert np.diff(found.time_s).min() > 0.0
    ends = [*found.begins[1:], len(found.time_s)]
    second, third = (slice(found.begins[lap], ends[lap]) for lap in (1, 2))
    assert ends[1] - found.begins[1] == len(accel)  # twenty stamps in a row confirm a jump, and none of them is lost
    np.testing.assert_array_equal(found.low_passed[second], found.low_passed[third])
    np.testing.assert_array_equal(found.stamps_ns[second], found.stamps_ns[third])


GOOD, UNSET, NON_FINITE, DUPLICATE = range(4)
IMPOSSIBLE = (np.nan, -np.inf, 1600.0)  # ten times 16 g is 1569 m/s^2


def spoiled(faults: list[tuple[int, int, int]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A rest and a ride with faults (first sample, number, cause): stamps (n,), readings (n, 3), cause of each (n,).

    A duplicate follows its sample.
    """
    samples = raw(ride(6.0)) + 0.01 * np.random.default_rng(4).standard_normal((len(ride(6.0)), 3))
    stamps_ns, causes = stamps(len(samples)), np.full(len(samples), GOOD)
    for at, many, cause in faults:
        causes[at : at + many] = cause
    stamps_ns[causes == UNSET] = 0
    hit = np.flatnonzero(causes == NON_FINITE)
    samples[hit, hit % 3] = np.take(IMPOSSIBLE, hit // 3 % 3)
    twice = causes == DUPLICATE
    causes[twice] = GOOD
    order = np.repeat(np.arange(len(causes)), 1 + twice)
    causes = causes[order]
    causes[np.flatnonzero(np.diff(order) == 0) + 1] = DUPLICATE
    return stamps_ns[order], samples[order], causes


SPOILS = st.lists(
    st.tuples(st.integers(0, 2400), st.sampled_from([1, 3, 40, 300, 900]), st.integers(UNSET, DUPLICATE)), max_size=5
)


@settings(max_examples=40)
@given(SPOILS, st.lists(st.integers(0, 6000), max_size=6).map(sorted), st.booleans())
@example([(100, 3, NON_FINITE)], [], False)  # during the search for rest
@example([(0, 300, NON_FINITE)], [50, 800], False)
@example([(0, 900, NON_FINITE)], [], True)
@example([(400, 40, DUPLICATE), (900, 10, DUPLICATE)], [450, 451], False)  # to the end of the search and after it
@example([(0, 40, DUPLICATE), (200, 300, UNSET)], [], False)  # the search restarts behind a gap
@example([(0, 40, DUPLICATE), (200, 300, UNSET)], [], True)
def test_every_sample_is_accepted_or_rejected_once_or_is_of_the_rest(faults, cuts, is_known):
    stamps_ns, samples, causes = spoiled(faults)
    gravity = Gravity((0.0, 0.0, naive.GRAVITY), "motion") if is_known else None
    found = Conditioned(stamps_ns, samples, cuts, ConditioningSettings(rest_patience_s=1.0), gravity=gravity)
    status = found.status
    counted = (status.unset, status.non_finite, status.duplicate, status.late, status.stray)
    assert counted == (*(int((causes == cause).sum()) for cause in (UNSET, NON_FINITE, DUPLICATE)), 0, 0)
    begin_ns = found.stamps_ns[0] + round(status.filter_delay_s * 1e9) - round(0.5e9 / RATE_HZ)
    before = int((stamps_ns[causes == GOOD] < begin_ns).sum())
    assert status.accepted + status.rejected + before == len(causes)


@pytest.mark.parametrize("cut", [1, 7, 350])
def test_rejected_samples_are_counted_while_rest_is_searched_for(cut):
    stamps_ns, samples, causes = spoiled([(0, 1, UNSET), (20, 300, NON_FINITE), (330, 5, UNSET)])
    conditioner = Conditioner("seat")
    for begin in range(0, 700, cut):
        conditioner.push(stamps_ns[begin : begin + cut], samples[begin : begin + cut])
        status, given = conditioner.status(), causes[: begin + cut]
        assert status.waiting is not None and status.accepted == 0
        assert (status.unset, status.non_finite) == ((given == UNSET).sum(), (given == NON_FINITE).sum())


@pytest.mark.parametrize("is_known", [True, False])
def test_rejected_samples_of_a_record_without_a_clock_are_counted(is_known):
    stamps_ns, samples, _ = spoiled([(0, 1, UNSET), (20, 30, NON_FINITE)])
    gravity = Gravity((0.0, 0.0, naive.GRAVITY), "motion") if is_known else None
    status = Conditioned(stamps_ns[:100], samples[:100], gravity=gravity).status
    assert status.rate_hz is None and (status.unset, status.non_finite) == (1, 30)


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
    """A ride with jitter and any mixture of faults of stamps and samples, also during rest."""
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


@settings(max_examples=60)
@given(faulty(), CUTS, st.sampled_from([None, 0.05]))
def test_any_cut_into_blocks_gives_the_same_bits_for_any_fault(record, cuts, flat_s):
    conditioning = ConditioningSettings(flat_s=flat_s) if flat_s else None
    whole, cut = Conditioned(*record, conditioning=conditioning), Conditioned(*record, cuts, conditioning)
    assert_same(cut, whole)
    assert np.isfinite(whole.low_passed).all()
    # Between runs time inside jumps back only where stamps that had leapt ahead return.
    assert all((np.diff(run) > 0.0).all() for run in np.split(whole.time_s, whole.begins))
    assert whole.status.gap_s >= 0.0


@settings(max_examples=20)
@given(faulty(), CUTS, st.sampled_from(["zero_phase", "survey"]))
def test_any_cut_gives_the_same_in_the_other_modes_and_counts_alike(record, cuts, mode):
    whole, cut = Conditioned(*record, mode=mode), Conditioned(*record, cuts, mode=mode)
    assert_same(cut, whole)
    causal = Conditioned(*record)
    for name in set(vars(causal.status)) - {"filter_delay_s"}:
        assert getattr(whole.status, name) == getattr(causal.status, name), name
    np.testing.assert_array_equal(whole.levelled, causal.levelled if mode == "zero_phase" else np.empty((0, 3)))


@settings(max_examples=15)
@given(faulty(), CUTS)
def test_a_survey_in_plain_python_equals_the_compiled_one(record, cuts):
    compiled = Conditioned(*record, cuts, mode="survey").status
    with pytest.MonkeyPatch.context() as patch:
        Uncompiled(patch)
        patch.setattr(compiling, "COMPILED", False)
        plain = Conditioned(*record, cuts, mode="survey").status
    tracked = ("rate_hz", "jitter_s")  # contracted multiplications may differ in the last bit
    found, wanted = vars(plain) | dict.fromkeys(tracked), vars(compiled) | dict.fromkeys(tracked)
    assert found == wanted
    if compiled.rate_hz is not None:
        assert plain.rate_hz == pytest.approx(compiled.rate_hz, rel=1e-9)
        assert plain.jitter_s == pytest.approx(compiled.jitter_s, rel=1e-9)


@settings(max_examples=18)
@given(faulty(), CUTS, st.sampled_from([{}, {"cutoff_hz": 200.0}, {"rest_rms_mps2": 0.01, "rest_patience_s": 2.0}]))
def test_the_rest_mode_finds_the_begin_of_the_causal_path(record, cuts, how):
    stamps_ns, samples = record
    causal, rest = (Conditioner("seat", ConditioningSettings(**how), mode) for mode in ("causal", "rest"))
    for here in np.split(np.arange(len(stamps_ns)), cuts):
        causal.push(stamps_ns[here], samples[here])
        assert rest.push(stamps_ns[here], samples[here]) == []
    assert rest.finish() == []
    assert (rest.rest, rest.fault, rest.first_ns) == (causal.rest, causal.fault, causal.first_ns)


@settings(max_examples=4)
@given(faulty())
def test_sample_by_sample_it_is_the_same_for_any_fault(record):
    assert_same(Conditioned(*record, cuts=range(1, len(record[0]))), Conditioned(*record))


def assert_same(found: Conditioned, wanted: Conditioned) -> None:
    for name in ("stamps_ns", "time_s", "levelled", "low_passed", "begins"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    assert found.status == wanted.status


def test_sample_by_sample_gives_the_same_bits():
    accel = ride(2.5)
    record = np.delete(stamps(len(accel)), np.arange(2000, 2010)), np.delete(raw(accel), np.arange(2000, 2010), axis=0)
    assert_same(Conditioned(*record, cuts=range(1, len(record[0]))), Conditioned(*record))


def test_an_empty_input_gives_an_empty_output():
    conditioner = Conditioner("seat")
    assert conditioner.push(np.empty(0, dtype=np.int64), np.empty((0, 3))) == []
    status = conditioner.status()
    assert (status.rate_hz, status.gravity_mps2, status.vertical, status.filter_delay_s) == (None,) * 4
    assert (status.accepted, status.runs, status.uncounted_s, status.fault) == (0, 0, 0.0, None)


def test_read_only_and_strided_arrays_are_accepted():
    accel = ride(2.0)
    wide = np.zeros((len(accel), 6), dtype=">f8")
    wide[:, ::2] = raw(accel)
    view = wide[:, ::2]
    view.flags.writeable = False
    assert_same(Conditioned(stamps(len(accel)), view), Conditioned(stamps(len(accel)), raw(accel)))


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
    # Without gravity neither gain nor unit can be checked, which is reported.
    assert any("gravity at rest reads" in warning for warning in status.warnings) is gravity_free


@pytest.mark.parametrize("tilt_deg", [5.0, 30.0, 90.0])
def test_gravity_beside_a_given_vertical_is_no_step_at_the_start(tilt_deg):
    # A g sin(tilt) that appeared at the first sample would count as a shock.
    tilt = np.radians(tilt_deg)
    given_vertical = (np.sin(tilt), 0.0, np.cos(tilt))
    found = Conditioned(stamps(5000), STILL[:5000], vertical=given_vertical)
    assert np.abs(found.levelled).max() < 1e-9
    assert found.status.gravity_mps2 == pytest.approx(naive.GRAVITY * np.cos(tilt), abs=1e-9)


def test_without_gravity_and_without_a_vertical_the_fault_has_a_remedy():
    found = Conditioned(stamps(3000), STILL[:3000] - STILL[0])
    assert found.blocks == [] and "give it with the parameter vertical" in found.status.fault


@pytest.mark.parametrize("vertical", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (0.0, np.inf, 0.0)])
def test_an_invalid_vertical_is_refused(vertical):
    with pytest.raises(InputError, match=r"seat: vertical .* is not a direction"):
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


@settings(max_examples=8)
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


def test_zero_phase_returns_a_run_at_its_end():
    conditioner = Conditioner("seat", mode="zero_phase")
    assert conditioner.push(stamps(5000), STILL[:5000]) == []
    (block,) = conditioner.push(stamps(6000)[5000:] + 10**9, STILL[:1000])
    assert block.begins_run and block.time_s.size > 4000
    assert [b.time_s.size for b in conditioner.finish()] == [1000] and conditioner.finish() == []


# --- survey ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [1.0, 2.0, 2.5, 3.7, 10.0, 100.0, 249.0, RATE_HZ, 5000.0, 20_000.0])
def test_a_survey_gives_the_status_of_any_rate_without_blocks(rate_hz):
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
