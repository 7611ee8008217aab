"""Conditioning of one sensor: clock, gaps, flat lines, levelling, low-pass.

The state of a sensor lies in one array of floats and one of counts, with the layout below: the time of a call grows
with the number of its arguments, and the live path calls once per sample.
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
# ... the last accepted reading (3), the levelling rotation (3 x 3), the low-pass (sections x 6) and its state ...
LAST: Final = 7
ROTATION: Final = LAST + 3
LOW_PASS: Final = ROTATION + 9
LOW_PASS_STATE: Final = LOW_PASS + 6 * SECTIONS
# ... and constants: limits, gains, whether samples share a stamp, the mean reading at rest (3), which is gravity and
# bias. Also state: the slow level of the gravity tracker and the two stamps around the last gap. For the detection of
# rails each call stores the reading before its first (3), whether the two belong to one run, and the largest reading.
# For dead axes: the part of each axis in the figures (3), and the reading at the last change of each axis (3 x 3).
# For readings that are sent several times: the least change of a reading so far, on the axis that changes most.
(
    MAX_GAP,
    FLAT_AFTER,
    SATURATION,
    GAIN_TIME,
    GAIN_PERIOD,
    COARSE,
    TRACKER_GAIN,
    TRACKED_LEVEL,
    GAP_FROM,
    GAP_TO,
    AT_REST,
) = range(LOW_PASS_STATE + 2 * SECTIONS, LOW_PASS_STATE + 2 * SECTIONS + 11)
BEFORE: Final = AT_REST + 3
JOINED, LARGEST, AXIS_PART = range(BEFORE + 3, BEFORE + 6)
AT_CHANGE: Final = AXIS_PART + 3
LEAST_CHANGE: Final = AT_CHANGE + 9
STATE_SIZE: Final = LEAST_CHANGE + 1

NO_PART, IN_HORIZONTAL, IN_VERTICAL = 0.0, 1.0, 2.0
"""The part of an axis in the figures of its sensor."""

# The array of counts: accepted and rejected samples, then counters of the clock.
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
    DEAD,
    FLAT_UP_TO,
    DEAD_UP_TO,
    MOVING,
) = range(19)
# Of each axis since its last change: samples at which another axis was away from its reading then, and the first one.
MOVING_FROM: Final = MOVING + 3
# Of readings before a clear change: how many, how often the last one was sent, how many were sent as often as the one
# before (one more or less is as often), and how often these in all.
READINGS, SENT, REGULAR, REGULAR_SENT = range(MOVING_FROM + 3, MOVING_FROM + 7)
COUNT_SIZE: Final = MOVING_FROM + 7

AWAY_MPS2: Final = 0.5
"""An axis so far from its reading at the last change of another one has moved: six steps of 12 bits and 16 g."""

CLEAR_CHANGES: Final = 3.0
"""A change of a reading by more than so many least ones is motion, and not one step of a coarse sensor."""

DONE, NEW_RUN, UNDECIDED, ACCEPT, REJECTED = range(5)
"""Decisions on a sample, and reasons to return: all read; the next begins a run; the next depends on later samples."""

IMPLAUSIBLE: Final = 10.0
"""Readings above this multiple of the saturation limit are rejected like non-finite ones."""

JITTER_MARGIN: Final = 6.0
"""A stamp error above this multiple of the mean jitter means a lost or late sample: 4.8 sigma if Gaussian."""

CONFIRMED, OUTLIER, SENT_LATE = range(REJECTED + 1, REJECTED + 4)
"""Result of later stamps on a leap: confirmed, an outlier, or samples sent late with none lost."""

SLIP_PERIODS: Final = 0.65
"""The clock has slipped by a sample if the mean error of recent stamps exceeds this number of periods."""

SLIP_JITTERS, SLIP_SHORTEST, SLIP_LONGEST = 6.0, 9.0, 2000.0
"""The recent stamps are the cube of this multiple of the mean jitter in periods, within bounds: late stamps cluster."""

LEAP_S: Final = 1.0
"""A larger step of a stamp, ahead or back, is a leap in time only if many later stamps confirm it."""

LEAP_CONFIRMED_BY: Final = 20

MAX_LOOKAHEAD: Final = 400
"""The most later samples that a decision on a leap waits for; only unset or repeated stamps need so many."""


@inlined
def _usable(samples: Floats, at: int, saturation: float) -> bool:
    """Whether every axis is a finite, plausible reading."""
    limit = IMPLAUSIBLE * saturation
    return abs(samples[at, 0]) < limit and abs(samples[at, 1]) < limit and abs(samples[at, 2]) < limit


@inlined
def _same(samples: Floats, at: int, state: Floats) -> bool:
    return samples[at, 0] == state[LAST] and samples[at, 1] == state[LAST + 1] and samples[at, 2] == state[LAST + 2]


@compiled
def _confirm_leap(stamps_ns: Integers, at: int, needed: int, epoch_ns: int, final: bool, state: Floats) -> int:
    """Whether the `needed` next stamps confirm a leap: CONFIRMED, OUTLIER, SENT_LATE; UNDECIDED with too few of them.

    A stamp confirms the leap if it is nearer to its expected value with the leap than without; constant stamps confirm
    nothing. If the stamps after a leap ahead return to the old line in order, samples were sent late and none is lost.
    """
    period = int(state[PERIOD] * 1e9)
    expected = epoch_ns + int(state[TIME] * 1e9) + period
    leap = before = newest = stamps_ns[at]
    seen, constant, ordered = 0, 0, True
    for j in range(at + 1, stamps_ns.shape[0]):
        if j - at > MAX_LOOKAHEAD:
            return OUTLIER
        stamp = stamps_ns[j]
        if stamp == 0:
            continue
        constant = constant + 1 if stamp == before else 0
        if constant == LEAP_CONFIRMED_BY:
            return OUTLIER
        ordered &= stamp >= before
        before = stamp
        if constant > 0 and state[COARSE] == 0.0:
            continue  # a repeated message
        seen += 1
        passed = seen * period
        if abs(stamp - passed - leap) >= abs(stamp - passed - expected):
            return SENT_LATE if ordered and expected < leap else OUTLIER
        newest = max(newest, stamp)
        if seen >= needed and newest > leap:
            return CONFIRMED
        if seen == LEAP_CONFIRMED_BY:
            return OUTLIER
    if not final:
        return UNDECIDED
    return CONFIRMED if needed < LEAP_CONFIRMED_BY and newest > leap else OUTLIER


@inlined
def _count_missing(stamp: float, state: Floats, counts: Integers) -> int:
    """The number of samples lost before this one: the unusable ones, or the number from clock and stamps."""
    period = state[PERIOD]
    early = stamp - state[TIME] - period
    tolerance = max(0.5 * period, JITTER_MARGIN * state[JITTER])
    if abs(early - counts[UNUSABLE] * period) <= tolerance:
        return counts[UNUSABLE]
    if early <= tolerance:
        return 0
    if stamp - state[LAST_STAMP] < 1.5 * period:
        return 0  # no sample fits in between, so the clock has the error, not the stream
    return int(np.floor(early / period + 0.5))


@inlined
def _count_slip(stamp: float, missing: int, state: Floats) -> int:
    """The number of samples by which the clock lags or leads, from the mean of recent stamps; usually none.

    Jitter hides single losses, and a stamp sent late can look like one; the remaining error does not average out.
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
    """The time of the sample on the tracked clock: at first a line through all stamps, later a slow loop.

    The gains are those of a least-squares line over all stamps so far (in a later run, of its offset alone), limited
    below by those of the loop. The period stays within 2 % of nominal; a time step is at least half a period.
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
    """Whether a stamp is behind the tracked clock by more than jitter explains."""
    period, tolerance = state[PERIOD], JITTER_MARGIN * state[JITTER]
    if stamp <= state[LAST_STAMP] and tolerance < 0.5 * period:
        return True
    return state[TIME] + period - stamp > max(tolerance, period)


@compiled
def _decide_earlier(stamps_ns: Integers, at: int, epoch_ns: int, final: bool, state: Floats, counts: Integers) -> int:
    """Decide on a stamp not later than the last one: a late sample, or a leap of the clock backwards."""
    if state[LAST_STAMP] - (stamps_ns[at] - epoch_ns) * 1e-9 <= LEAP_S:
        return ACCEPT
    later = _confirm_leap(stamps_ns, at, LEAP_CONFIRMED_BY, epoch_ns, final, state)
    if later == OUTLIER:
        counts[UNUSABLE] += 1
        return ACCEPT
    return NEW_RUN if later == CONFIRMED else UNDECIDED


@compiled
def _decide_later(
    stamps_ns: Integers, at: int, missing: int, epoch_ns: int, final: bool, state: Floats, counts: Integers
) -> int:
    """Decide on a stamp after a gap, by the later stamps: samples were lost, one was sent late, or it is an outlier."""
    if missing == counts[UNUSABLE]:
        return ACCEPT
    far = missing > LEAP_CONFIRMED_BY and missing * state[PERIOD] > LEAP_S
    needed = LEAP_CONFIRMED_BY if far else min(missing + 1, LEAP_CONFIRMED_BY - 1)
    later = _confirm_leap(stamps_ns, at, needed, epoch_ns, final, state)
    if later == OUTLIER:
        counts[STRAY] += 1
        counts[UNUSABLE] += 1
        return REJECTED
    return ACCEPT if later == CONFIRMED else later


@inlined
def _count_reading(stamp: float, samples: Floats, at: int, state: Floats, counts: Integers) -> None:
    """Count an accepted reading that is clipped, or part of a flat line; the whole line counts."""
    largest = max(abs(samples[at, 0]), abs(samples[at, 1]), abs(samples[at, 2]))
    state[LARGEST] = max(state[LARGEST], largest)
    counts[CLIPPED] += largest >= state[SATURATION]
    _count_dead_axes(samples, at, state, counts)
    if not _same(samples, at, state):
        _count_sent(samples, at, state, counts)
        state[FLAT_SINCE] = stamp
        counts[REPEATED] = 0
        return
    counts[REPEATED] += 1
    if stamp - state[FLAT_SINCE] >= state[FLAT_AFTER]:
        _count_up_to(FLAT, FLAT_UP_TO, counts[ACCEPTED] + 1 - counts[REPEATED], counts)
        counts[REPEATED] = 0


@inlined
def _count_sent(samples: Floats, at: int, state: Floats, counts: Integers) -> None:
    """Count how often the reading before a clear change was sent: a driver may send each one several times.

    A coarse sensor repeats readings too, but in slow motion, where it changes by single steps.
    """
    change = 0.0
    for c in range(3):
        change = max(change, abs(samples[at, c] - state[LAST + c]))
    state[LEAST_CHANGE] = min(state[LEAST_CHANGE], change)
    if change <= CLEAR_CHANGES * state[LEAST_CHANGE]:
        return
    sent = counts[REPEATED] + 1
    counts[READINGS] += 1
    if abs(sent - counts[SENT]) <= 1:
        counts[REGULAR] += 1
        counts[REGULAR_SENT] += sent
    counts[SENT] = sent


@inlined
def _count_up_to(count: int, up_to: int, begin: int, counts: Integers) -> None:
    """Count the accepted samples from `begin` to the present one, each once."""
    end = counts[ACCEPTED] + 1
    counts[count] += end - max(begin, counts[up_to])
    counts[up_to] = end


@inlined
def _count_dead_axes(samples: Floats, at: int, state: Floats, counts: Integers) -> None:
    """Count a reading with an axis that never changes while another one moves, for as long as a flat line.

    At rest an axis of a coarse sensor may stay on one step for long, so only the time in motion decides. A dead axis
    with a part in the vertical is a flat line too.
    """
    for c in range(3):
        if samples[at, c] != state[LAST + c]:
            counts[MOVING + c] = 0
            for other in range(3):
                state[AT_CHANGE + 3 * c + other] = samples[at, other]
            continue
        away = 0.0
        for other in range(3):
            away = max(away, abs(samples[at, other] - state[AT_CHANGE + 3 * c + other]))
        if away > AWAY_MPS2:
            if counts[MOVING + c] == 0:
                counts[MOVING_FROM + c] = counts[ACCEPTED]
            counts[MOVING + c] += 1
        if state[AXIS_PART + c] == NO_PART or counts[MOVING + c] * state[NOMINAL] < state[FLAT_AFTER]:
            continue
        _count_up_to(DEAD, DEAD_UP_TO, counts[MOVING_FROM + c], counts)
        if state[AXIS_PART + c] == IN_VERTICAL:
            _count_up_to(FLAT, FLAT_UP_TO, counts[MOVING_FROM + c], counts)


@inlined
def _repeats_interval(stamp: float, state: Floats) -> bool:
    """Whether a late stamp lies in an interval from which samples were already accepted.

    That excludes outliers, constant stamps and delayed samples, which fall into the last gap.
    """
    return 0.0 < state[LAST_STAMP] - stamp <= LEAP_S and not state[GAP_FROM] < stamp < state[GAP_TO]


@inlined
def _count_set_back(counts: Integers) -> int:
    """The number of consecutive late samples, if it shows a clock set back, else 0; it is counted.

    If stamps repeat an interval, the samples of that time are missing although no stamp is. Late samples of a second
    sender are interleaved with others.
    """
    row = counts[LATE_IN_A_ROW]
    counts[LATE_IN_A_ROW] = 0
    if row < LEAP_CONFIRMED_BY:
        return 0
    counts[SET_BACK] += row
    return row


@inlined
def _decide(
    stamps_ns: Integers, samples: Floats, at: int, epoch_ns: int, final: bool, state: Floats, counts: Integers
) -> tuple[int, int]:
    """Decide on one sample: (ACCEPT, REJECTED, NEW_RUN or UNDECIDED; the number missing before it)."""
    if stamps_ns[at] == 0:
        counts[UNSET] += 1
        counts[UNUSABLE] += 1
        return REJECTED, 0
    if not _usable(samples, at, state[SATURATION]):
        counts[NON_FINITE] += 1
        counts[UNUSABLE] += 1
        return REJECTED, 0
    stamp = (stamps_ns[at] - epoch_ns) * 1e-9
    decision, missing = ACCEPT, 0
    if state[LAST_STAMP] == stamp and state[COARSE] == 0.0 and _same(samples, at, state):
        counts[DUPLICATE] += 1
        return REJECTED, 0
    if state[LAST_STAMP] > -np.inf:
        missing = _count_missing(stamp, state, counts)
        if state[LAST_STAMP] >= stamp:
            decision = _decide_earlier(stamps_ns, at, epoch_ns, final, state, counts)
        elif missing > 0:
            decision = _decide_later(stamps_ns, at, missing, epoch_ns, final, state, counts)
        if decision == SENT_LATE:
            decision, missing = ACCEPT, 0
        if decision == ACCEPT and _is_late(stamp, state):
            counts[LATE] += 1
            counts[LATE_IN_A_ROW] += _repeats_interval(stamp, state)
            return REJECTED, 0
        set_back = _count_set_back(counts) if decision != UNDECIDED else 0
        if decision == ACCEPT and (max(missing, set_back) + 1) * state[PERIOD] > state[MAX_GAP]:
            decision = NEW_RUN
    if decision == NEW_RUN:
        # The first sample of the next run is accepted without test. Its seconds count from there, and the time in
        # between is not part of a flat line.
        state[GAP_FROM], state[GAP_TO] = state[LAST_STAMP] - stamp, 0.0
        state[FLAT_SINCE] -= state[LAST_STAMP]
        state[TIME] = np.nan
        state[LAST_STAMP] = -np.inf
        counts[UNUSABLE] = 0
    return decision, missing


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
    """Convert stamped raw samples to evenly spaced ones: a tracked clock, lost samples interpolated, bad ones rejected.

    stamps_ns (n,), samples (n, 3) m/s^2; state and counts have the layout above and are updated; times (m,) smoothed s
    since epoch_ns, out (m, 3), source (m,) raw index or -1 where interpolated. Returns (samples consumed, samples
    written, DONE, NEW_RUN or UNDECIDED); the next stamp is the epoch of a new run; with `final` nothing is UNDECIDED.
    Stops early where `out` may not hold the interpolated samples before the next one. Uncompiled it gets `views` of
    arrays, so it may only index and slice them.
    """
    state[JOINED], state[LARGEST] = state[TIME] == state[TIME], 0.0  # NaN where a run begins
    for c in range(3):
        state[BEFORE + c] = state[LAST + c]
    written = 0
    room = times.shape[0] - int(state[MAX_GAP] / (0.98 * state[NOMINAL])) - 2
    for i in range(stamps_ns.shape[0]):
        if written > room:
            return i, written, DONE
        decision, missing = _decide(stamps_ns, samples, i, epoch_ns, final, state, counts)
        if decision == REJECTED:
            continue
        if decision != ACCEPT:
            return i, written, decision
        stamp = (stamps_ns[i] - epoch_ns) * 1e-9
        now = stamp
        if math.isnan(state[TIME]):
            counts[IN_RUN] = 0
        else:
            slipped = _count_slip(stamp, missing, state)
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
                state[GAP_FROM], state[GAP_TO] = state[LAST_STAMP], stamp
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
    """Rotate specific force (n, 3), less that at rest (3,), to a third axis that is up: acceleration (n, 3) m/s^2."""
    for n in range(samples.shape[0]):
        for r in range(3):
            total = 0.0
            for c in range(3):
                total += rotation[r, c] * (samples[n, c] - at_rest[c])
            out[n, r] = total


@compiled
def filter_sections(sos: Floats, state: Floats, x: Floats, y: Floats) -> None:
    """Filter x (n, c) into y by second-order sections (s, 6), transposed direct form; state (s, 2, c) is updated."""
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
    """Condition one sensor in one call: `regularise`, `level`, `filter_sections` on the vertical, stamps less delay.

    Arrays and result as in `regularise`, with raw as its `out`; out_stamps_ns, times (m,), levelled (m, 3), low_passed
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
