"""The compiled loops: small plain functions over arrays and floats, sequential so that block cuts never change a bit.

The only module that imports numba. Without it every kernel runs as ordinary Python, correct and slow (`COMPILED`).
No kernel checks its input; the classes that own the arrays do.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

try:
    import numba
except ImportError:  # apt-only installs: there is no numba package on Ubuntu noble
    numba = None

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
F = TypeVar("F", bound=Callable[..., Any])

COMPILED: Final = numba is not None


def _cache_folder() -> str | None:
    """A folder of the user's own for compiled code, or None where nothing is writable (read-only installs, no HOME)."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    user = os.getuid() if hasattr(os, "getuid") else "user"
    candidates = [Path(base) / "biodyn"] if base else []
    if os.environ.get("HOME"):
        candidates.append(Path(os.environ["HOME"]) / ".cache" / "biodyn")
    candidates.append(Path(tempfile.gettempdir()) / f"biodyn-cache-{user}")
    for folder in candidates:
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            # A folder somebody else owns could feed us their machine code.
            if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except OSError:
            continue
    return None


_CACHE = _cache_folder() if COMPILED else None


def compiled(function: F) -> F:
    """Compile with numba where it is present, cached where a cache can be kept; otherwise return the function."""
    if numba is None:
        return function
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _CACHE or before
    try:
        # numpy's error model: a division by zero gives inf, as it does in the uncompiled twin.
        wrapped: F = numba.njit(cache=_CACHE is not None, error_model="numpy")(function)
        return wrapped
    finally:
        numba.config.CACHE_DIR = before


# --- the chain -------------------------------------------------------------------------------------------------------


@compiled
def _accelerations(
    x: Floats,
    v: Floats,
    seat: float,
    k: Floats,
    b: Floats,
    k_alpha: Floats,
    inverse_mass: Floats,
    alpha_r: float,
    out: Floats,
) -> None:
    """Relative accelerations x'' of Eq. 4, joint by joint from the head down (Eq. 17, 18)."""
    above = 0.0
    for j in range(5, -1, -1):
        delta = x[j] - x[j - 1] if j > 0 else x[0]
        rate = v[j] - v[j - 1] if j > 0 else v[0]
        force = delta * (k[j] + k_alpha[j] * abs(delta)) + b[j] * rate
        out[j] = (above - force) * inverse_mass[j] - alpha_r * v[j] - seat
        above = force


@compiled
def integrate_chain(
    seat: Floats,
    state: Floats,
    k: Floats,
    b: Floats,
    k_alpha: Floats,
    inverse_mass: Floats,
    alpha_r: float,
    step_s: float,
    substeps: int,
    accel: Floats,
    motion: Floats,
) -> None:
    """Carry the chain over `seat` samples by classical Runge-Kutta, seat acceleration linear between samples.

    seat (n,) m/s^2; state (13,) = x (6), v (6), last seat sample, updated in place; accel (n, 6) absolute m/s^2;
    motion (n, 12) = x, v or (0, 12) where they are not wanted. Zaman et al., Eq. 2-4, 17, 18.
    """
    x, v, x_try = np.empty(6), np.empty(6), np.empty(6)
    v2, v3, v4 = np.empty(6), np.empty(6), np.empty(6)
    a1, a2, a3, a4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    for j in range(6):
        x[j] = state[j]
        v[j] = state[6 + j]
    last = state[12]
    half, sixth = 0.5 * step_s, step_s / 6.0
    keep_motion = motion.shape[0] > 0
    _accelerations(x, v, last, k, b, k_alpha, inverse_mass, alpha_r, a1)
    for n in range(seat.shape[0]):
        slope = (seat[n] - last) / substeps
        for q in range(substeps):
            middle = last + slope * (q + 0.5)
            # Exactly the sample at the last substep, so that a block may be cut here without changing a bit.
            end = seat[n] if q == substeps - 1 else last + slope * (q + 1)
            for j in range(6):
                v2[j] = v[j] + half * a1[j]
                x_try[j] = x[j] + half * v[j]
            _accelerations(x_try, v2, middle, k, b, k_alpha, inverse_mass, alpha_r, a2)
            for j in range(6):
                v3[j] = v[j] + half * a2[j]
                x_try[j] = x[j] + half * v2[j]
            _accelerations(x_try, v3, middle, k, b, k_alpha, inverse_mass, alpha_r, a3)
            for j in range(6):
                v4[j] = v[j] + step_s * a3[j]
                x_try[j] = x[j] + step_s * v3[j]
            _accelerations(x_try, v4, end, k, b, k_alpha, inverse_mass, alpha_r, a4)
            for j in range(6):
                x[j] += sixth * (v[j] + 2.0 * v2[j] + 2.0 * v3[j] + v4[j])
                v[j] += sixth * (a1[j] + 2.0 * a2[j] + 2.0 * a3[j] + a4[j])
            # The input is continuous, so the last slope of this step is the first of the next, and the output.
            _accelerations(x, v, end, k, b, k_alpha, inverse_mass, alpha_r, a1)
        last = seat[n]
        for j in range(6):
            accel[n, j] = a1[j] + last
        if keep_motion:
            for j in range(6):
                motion[n, j] = x[j]
                motion[n, 6 + j] = v[j]
    for j in range(6):
        state[j] = x[j]
        state[6 + j] = v[j]
    state[12] = last


# --- one sensor: clock, gaps, level, low-pass ------------------------------------------------------------------------

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


@compiled
def interpolate(
    times: Floats, runs: Integers, values: Floats, grid: Floats, weights: Floats, out: Floats
) -> int:  # fmt: skip
    """Read evenly sampled values at the grid's instants by Lagrange polynomials through 2h neighbours.

    times, runs, values (m,); grid (n,) ascending; weights (2h,) barycentric; out (n,) is left as it is where a run's
    edge or a gap leaves no neighbours. Returns how many instants are answered: it stops at the first whose neighbours
    may still come.
    """
    half = weights.shape[0] // 2
    newest = times.shape[0] - 1
    m = 0
    for n in range(grid.shape[0]):
        t = grid[n]
        while m < newest and times[m + 1] <= t:
            m += 1
        if newest < 0 or (m + half > newest and t >= times[m]):
            return n
        first, last = m - half + 1, m + half
        if t < times[m] or first < 0 or runs[first] != runs[last]:
            continue
        u = (t - times[m]) / (times[m + 1] - times[m]) + half - 1.0
        above, below, exact = 0.0, 0.0, -1
        for j in range(2 * half):
            distance = u - j
            if distance == 0.0:
                exact = j
                break
            w = weights[j] / distance
            above += w * values[first + j]
            below += w
        out[n] = values[first + exact] if exact >= 0 else above / below
    return grid.shape[0]


# --- exposure --------------------------------------------------------------------------------------------------------
# Every meter adds into `bin_` and, each `length` samples, closes it into the ring (rolling window) and the total.
# Columns before `sums` add up, the others keep their largest value. A NaN sample is a break: filters start anew there.


@compiled
def _close_bin(bin_: Floats, total: Floats, ring: Floats, position: Integers, sums: int) -> None:
    slot = position[1] % ring.shape[0]
    for c in range(bin_.shape[0]):
        for q in range(bin_.shape[1]):
            ring[slot, c, q] = bin_[c, q]
            if q < sums:
                total[c, q] += bin_[c, q]
            else:
                total[c, q] = max(total[c, q], bin_[c, q])
            bin_[c, q] = 0.0
    position[0] = 0
    position[1] += 1


@compiled
def dose(
    x: Floats, sos: Floats, state: Floats, decay: float, running: Floats, bin_: Floats, total: Floats, ring: Floats,
    position: Integers, length: int,
) -> None:  # fmt: skip
    """Weight x (n, c) and gather per channel: sum a^2, sum a^4, samples, peak |a|, peak running mean square.

    running (c,) is the exponentially averaged mean square (1 s, ISO 2631-1:1997, 6.3.1, Eq. 3 in recursive form).
    """
    for n in range(x.shape[0]):
        for c in range(x.shape[1]):
            value = x[n, c]
            if np.isnan(value):
                running[c] = 0.0
                for s in range(sos.shape[0]):
                    state[s, 0, c] = 0.0
                    state[s, 1, c] = 0.0
                continue
            for s in range(sos.shape[0]):
                fed = value
                value = sos[s, 0] * fed + state[s, 0, c]
                state[s, 0, c] = sos[s, 1] * fed - sos[s, 4] * value + state[s, 1, c]
                state[s, 1, c] = sos[s, 2] * fed - sos[s, 5] * value
            square = value * value
            running[c] += decay * (square - running[c])
            bin_[c, 0] += square
            bin_[c, 1] += square * square
            bin_[c, 2] += 1.0
            bin_[c, 3] = max(bin_[c, 3], abs(value))
            bin_[c, 4] = max(bin_[c, 4], running[c])
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 3)


@compiled
def planar_dose(
    x: Floats, sos: Floats, state: Floats, bin_: Floats, total: Floats, ring: Floats, position: Integers, length: int
) -> None:
    """Weight x (n, 2) and gather the moments a_x^p a_y^q that give aw and VDV in every horizontal direction.

    Columns: p + q = 2 (3 of them), p + q = 4 (5 of them), samples; bin_ (1, 9).
    """
    weighted = np.empty(2)
    for n in range(x.shape[0]):
        missing = np.isnan(x[n, 0]) or np.isnan(x[n, 1])
        for c in range(2):
            value = x[n, c]
            for s in range(sos.shape[0]):
                fed = value
                value = sos[s, 0] * fed + state[s, 0, c]
                state[s, 0, c] = 0.0 if missing else sos[s, 1] * fed - sos[s, 4] * value + state[s, 1, c]
                state[s, 1, c] = 0.0 if missing else sos[s, 2] * fed - sos[s, 5] * value
            weighted[c] = value
        if not missing:
            a, b = weighted[0], weighted[1]
            bin_[0, 0] += a * a
            bin_[0, 1] += a * b
            bin_[0, 2] += b * b
            bin_[0, 3] += a * a * a * a
            bin_[0, 4] += a * a * a * b
            bin_[0, 5] += a * a * b * b
            bin_[0, 6] += a * b * b * b
            bin_[0, 7] += b * b * b * b
            bin_[0, 8] += 1.0
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 9)


@compiled
def dynamic_response(
    x: Floats, transition: Floats, state: Floats, bin_: Floats, total: Floats, ring: Floats, position: Integers,
    length: int, seen: Integers,
) -> None:  # fmt: skip
    """Drive the DRI oscillator with x (n, 1), linear between samples, and keep the largest compression and |z|, metres.

    transition (2, 4): [z, z'] after = transition @ [z, z', x before, x now]; state (3,) = z, z', x before;
    seen (2,): samples so far, and the sample of the largest compression.
    """
    for n in range(x.shape[0]):
        value = x[n, 0]
        if np.isnan(value):
            state[0] = 0.0
            state[1] = 0.0
            state[2] = 0.0
            continue
        z = (
            transition[0, 0] * state[0]
            + transition[0, 1] * state[1]
            + transition[0, 2] * state[2]
            + transition[0, 3] * value
        )
        rate = (
            transition[1, 0] * state[0]
            + transition[1, 1] * state[1]
            + transition[1, 2] * state[2]
            + transition[1, 3] * value
        )
        state[0] = z
        state[1] = rate
        state[2] = value
        if -z > bin_[0, 0] and -z > total[0, 0]:
            seen[1] = seen[0]
        seen[0] += 1
        bin_[0, 0] = max(bin_[0, 0], -z)
        bin_[0, 1] = max(bin_[0, 1], abs(z))
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 0)


@compiled
def _hic_value(impulse: float, duration: float) -> float:
    mean = impulse / duration
    return duration * mean * mean * np.sqrt(mean) if mean > 0.0 else 0.0


@compiled
def head_injury(
    x: Floats, period_s: float, window_s: float, history: Floats, filled: Integers, bin_: Floats, total: Floats,
    ring: Floats, position: Integers, length: int,
) -> None:  # fmt: skip
    """Keep the largest HIC of x (n, c), in g, over all windows up to `window_s`, ends interpolated (Eq. 23).

    history (w + 2, 2, c): the last samples and their running integrals, newest first; filled (1,): how many are valid.
    x is taken as linear between samples, so its integral at a window's interpolated end is exact.
    """
    whole = int(np.floor(window_s / period_s + 1e-9))
    part = window_s - whole * period_s
    for n in range(x.shape[0]):
        if np.isnan(x[n, 0]):
            filled[0] = 0
            continue
        depth = filled[0]
        for c in range(x.shape[1]):
            for h in range(min(depth, history.shape[0] - 1), 0, -1):
                history[h, 0, c] = history[h - 1, 0, c]
                history[h, 1, c] = history[h - 1, 1, c]
            history[0, 0, c] = x[n, c]
            history[0, 1, c] = 0.0
            if depth > 0:
                history[0, 1, c] = history[1, 1, c] + 0.5 * period_s * (history[1, 0, c] + x[n, c])
            best = 0.0
            for h in range(1, min(depth, whole) + 1):
                best = max(best, _hic_value(history[0, 1, c] - history[h, 1, c], h * period_s))
            if depth > whole and part > 0.0 and whole > 0:
                share = part / period_s
                old, older = history[whole, 0, c], history[whole + 1, 0, c]
                begin = history[whole, 1, c] - part * (old + 0.5 * share * (older - old))
                best = max(best, _hic_value(history[0, 1, c] - begin, window_s))
                now, before = history[0, 0, c], history[1, 0, c]
                end = history[1, 1, c] + part * (before + 0.5 * share * (now - before))
                best = max(best, _hic_value(end - history[whole + 1, 1, c], window_s))
            bin_[c, 0] = max(bin_[c, 0], best)
        filled[0] = min(depth + 1, history.shape[0])
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 0)


@compiled
def residual(
    predicted: Floats, measured: Floats, bin_: Floats, total: Floats, ring: Floats, position: Integers, length: int
) -> None:
    """Gather per segment the sums of (predicted - measured)^2, measured^2 and samples; rows with NaN are left out."""
    for n in range(predicted.shape[0]):
        for c in range(predicted.shape[1]):
            difference = predicted[n, c] - measured[n, c]
            if not np.isnan(difference):
                bin_[c, 0] += difference * difference
                bin_[c, 1] += measured[n, c] * measured[n, c]
                bin_[c, 2] += 1.0
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 3)
