"""One sensor's path: clock, gaps, flat lines, level, low-pass.

What a sensor carries on from sample to sample lies in one array of floats and one of counts, laid out here: a call
costs by the number of its arguments, and the live path calls once a sample.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.compiling import compiled, inlined

SECTIONS: Final = 2

# The array of floats: the clock, seconds since the sensor's epoch ...
TIME, PERIOD, NOMINAL, LAST_STAMP, JITTER, SLIP, FLAT_SINCE = range(7)
# ... the last accepted reading (3), the rotation that levels (3 x 3), the low-pass (sections x 6) and its state ...
LAST: Final = 7
ROTATION: Final = LAST + 3
LOW_PASS: Final = ROTATION + 9
LOW_PASS_STATE: Final = LOW_PASS + 6 * SECTIONS
# ... and what was set for good: limits, gains, whether samples share a stamp, the mean reading at rest (3), which is
# gravity and bias; the slow level of the gravity tracker is carried, and between which stamps the last hole lies. For
# the search for rails each call leaves the reading before its first (3), whether the two join, and the largest reading.
(
    MAX_GAP,
    FLAT_AFTER,
    SATURATION,
    GAIN_TIME,
    GAIN_PERIOD,
    COARSE,
    TRACKER_GAIN,
    TRACKED_LEVEL,
    HOLE_FROM,
    HOLE_TO,
    AT_REST,
) = range(LOW_PASS_STATE + 2 * SECTIONS, LOW_PASS_STATE + 2 * SECTIONS + 11)
BEFORE: Final = AT_REST + 3
JOINED, LARGEST, STATE_SIZE = range(BEFORE + 3, BEFORE + 6)

# The array of counts: what was accepted and rejected, then what the clock itself counts.
(
    ACCEPTED,
    UNSET,
    NON_FINITE,
    DUPLICATE,
    LATE,
    STRAY,
    FILLED,
    FLAT,
    CLIPPED,
    IN_RUN,
    TRACKED,
    REPEATED,
    UNUSABLE,
    LATE_IN_A_ROW,
    SET_BACK,
    COUNT_SIZE,
) = range(16)

DONE, NEW_RUN, UNDECIDED, ACCEPT, REJECTED = range(5)
"""Verdicts on a sample, and why a call returned: all read, the next one begins a run, or depends on those to come."""

IMPLAUSIBLE: Final = 10.0
"""So many times the saturation limit is no reading of such a sensor: rejected like a sample that is not finite."""

JITTER_MARGIN: Final = 6.0
"""So many times its mean jitter a stamp may be off before it means a lost or a late sample: 4.8 sigma if Gaussian."""

HOLDS, STRAYED, STALLED = range(REJECTED + 1, REJECTED + 4)
"""What those to come say of a stamp that leaps: so it is, it is astray, or samples were sent late and none is lost."""

SLIP_PERIODS: Final = 0.65
"""The clock has slipped by a sample where recent stamps lie off it by more than so many periods on average."""

SLIP_JITTERS, SLIP_SHORTEST, SLIP_LONGEST = 6.0, 9.0, 2000.0
"""Recent are the cube of so many times the mean jitter in periods, within bounds: late stamps come in a row."""

LEAP_S: Final = 1.0
"""A stamp further off than this, ahead or back, must be joined by many before time itself is taken to have leapt."""

LEAP_CONFIRMED_BY: Final = 20

LOOKED_AT: Final = 400
"""So many samples are waited for at most before a leaping stamp is judged; only unset or repeated ones take so long."""


@inlined
def _usable(samples: Floats, at: int, saturation: float) -> bool:
    """Whether every axis is a finite, plausible reading."""
    limit = IMPLAUSIBLE * saturation
    return abs(samples[at, 0]) < limit and abs(samples[at, 1]) < limit and abs(samples[at, 2]) < limit


@inlined
def _same(samples: Floats, at: int, state: Floats) -> bool:
    return samples[at, 0] == state[LAST] and samples[at, 1] == state[LAST + 1] and samples[at, 2] == state[LAST + 2]


@compiled
def _holds(stamps_ns: Integers, at: int, needed: int, epoch_ns: int, final: bool, state: Floats) -> int:
    """Whether a leaping stamp is joined by the `needed` next: HOLDS, or STRAYED, STALLED; UNDECIDED if too few came.

    A stamp joins that lies nearer to where it belongs after the leap than to where it does without one; stamps that
    stand still join nothing. Where those after a leap ahead fall behind in their order, they were sent late, and none
    is lost.
    """
    period = int(state[PERIOD] * 1e9)
    expected = epoch_ns + int(state[TIME] * 1e9) + period
    leap = before = newest = stamps_ns[at]
    seen, standing, ordered = 0, 0, True
    for j in range(at + 1, stamps_ns.shape[0]):
        if j - at > LOOKED_AT:
            return STRAYED
        stamp = stamps_ns[j]
        if stamp == 0:
            continue
        standing = standing + 1 if stamp == before else 0
        if standing == LEAP_CONFIRMED_BY:
            return STRAYED
        ordered &= stamp >= before
        before = stamp
        if standing > 0 and state[COARSE] == 0.0:
            continue  # the same message again
        seen += 1
        passed = seen * period
        if abs(stamp - passed - leap) >= abs(stamp - passed - expected):
            return STALLED if ordered and expected < leap else STRAYED
        newest = max(newest, stamp)
        if seen >= needed and newest > leap:
            return HOLDS
        if seen == LEAP_CONFIRMED_BY:
            return STRAYED
    if not final:
        return UNDECIDED
    return HOLDS if needed < LEAP_CONFIRMED_BY and newest > leap else STRAYED


@inlined
def _periods_missing(stamp: float, state: Floats, counts: Integers) -> int:
    """How many samples are lost before this one: those that were unusable, or what clock and stamps tell."""
    period = state[PERIOD]
    early = stamp - state[TIME] - period
    tolerance = max(0.5 * period, JITTER_MARGIN * state[JITTER])
    if abs(early - counts[UNUSABLE] * period) <= tolerance:
        return counts[UNUSABLE]
    if early <= tolerance:
        return 0
    if stamp - state[LAST_STAMP] < 1.5 * period:
        return 0  # where no sample fits in between, the clock is off, not the stream
    return int(np.floor(early / period + 0.5))


@inlined
def _slipped(stamp: float, missing: int, state: Floats) -> int:
    """How many samples the clock has come to lag or lead by, as the mean of recent stamps tells; mostly none.

    Single losses hide in jitter, and a stamp sent late may pass for one; what they leave behind does not average out.
    """
    period = state[PERIOD]
    error = stamp - state[TIME] - (missing + 1) * period
    limit = max(1.5 * period, JITTER_MARGIN * state[JITTER])
    recent = min(max((SLIP_JITTERS * state[JITTER] / period) ** 3, SLIP_SHORTEST), SLIP_LONGEST)
    state[SLIP] += (min(max(error, -limit), limit) - state[SLIP]) / recent
    if abs(state[SLIP]) < SLIP_PERIODS * period:
        return 0
    slips = 1 if state[SLIP] > 0.0 else -1
    state[SLIP] -= slips * period
    return slips


@inlined
def _tracked_time(stamp: float, missing: int, state: Floats, counts: Integers) -> float:
    """Where the sample lies on the tracked clock: a line through all stamps at first, a slow loop from then on.

    The gains are those of a least-squares line over all that has come (in a later run of its height alone), down to
    those of the loop. The period stays within 2 % of nominal, and time never steps by less than half a period.
    """
    period, nominal, jitter = state[PERIOD], state[NOMINAL], state[JITTER]
    now = state[TIME] + (missing + 1) * period
    limit = max(0.5 * period, 3.0 * jitter)
    error = min(max(stamp - now, -limit), limit)
    seen = counts[TRACKED] + 1.0
    gain_time = max(state[GAIN_TIME], 4.0 / (seen + 3.0), 1.0 / (counts[IN_RUN] + 1.0))
    gain_period = max(state[GAIN_PERIOD], 6.0 / (seen * (seen + 1.0)))
    state[JITTER] += state[GAIN_TIME] * (min(abs(error - state[SLIP]), 4.0 * jitter + 0.02 * period) - jitter)
    state[PERIOD] = min(max(period + gain_period * error, 0.98 * nominal), 1.02 * nominal)
    return now + min(max(gain_time * error, -0.5 * period), 0.5 * period)


@inlined
def _is_late(stamp: float, state: Floats) -> bool:
    """Whether a stamp lies further behind the tracked clock than jitter explains."""
    period, tolerance = state[PERIOD], JITTER_MARGIN * state[JITTER]
    if stamp <= state[LAST_STAMP] and tolerance < 0.5 * period:
        return True
    return state[TIME] + period - stamp > max(tolerance, period)


@compiled
def _judge_behind(stamps_ns: Integers, at: int, epoch_ns: int, final: bool, state: Floats, counts: Integers) -> int:
    """Judge a stamp that is not later than the last one: whether it is one, or time itself leapt back."""
    if state[LAST_STAMP] - (stamps_ns[at] - epoch_ns) * 1e-9 <= LEAP_S:
        return ACCEPT
    holds = _holds(stamps_ns, at, LEAP_CONFIRMED_BY, epoch_ns, final, state)
    if holds == STRAYED:
        counts[UNUSABLE] += 1
        return ACCEPT
    return NEW_RUN if holds == HOLDS else UNDECIDED


@compiled
def _judge_ahead(
    stamps_ns: Integers, at: int, missing: int, epoch_ns: int, final: bool, state: Floats, counts: Integers
) -> int:
    """Judge a stamp that leaves samples out, by as many that follow: lost ones, one sent late, or a stray stamp."""
    if missing == counts[UNUSABLE]:
        return ACCEPT
    far = missing > LEAP_CONFIRMED_BY and missing * state[PERIOD] > LEAP_S
    needed = LEAP_CONFIRMED_BY if far else min(missing + 1, LEAP_CONFIRMED_BY - 1)
    holds = _holds(stamps_ns, at, needed, epoch_ns, final, state)
    if holds == STRAYED:
        counts[STRAY] += 1
        counts[UNUSABLE] += 1
        return REJECTED
    return ACCEPT if holds == HOLDS else holds


@inlined
def _count_reading(stamp: float, samples: Floats, at: int, state: Floats, counts: Integers) -> None:
    """Count what an accepted reading looks like: clipped, or one of a flat line, which counts from its beginning."""
    largest = max(abs(samples[at, 0]), abs(samples[at, 1]), abs(samples[at, 2]))
    state[LARGEST] = max(state[LARGEST], largest)
    counts[CLIPPED] += largest >= state[SATURATION]
    if not _same(samples, at, state):
        state[FLAT_SINCE] = stamp
        counts[REPEATED] = 0
        return
    counts[REPEATED] += 1
    if stamp - state[FLAT_SINCE] >= state[FLAT_AFTER]:
        counts[FLAT] += counts[REPEATED]
        counts[REPEATED] = 0


@inlined
def _treads_again(stamp: float, state: Floats) -> bool:
    """Whether a late stamp lies where samples were accepted.

    It is neither astray, nor one that stands still, nor of a sample that was held up, whose place was left.
    """
    return 0.0 < state[LAST_STAMP] - stamp <= LEAP_S and not state[HOLE_FROM] < stamp < state[HOLE_TO]


@inlined
def _set_back(counts: Integers) -> int:
    """How many samples were late behind each other until now, where that means a clock set back; they are counted.

    Where stamps tread a stretch once more, what the sensor measured meanwhile is missing, though no stamp is. Late ones
    of a second sender come between others.
    """
    row = counts[LATE_IN_A_ROW]
    counts[LATE_IN_A_ROW] = 0
    if row < LEAP_CONFIRMED_BY:
        return 0
    counts[SET_BACK] += row
    return row


@inlined
def _judge(
    stamps_ns: Integers, samples: Floats, at: int, epoch_ns: int, final: bool, state: Floats, counts: Integers
) -> tuple[int, int]:
    """Judge one sample: (ACCEPT, REJECTED, NEW_RUN or UNDECIDED; how many are missing before it)."""
    if stamps_ns[at] == 0:
        counts[UNSET] += 1
        counts[UNUSABLE] += 1
        return REJECTED, 0
    if not _usable(samples, at, state[SATURATION]):
        counts[NON_FINITE] += 1
        counts[UNUSABLE] += 1
        return REJECTED, 0
    stamp = (stamps_ns[at] - epoch_ns) * 1e-9
    verdict, missing = ACCEPT, 0
    if state[LAST_STAMP] == stamp and state[COARSE] == 0.0 and _same(samples, at, state):
        counts[DUPLICATE] += 1
        return REJECTED, 0
    if state[LAST_STAMP] > -np.inf:
        missing = _periods_missing(stamp, state, counts)
        if state[LAST_STAMP] >= stamp:
            verdict = _judge_behind(stamps_ns, at, epoch_ns, final, state, counts)
        elif missing > 0:
            verdict = _judge_ahead(stamps_ns, at, missing, epoch_ns, final, state, counts)
        if verdict == STALLED:
            verdict, missing = ACCEPT, 0
        if verdict == ACCEPT and _is_late(stamp, state):
            counts[LATE] += 1
            counts[LATE_IN_A_ROW] += _treads_again(stamp, state)
            return REJECTED, 0
        set_back = _set_back(counts) if verdict != UNDECIDED else 0
        if verdict == ACCEPT and (max(missing, set_back) + 1) * state[PERIOD] > state[MAX_GAP]:
            verdict = NEW_RUN
    if verdict == NEW_RUN:
        # Nothing is known of the next run: whatever comes first is accepted. Its seconds count from there, and what
        # passed in between is no part of a flat line.
        state[HOLE_FROM], state[HOLE_TO] = state[LAST_STAMP] - stamp, 0.0
        state[FLAT_SINCE] -= state[LAST_STAMP]
        state[TIME] = np.nan
        state[LAST_STAMP] = -np.inf
        counts[UNUSABLE] = 0
    return verdict, missing


@compiled
def regularise(
    stamps_ns: Integers,
    samples: Floats,
    epoch_ns: int,
    final: bool,
    state: Floats,
    counts: Integers,
    times: Floats,
    out: Floats,
    source: Integers,
) -> tuple[int, int, int]:
    """Turn stamped raw samples into evenly spaced ones: a tracked clock, lost samples interpolated, bad ones rejected.

    stamps_ns (n,), samples (n, 3) m/s^2; state and counts as laid out above, carried on; times (m,) smoothed s since
    epoch_ns, out (m, 3), source (m,) raw index or -1 where interpolated. Returns (samples consumed, samples written,
    DONE, NEW_RUN or UNDECIDED); the next stamp is the epoch of a new run, `final` leaves nothing undecided. Stops early
    where `out` may not hold the next one's interpolated predecessors. It and those it calls index and slice arrays, no
    more, for uncompiled they are called with `views` of them.
    """
    state[JOINED], state[LARGEST] = state[TIME] == state[TIME], 0.0  # NaN where a run begins
    for c in range(3):
        state[BEFORE + c] = state[LAST + c]
    written = 0
    room = times.shape[0] - int(state[MAX_GAP] / (0.98 * state[NOMINAL])) - 2
    for i in range(stamps_ns.shape[0]):
        if written > room:
            return i, written, DONE
        verdict, missing = _judge(stamps_ns, samples, i, epoch_ns, final, state, counts)
        if verdict == REJECTED:
            continue
        if verdict != ACCEPT:
            return i, written, verdict
        stamp = (stamps_ns[i] - epoch_ns) * 1e-9
        now = stamp
        if math.isnan(state[TIME]):
            counts[IN_RUN] = 0
        else:
            slipped = _slipped(stamp, missing, state)
            if slipped < 0:
                counts[LATE] += 1
                continue
            missing += slipped
            now = _tracked_time(stamp, missing, state, counts)
            for m in range(1, missing + 1):
                share = m / (missing + 1)
                times[written] = state[TIME] + share * (now - state[TIME])
                for c in range(3):
                    out[written, c] = state[LAST + c] + share * (samples[i, c] - state[LAST + c])
                source[written] = -1
                written += 1
            if missing > 0:
                state[HOLE_FROM], state[HOLE_TO] = state[LAST_STAMP], stamp
            counts[FILLED] += missing
        times[written], source[written] = now, i
        _count_reading(stamp, samples, i, state, counts)
        for c in range(3):
            out[written, c] = state[LAST + c] = samples[i, c]
        written += 1
        state[TIME], state[LAST_STAMP] = now, stamp
        counts[UNUSABLE] = 0
        counts[ACCEPTED] += 1
        counts[TRACKED] += 1
        counts[IN_RUN] += 1
    return stamps_ns.shape[0], written, DONE


@compiled
def level(samples: Floats, rotation: Floats, at_rest: Floats, out: Floats) -> None:
    """Turn specific force (n, 3), less that at rest (3,), so that the third axis is up: acceleration (n, 3) m/s^2."""
    for n in range(samples.shape[0]):
        for r in range(3):
            total = 0.0
            for c in range(3):
                total += rotation[r, c] * (samples[n, c] - at_rest[c])
            out[n, r] = total


@compiled
def filter_sections(sos: Floats, state: Floats, x: Floats, y: Floats) -> None:
    """Filter x (n, c) into y by second-order sections (s, 6), transposed direct form; state (s, 2, c) is carried."""
    for n in range(x.shape[0]):
        for c in range(x.shape[1]):
            value = x[n, c]
            for s in range(sos.shape[0]):
                fed = value
                value = sos[s, 0] * fed + state[s, 0, c]
                state[s, 0, c] = sos[s, 1] * fed - sos[s, 4] * value + state[s, 1, c]
                state[s, 1, c] = sos[s, 2] * fed - sos[s, 5] * value
            y[n, c] = value


@compiled
def condition(
    stamps_ns: Integers,
    samples: Floats,
    epoch_ns: int,
    delay_ns: int,
    final: bool,
    state: Floats,
    counts: Integers,
    out_stamps_ns: Integers,
    times: Floats,
    levelled: Floats,
    low_passed: Floats,
    raw: Floats,
    source: Integers,
) -> tuple[int, int, int]:
    """One sensor's whole path in one call: `regularise`, `level`, `filter_sections` on the vertical, stamps less delay.

    Arrays and answer as in `regularise`, raw being its `out`; out_stamps_ns, times (m,), levelled (m, 3), low_passed
    (m, 1).
    """
    done, written, why = regularise(stamps_ns, samples, epoch_ns, final, state, counts, times, raw, source)
    level(raw[:written], state[ROTATION:LOW_PASS].reshape(3, 3), state[AT_REST:BEFORE], levelled)
    sos = state[LOW_PASS:LOW_PASS_STATE].reshape(SECTIONS, 6)
    filter_state = state[LOW_PASS_STATE:MAX_GAP].reshape(SECTIONS, 2, 1)
    filter_sections(sos, filter_state, levelled[:written, 2:], low_passed)
    for n in range(written):
        state[TRACKED_LEVEL] += state[TRACKER_GAIN] * (low_passed[n, 0] - state[TRACKED_LEVEL])
        low_passed[n, 0] -= state[TRACKED_LEVEL]
        own = epoch_ns + np.int64(np.rint(times[n] * 1e9))
        out_stamps_ns[n] = (stamps_ns[source[n]] if source[n] >= 0 else own) - delay_ns
    return done, written, why
