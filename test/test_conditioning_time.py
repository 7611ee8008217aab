"""Conditioning with clocks as in the field: drift, jitter, bursts, leaps, repeats, losses and flat readings."""

from __future__ import annotations

import tracemalloc
from functools import cache

import numpy as np
import pytest
from conditioned import HOUR_NS, RATE_HZ, START_NS, STILL, Conditioned, stamps

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.runs import LAP_S, Runs

# --- clocks that are not what they should be -------------------------------------------------------------------------


@pytest.mark.parametrize("ppm", [-20.0, -200.0])
def test_a_sensor_of_the_lowest_rate_is_accepted_though_its_clock_drifts(ppm):
    found = Conditioned(stamps(1000, 250.0 * (1.0 + ppm * 1e-6)), STILL[:1000])
    assert found.status.fault is None


def test_a_fifth_of_a_millisecond_of_jitter_adds_no_samples():
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
    """Readings (n, 3) at rest whose first axis counts samples once rest is over, so that each identifies itself.

    The other axes flicker a little, because axes that never change beside one that moves are dead.
    """
    samples = STILL[0] + 1e-10 * (np.arange(count) % 2)[:, None]
    samples[:, 0] = 1e-3 * np.maximum(np.arange(count) - MARKED_FROM, 0)
    return samples


MARKED = marked()
INDEX = np.arange(COUNT)


def off_s(found: Conditioned, stamps_ns: np.ndarray, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Smoothed time less the time at which each sample, interpolated ones too, was really taken."""
    marks = found.levelled[:, 0] / 1e-3
    marked = marks > 100.0  # samples interpolated between marked and unmarked ones carry no number
    assert (np.diff(marks[marked]) > 0.0).all()  # in the true order
    begins_s = (stamps_ns[0] - START_NS) * 1e-9  # inside, time counts from the first stamp
    taken_s = (marks[marked] + MARKED_FROM) / rate_hz
    return found.time_s[marked] + found.status.filter_delay_s + begins_s - taken_s


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
    # Losses that stamps cannot show are reported.
    assert bool(status.warnings) is (clock in ("to 10 ms", "bursts", "jitter 0.5 ms", "jitter 5 ms"))
    cause = "several samples share a stamp (about 10 ms)" if clock == "to 10 ms" else "jitter"
    assert all(cause in warning for warning in status.warnings)
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=20e-6)
    assert np.abs(off_s(found, stamps_ns) - late_s).max() < close_s
    np.testing.assert_allclose(np.diff(found.time_s), 1.0 / RATE_HZ, rtol=0.1)
    assert status.recorded_s == pytest.approx(COUNT / RATE_HZ, abs=0.01)


@pytest.mark.parametrize("rate_hz", [250.0, 400.0, 600.0, 800.0, 833.0, 952.0, 1000.0, 1100.0, 1600.0, 3200.0])
@pytest.mark.parametrize("quantum_ms", [1, 4, 10])
@pytest.mark.parametrize("step_mps2", [0.0, 0.0766])
def test_coarse_stamps_of_any_rate_lose_and_add_no_samples(rate_hz, quantum_ms, step_mps2):
    # Coarse readings, of 12 bits, repeat as well: with their stamp they look like messages sent twice.
    count, quantum_ns = round(4.0 * rate_hz), quantum_ms * 10**6
    samples = STILL[:1] + 0.02 * np.random.default_rng(2).standard_normal((count, 3))
    if step_mps2:
        samples = np.rint(samples / step_mps2) * step_mps2
    status = Conditioned(stamps(count, rate_hz) // quantum_ns * quantum_ns, samples).status
    assert status.rate_hz == pytest.approx(rate_hz, rel=100e-6)
    assert status.rejected == status.filled == 0 and status.runs == 1


@pytest.mark.parametrize(("rate_hz", "quantum_ms"), [(250.0, 1), (1000.0, 1), (1600.0, 1), (250.0, 20), (4000.0, 4)])
def test_losses_under_coarse_stamps_are_counted_or_a_warning_says_otherwise(rate_hz, quantum_ms):
    count, quantum_ns = round(20.0 * rate_hz), quantum_ms * 10**6
    stamps_ns = (stamps(count, rate_hz) + 300_000) // quantum_ns * quantum_ns
    lost = np.random.default_rng(3).choice(np.arange(round(2.0 * rate_hz), count - 100), 50, replace=False)
    kept = np.delete(np.arange(count), lost)
    samples = STILL[:1] + 0.02 * np.random.default_rng(2).standard_normal((kept.size, 3))
    status = Conditioned(stamps_ns[kept], samples).status
    is_counted = abs(status.filled - status.rejected - lost.size) <= 1
    assert bool(status.warnings) is not is_counted
    assert all("several samples share a stamp" in line for line in status.warnings)


@pytest.mark.parametrize("ppm", [-500.0, -50.0, 500.0])
@pytest.mark.parametrize("jitter_ms", [0.0, 0.05])
def test_a_drifting_clock_is_tracked_and_reported_in_ppm(ppm, jitter_ms):
    own_hz = RATE_HZ * (1.0 + ppm * 1e-6)
    stamps_ns = stamps(COUNT, own_hz) + (jittering(jitter_ms) - stamps(COUNT))
    found = Conditioned(stamps_ns, MARKED)
    assert found.status.rate_hz == pytest.approx(own_hz, rel=1e-9 + 20e-6 * jitter_ms)
    assert np.abs(off_s(found, stamps_ns, own_hz)).max() < 1e-8 + 0.27e-3 * jitter_ms


@pytest.mark.parametrize("delay_ms", [0.1, 1.0])
def test_late_callbacks_lose_and_add_no_samples(delay_ms):
    # No stamp is earlier than the one before: a queue that stalls, and then empties in no time.
    delay_ns = np.random.default_rng(1).exponential(delay_ms * 1e6, COUNT)
    stamps_ns = np.maximum.accumulate(stamps(COUNT) + np.rint(delay_ns).astype(np.int64))
    found = Conditioned(stamps_ns, MARKED)
    assert found.status.rejected == found.status.filled < 1e-4 * COUNT and found.status.runs == 1
    mean_s = float((stamps_ns - stamps(COUNT)).mean()) * 1e-9
    far_s = np.abs(off_s(found, stamps_ns) - mean_s)
    # Of two samples with one stamp the second is late if the clock is accurate: the first has its place.
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
def test_a_rate_that_differs_from_that_at_rest_is_reported(later_hz):
    stamps_ns = np.concatenate([stamps(3000), stamps(3000)[-1] + stamps(20_000, later_hz)[1:] - START_NS])
    status = Conditioned(stamps_ns, STILL[np.zeros(len(stamps_ns), dtype=int)]).status
    # Faster than at rest, excess samples count as late; slower, samples are interpolated or the clock cannot follow.
    counted = status.late if later_hz > RATE_HZ else status.filled
    warned = any("rate differs by 2 %" in warning for warning in status.warnings)
    assert warned or counted > 0.8 * 20_000 * abs(RATE_HZ / later_hz - 1.0) > 4000


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
    assert status.rejected == status.duplicate + status.late == COUNT  # every second message, at rest too
    for name in ("rate_hz", "accepted", "filled", "runs", "uncounted_s"):
        assert getattr(status, name) == pytest.approx(getattr(wanted.status, name), rel=1e-9), name


def test_a_second_publisher_and_a_gap_are_distinguished():
    kept = np.delete(INDEX, np.arange(9000, 9030))
    found = Conditioned(np.repeat(stamps(COUNT)[kept], 2), np.repeat(MARKED[kept], 2, axis=0))
    assert found.status.filled == 30 and found.status.duplicate == kept.size
    assert np.abs(off_s(found, stamps(COUNT))).max() < 1e-7


@pytest.mark.parametrize("late_s", [0.002, 0.05])
def test_few_samples_out_of_order_count_as_lost(late_s):
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
    # Used samples have the true order (`off_s` asserts it) and the true time; the others are reported.
    assert np.abs(off_s(found, stamps(COUNT)[order])).max() < 1e-4
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=1e-6)
    assert status.rejected > 0.1 * COUNT and status.filled == pytest.approx(status.rejected, rel=0.05)


# --- stamps that leap, stand still, or were never set ----------------------------------------------------------------

signs = pytest.mark.parametrize("sign", [-1, 1])


@cache
def unspoilt(clock):
    """The marked samples by a clock without faults; read-only."""
    return Conditioned(CLOCKS[clock][0], MARKED)


@clocks
@signs
@pytest.mark.parametrize("many", [1, 5, 19])
def test_a_few_stray_stamps_lose_only_their_samples(clock, sign, many):
    stamps_ns = CLOCKS[clock][0].copy()
    stamps_ns[9000 : 9000 + many] += sign * HOUR_NS
    found, whole = Conditioned(stamps_ns, MARKED), unspoilt(clock)
    status = found.status
    assert (status.stray if sign > 0 else status.late) == status.rejected == status.filled == many
    assert status.runs == 1 and status.gap_s == 0.0
    np.testing.assert_allclose(found.time_s, whole.time_s, atol=CLOCKS[clock][2])
    np.testing.assert_allclose(found.levelled, whole.levelled, atol=1e-9)  # a straight line, where marks lie on one


@clocks
@pytest.mark.parametrize("what", ["zero", "bad"])
def test_unset_stamps_and_bad_readings_lose_only_their_samples(clock, what):
    hit = np.random.default_rng(8).random(COUNT) < 0.02
    hit[:1000] = hit[-1000:] = False
    hit[20_000:20_040] = True
    stamps_ns, samples = np.where(hit & (what == "zero"), 0, CLOCKS[clock][0]), MARKED.copy()
    if what == "bad":
        samples[hit, 1] = np.nan
    found, whole = Conditioned(stamps_ns, samples), unspoilt(clock)
    status = found.status
    assert (status.unset if what == "zero" else status.non_finite) == status.rejected == status.filled == hit.sum()
    assert status.runs == 1
    np.testing.assert_allclose(found.time_s, whole.time_s, atol=CLOCKS[clock][2])
    np.testing.assert_allclose(found.levelled, whole.levelled, atol=1e-9)


@clocks
@signs
@pytest.mark.parametrize("leap_ns", [2 * 10**9, HOUR_NS, 2 * 10**15, 10**18])
def test_thirty_stamps_in_a_row_confirm_a_leap_and_its_return(clock, sign, leap_ns):
    stamps_ns = CLOCKS[clock][0].copy()
    stamps_ns[9000:9030] += sign * leap_ns
    found = Conditioned(stamps_ns, MARKED)
    status = found.status
    assert status.runs == 3 and status.rejected == status.filled == 0  # none is lost
    straight = unspoilt(clock)
    assert len(found.time_s) == len(straight.time_s)
    # Once they have returned, time inside is what it was all along: other sensors are met again.
    np.testing.assert_allclose(found.time_s[-1000:], straight.time_s[-1000:], atol=0.015)
    # Nothing was missing, but that each run begins with a stamp that jitters as they do.
    assert status.gap_s == pytest.approx(0.0, abs=0.03) and status.recorded_s == pytest.approx(30.1, abs=0.05)
    assert status.rate_hz == pytest.approx(RATE_HZ, rel=50e-6)
    # Before its return the leap is not known.
    unreturned = Conditioned(stamps_ns[:9030], MARKED[:9030]).status
    assert unreturned.gap_s == pytest.approx(leap_ns * 1e-9 if sign > 0 else 0.0, abs=0.02)


@pytest.mark.parametrize(("repeated", "counted"), [(19, 0), (20, 20)])
def test_twenty_samples_of_a_repeated_interval_show_a_clock_set_back(repeated, counted):
    stamps_ns = stamps(3000 + repeated + 1)
    status = Conditioned(
        np.r_[stamps_ns[:3000], stamps_ns[3000 - repeated - 1 :]], STILL[: 3000 + 2 * repeated + 2]
    ).status
    assert status.set_back_s == pytest.approx(counted / RATE_HZ) and status.filled == 0


def test_samples_lost_while_stamps_leap_stay_missing():
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


@pytest.mark.parametrize("dropout_first", [True, False])
def test_a_dropout_is_no_return_from_a_leap_by_as_much_a_minute_away(dropout_first):
    """All clocks are set back 1.5 s, and two minutes before or after it two seconds are lost."""
    runs, period_s = Runs(), 1.0 / RATE_HZ
    leaps_ns = [2 * 10**9, -1_500_000_000] if dropout_first else [-1_500_000_000, 2 * 10**9]
    begin_ns = START_NS
    for leap_ns in (0, *leaps_ns):
        begin_ns += leap_ns
        runs.end(begin_ns, period_s)
        runs.add(begin_ns, begin_ns + 120 * 10**9, period_s)
        begin_ns += 120 * 10**9
    assert runs.gap_s == runs.leap_gap_s == pytest.approx(2.0, abs=0.01)
    assert runs.lap_s == LAP_S


def test_a_looping_bag_with_a_gap_has_it_in_every_lap():
    lap = stamps(6000)
    lap[4000:] += 5 * 10**9
    status = Conditioned(np.tile(lap, 3), np.tile(marked(6000), (3, 1))).status
    assert status.gap_s == pytest.approx(15.0, abs=1e-3) and status.runs == 6 and status.rejected == 0


def test_thirty_stamps_from_the_start_of_a_looping_bag_are_no_second_lap_of_missing_seconds():
    status = Conditioned(np.tile(stamps(6000), 50), np.tile(marked(6000), (50, 1))).status
    assert status.gap_s == 0.0 and status.runs == 50 and status.rejected == 0


@pytest.mark.parametrize("restart_ns", [10**9, 10**12, START_NS + 10**18])
def test_a_sensor_that_restarts_with_another_epoch_is_counted_further(restart_ns):
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
    # Samples later than jitter explains are rejected; their instants are interpolated, or lie in a gap.
    gap = round(status.gap_s * RATE_HZ)
    assert status.late == status.rejected < many and abs(status.filled + gap - status.late) <= 25
    assert status.runs == (1 if many <= 40 else 2)
    # Lost samples are counted in whole periods; the error of that decays as (1 + t / 5 s) exp(-t / 5 s).
    last_s = off_s(found, stamps_ns)[-1000:] - late_s
    assert np.abs(last_s).max() < close_s + 0.1 * 0.5 / RATE_HZ


def test_a_driver_without_stamps_is_reported_until_it_sets_them():
    unset = Conditioned(np.zeros(2000, dtype=np.int64), STILL[:2000])
    assert unset.blocks == [] and unset.status.unset == 2000
    assert "stamps are zero: set header stamps in the driver" in unset.status.fault
    unset.conditioner.push(stamps(COUNT), MARKED)
    status = unset.conditioner.status()
    assert status.fault is None and status.unset == 2000 and status.accepted > 30_000


@pytest.mark.parametrize("set_first", [0, 1, 15])
def test_unset_stamps_are_reported_after_any_samples(set_first):
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


def test_a_leap_at_the_end_of_a_record_is_not_confirmed():
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


@pytest.mark.slow
@pytest.mark.parametrize("kind", STREAMS)
@pytest.mark.parametrize("rested", [False, True])
def test_memory_is_bounded_over_a_million_unusable_samples(kind, rested):
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
def test_time_between_runs_is_no_part_of_a_flat_line(gap_s):
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
    assert status.flat == 3999 and status.duplicate == COUNT


def test_a_flat_line_under_coarse_stamps_is_not_taken_for_duplicates():
    stamps_ns = CLOCKS["to 10 ms"][0]
    found = Conditioned(stamps_ns, stuck(5000, 15_000))
    assert found.status.flat == 9999 and found.status.duplicate == 0 and found.status.filled == 0
    assert np.abs(found.time_s[-1] - Conditioned(stamps_ns, MARKED).time_s[-1]) < 1e-9


def one_axis_dead(axis: int, begin: int, end: int, others: float = 1.0) -> np.ndarray:
    """Readings of a sensor with 3 % of tilt, of which one axis does not change; others: amplitude of the other ones."""
    phase = 0.05 * np.arange(COUNT)[:, None] + [0.0, 1.0, 2.0]
    samples = [0.2, 0.2, 9.8] + others * np.sin(phase) * (np.arange(COUNT) > 2000)[:, None]
    samples[begin:end, axis] = samples[begin, axis]
    return samples


@pytest.mark.parametrize(
    ("sensor", "axis", "flat", "dead"),
    [("seat", 0, 0, 4999), ("seat", 2, 4999, 4999), ("head", 0, 0, 4999), ("neck", 0, 0, 0), ("neck", 2, 4999, 4999)],
)
def test_an_axis_that_does_not_change_while_another_one_moves_is_dead(sensor, axis, flat, dead):
    """A dead axis of the vertical makes a flat line; of horizontal axes, figures need those of seat and head."""
    conditioner = Conditioner(sensor)
    conditioner.push(stamps(COUNT), one_axis_dead(axis, 5000, 10_000))
    found = conditioner.status()
    assert (found.flat, found.dead) == (pytest.approx(flat, abs=60), pytest.approx(dead, abs=60))


def test_an_axis_that_does_not_change_at_rest_is_not_dead():
    """A coarse sensor stays on one step, while the others move by a few."""
    conditioner = Conditioner("seat")
    conditioner.push(stamps(COUNT), one_axis_dead(2, 5000, 15_000, others=0.2))
    assert (conditioner.status().flat, conditioner.status().dead) == (0, 0)


# --- readings that are sent several times ----------------------------------------------------------------------------


def moving(times_s: np.ndarray, step_mps2: float = 0.0005, noise_mps2: float = 0.01, size: float = 1.5) -> np.ndarray:
    """Readings (n, 3) at these times, in steps: a second and a half at rest, then 3 to 8 Hz on all axes."""
    sway = np.sin(2.0 * np.pi * times_s[:, None] * [3.1, 5.3, 7.9] + [0.0, 1.0, 2.0]) * [0.2 * size, 0.3 * size, size]
    noise = noise_mps2 * np.random.default_rng(4).standard_normal(sway.shape)
    samples = [0.0, 0.0, STANDARD_GRAVITY_MPS2] + sway * (times_s > 1.5)[:, None] + noise
    return np.rint(samples / step_mps2) * step_mps2


def held(own_hz: float, sent_hz: float, step_mps2: float, size: float) -> np.ndarray:
    """What a driver sends on a timer for ten seconds from a slower sensor: its newest reading."""
    times_s = np.arange(round(10.0 * sent_hz)) / sent_hz
    newest = np.floor(times_s * own_hz + 0.3).astype(np.int64)
    return moving(np.arange(newest[-1] + 1) / own_hz, step_mps2, size=size)[newest]


@pytest.mark.parametrize(
    ("own_hz", "sent_hz", "times", "end"),
    [
        (100.0, 1000.0, "10", ", and motion above 50 Hz gives wrong figures"),
        (104.0, 1000.0, "9.6", ", and motion above 52 Hz gives wrong figures"),
        (50.0, 250.0, "5", ", and motion above 25 Hz gives wrong figures"),
        (500.0, 1000.0, "2", ""),
    ],
)
@pytest.mark.parametrize("step_mps2", [0.0005, 0.0766])
def test_readings_that_are_sent_several_times_are_reported(own_hz, sent_hz, times, end, step_mps2):
    # A reading of 12 bits changes by three steps within 2 ms only in strong motion.
    samples = held(own_hz, sent_hz, step_mps2, size=0.03 * own_hz)
    whole = Conditioned(stamps(len(samples), sent_hz), samples).status
    line = f"each reading is sent {times} times: the sensor measures at about {own_hz:.0f} Hz"
    assert whole.warnings == (line + end,)
    assert Conditioned(stamps(len(samples), sent_hz), samples, cuts=range(1, len(samples), 97)).status == whole


def some_sent_twice(samples: np.ndarray) -> np.ndarray:
    again = np.flatnonzero(np.random.default_rng(6).random(len(samples)) < 0.2)[1:]
    samples[again] = samples[again - 1]
    return samples


def flat_at_times(samples: np.ndarray) -> np.ndarray:
    for begin in range(3000, len(samples) - 2000, 900):
        samples[begin : begin + 500] = samples[begin]
    return samples


@pytest.mark.parametrize(
    "samples",
    [
        moving(INDEX / RATE_HZ, step_mps2=0.0766, noise_mps2=0.0, size=0.3),
        moving(INDEX / RATE_HZ, step_mps2=0.0766, noise_mps2=0.02, size=1.0),
        moving(INDEX / RATE_HZ, step_mps2=0.31, noise_mps2=0.1, size=3.0),
        some_sent_twice(moving(INDEX / RATE_HZ)),
        flat_at_times(moving(INDEX / RATE_HZ)),
    ],
    ids=["slow and coarse", "coarse", "very coarse", "some sent twice", "flat at times"],
)
def test_other_readings_that_repeat_are_not_taken_for_those_of_a_slower_sensor(samples):
    assert not Conditioned(stamps(COUNT), samples).status.warnings
