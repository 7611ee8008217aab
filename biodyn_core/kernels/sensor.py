"""One sensor's path: clock, gaps, level, low-pass."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.kernels.compiling import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


CLOCK_TIME, CLOCK_PERIOD, CLOCK_NOMINAL, CLOCK_LAST_STAMP, CLOCK_JITTER, CLOCK_SIZE = range(6)
(
    COUNT_ACCEPTED,
    COUNT_LATE,
    COUNT_NONFINITE,
    COUNT_FILLED,
    COUNT_RUNS,
    COUNT_CLIPPED,
    COUNT_BACK_IN_A_ROW,
    COUNT_AHEAD_IN_A_ROW,
    COUNT_SIZE,
) = range(9)
IMPLAUSIBLE: Final = 10.0
"""So many times the saturation limit is no reading of such a sensor: rejected like a sample that is not finite."""

JITTER_MARGIN: Final = 6.0
"""So many times its mean jitter a stamp may be off before it means a lost or a late sample: 4.8 sigma if Gaussian."""

JUMP_BACK_S: Final = 1.0
"""Stamps behind the last by less than this are late, or will catch up; further behind, time may have jumped."""

RESTART_AFTER: Final = 20
"""So many stamps in a row that far behind mean that time itself jumped back (a looping bag)."""

SUSPICIOUS_PERIODS: Final = 3
"""A stamp further ahead than this must be confirmed by the next one before it is believed."""


@compiled
def _usable(sample: Floats, saturation: float) -> bool:
    """Whether every axis is a finite, plausible reading."""
    limit = IMPLAUSIBLE * saturation
    return abs(sample[0]) < limit and abs(sample[1]) < limit and abs(sample[2]) < limit


@compiled
def _is_late(stamp: float, sample: Floats, clock: Floats, last: Floats) -> bool:
    """Whether a sample comes twice, or lies further behind the last than jitter explains."""
    behind = clock[CLOCK_LAST_STAMP] - stamp
    if behind == 0.0 and sample[0] == last[0] and sample[1] == last[1] and sample[2] == last[2]:
        return True
    tolerance = JITTER_MARGIN * clock[CLOCK_JITTER]
    return behind > tolerance or (behind >= 0.0 and tolerance < 0.5 * clock[CLOCK_PERIOD])


@compiled
def _periods_missing(stamp: float, clock: Floats) -> int:
    """How many samples are lost before this one, by the tracked clock and by the stamps themselves."""
    period = clock[CLOCK_PERIOD]
    early = stamp - clock[CLOCK_TIME] - period
    if early <= max(0.5 * period, JITTER_MARGIN * clock[CLOCK_JITTER]):
        return 0
    if stamp - clock[CLOCK_LAST_STAMP] < 1.5 * period:
        return 0  # where no sample fits in between, the clock is off, not the stream
    return int(np.floor(early / period + 0.5))


@compiled
def _tracked_time(stamp: float, missing: int, clock: Floats, gain_time: float, gain_period: float) -> float:
    """Where the sample lies on the tracked clock, whose period follows the stamps slowly, within 2 % of nominal."""
    period, nominal, jitter = clock[CLOCK_PERIOD], clock[CLOCK_NOMINAL], clock[CLOCK_JITTER]
    now = clock[CLOCK_TIME] + (missing + 1) * period
    limit = max(0.5 * period, 3.0 * jitter)
    error = min(max(stamp - now, -limit), limit)
    clock[CLOCK_JITTER] += 0.5 * gain_time * (min(abs(error), 4.0 * jitter + 0.02 * period) - jitter)
    clock[CLOCK_PERIOD] = min(max(period + gain_period * error, 0.98 * nominal), 1.02 * nominal)
    return now + gain_time * error


@compiled
def regularise(
    stamps_s: Floats,
    samples: Floats,
    start: int,
    clock: Floats,
    last: Floats,
    counts: Integers,
    max_gap_s: float,
    gain_time: float,
    gain_period: float,
    saturation: float,
    times: Floats,
    out: Floats,
    source: Integers,
) -> tuple[int, int, bool]:
    """Turn stamped raw samples into evenly spaced ones: a tracked clock, lost samples interpolated, bad ones rejected.

    stamps_s (n,) s and samples (n, 3) m/s^2 are read from `start`; clock, last (3,) and counts are carried along;
    times (m,) smoothed s, out (m, 3), source (m,) raw index or -1 where interpolated. Returns (samples consumed,
    samples written, whether a new run begins with the next sample). Stops where `out` may not hold the next sample's
    interpolated predecessors, and before a sample that begins a new run.
    """
    written = 0
    room = times.shape[0] - int(max_gap_s / (0.98 * clock[CLOCK_NOMINAL])) - 2
    for i in range(start, stamps_s.shape[0]):
        stamp = stamps_s[i]
        if not _usable(samples[i], saturation):
            counts[COUNT_NONFINITE] += 1
            counts[COUNT_AHEAD_IN_A_ROW] = 1  # it carries no reading, but it confirms that the stamps move on
            continue
        if _is_late(stamp, samples[i], clock, last):
            counts[COUNT_LATE] += 1
            counts[COUNT_BACK_IN_A_ROW] += stamp < clock[CLOCK_LAST_STAMP] - JUMP_BACK_S
            if counts[COUNT_BACK_IN_A_ROW] < RESTART_AFTER:
                continue
            counts[COUNT_BACK_IN_A_ROW] = 0
            clock[CLOCK_LAST_STAMP] = -np.inf
            clock[CLOCK_TIME] = np.nan
            return i, written, True
        if written > room:
            return i, written, False
        now = stamp
        if not np.isnan(clock[CLOCK_TIME]):
            missing = _periods_missing(stamp, clock)
            if missing >= SUSPICIOUS_PERIODS and counts[COUNT_AHEAD_IN_A_ROW] == 0:
                counts[COUNT_AHEAD_IN_A_ROW] = 1
                counts[COUNT_LATE] += 1
                continue
            if (missing + 1) * clock[CLOCK_PERIOD] > max_gap_s:
                clock[CLOCK_TIME] = np.nan
                return i, written, True
            now = _tracked_time(stamp, missing, clock, gain_time, gain_period)
            for m in range(1, missing + 1):
                share = m / (missing + 1)
                times[written] = clock[CLOCK_TIME] + share * (now - clock[CLOCK_TIME])
                out[written] = last + share * (samples[i] - last)
                source[written] = -1
                written += 1
            counts[COUNT_FILLED] += missing
        counts[COUNT_BACK_IN_A_ROW] = 0
        counts[COUNT_AHEAD_IN_A_ROW] = 0
        times[written], source[written], out[written], last[:] = now, i, samples[i], samples[i]
        written += 1
        clock[CLOCK_TIME], clock[CLOCK_LAST_STAMP] = now, stamp
        counts[COUNT_ACCEPTED] += 1
        counts[COUNT_CLIPPED] += np.abs(samples[i]).max() >= saturation
    return stamps_s.shape[0], written, False


@compiled
def level(samples: Floats, rotation: Floats, gravity: float, out: Floats) -> None:
    """Turn specific force (n, 3) into gravity-free acceleration with the third axis up, (n, 3) m/s^2."""
    for n in range(samples.shape[0]):
        for r in range(3):
            total = 0.0
            for c in range(3):
                total += rotation[r, c] * samples[n, c]
            out[n, r] = total
        out[n, 2] -= gravity


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
    stamps_s: Floats,
    samples: Floats,
    clock: Floats,
    last: Floats,
    counts: Integers,
    rotation: Floats,
    sos: Floats,
    state: Floats,
    constants: tuple[float, float, float, float, float],
    epoch_ns: int,
    delay_ns: int,
    out_stamps_ns: Integers,
    times: Floats,
    levelled: Floats,
    low_passed: Floats,
) -> tuple[int, int, bool]:
    """One sensor's whole path in one call: `regularise`, `level`, `filter_sections` on the vertical, stamps less delay.

    constants = (max_gap_s, gain_time, gain_period, saturation, gravity). Arrays and answer as in `regularise`, from the
    first sample; out_stamps_ns, times (m,), levelled (m, 3), low_passed (m, 1).
    """
    max_gap_s, gain_time, gain_period, saturation, gravity = constants
    raw = np.empty(levelled.shape)
    source = np.empty(times.shape, dtype=np.int64)
    done, written, breaks = regularise(
        stamps_s, samples, 0, clock, last, counts, max_gap_s, gain_time, gain_period, saturation, times, raw, source
    )
    level(raw[:written], rotation, gravity, levelled)
    filter_sections(sos, state, levelled[:written, 2:], low_passed)
    for n in range(written):
        own = epoch_ns + np.int64(np.rint(times[n] * 1e9))
        out_stamps_ns[n] = (stamps_ns[source[n]] if source[n] >= 0 else own) - delay_ns
    return done, written, breaks
