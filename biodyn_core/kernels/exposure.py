"""Loops of the exposure meters: doses, injury criteria, residual.

Every meter accumulates in `bin_` and, after each `length` samples, adds it to the ring (rolling window) and the total.
Columns before `sums` are sums, the others maxima. A NaN sample is missing: time advances by one sample, nothing is
counted, and the state of its channel (filter, oscillator, window) is initialized again after it.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.kernels.compiling import compiled

NEVER: Final = 2**62
"""A number of rows since something that has not happened."""


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
def _clipped_to_gravity(value: float) -> float:
    """A sample clipped to 1 g, the most that tilt can cause, so that shocks and divergence do not move the level."""
    return min(max(value, -STANDARD_GRAVITY_MPS2), STANDARD_GRAVITY_MPS2)


@compiled
def set_steady_state(sos: Floats, state: Floats, channel: int, level: float) -> None:
    """Set one channel of the sections' state (s, 2, c) to its steady state for a constant input `level`.

    The high-pass comes first and has both zeros at 0 Hz, so the sections after it are at zero.
    """
    for s in range(sos.shape[0]):
        state[s, 0, channel] = 0.0
        state[s, 1, channel] = 0.0
    state[0, 0, channel] = -sos[0, 0] * level
    state[0, 1, channel] = sos[0, 2] * level


@compiled
def _sum_backwards(rows: Floats, row: int) -> None:
    """Replace every element of a row by the sum from it to the end of the row."""
    for i in range(rows.shape[1] - 2, -1, -1):
        rows[row, i] += rows[row, i + 1]


@compiled
def _clear_averages(running: Floats, squares: Floats, partial: Floats, channel: int) -> None:
    """Begin the running mean squares of a channel again."""
    if running[channel] != 0.0:  # otherwise the block is already empty
        squares[channel] = 0.0
        partial[channel] = 0.0
        running[channel] = 0.0


@compiled
def dose(
    x: Floats, sos: Floats, state: Floats, follow: float, level: Floats, decay: float, running: Floats, squares: Floats,
    partial: Floats, filled: Integers, window: float, lost: Integers, strong: float, rule: Integers,
    suspects: Integers, bin_: Floats, total: Floats, ring: Floats, position: Integers, length: int,
) -> None:  # fmt: skip
    """Weight x (n, c), accumulate per channel; bin_ has 7 columns.

    They are the sums of a^2 and a^4, samples, those of them that are left out as suspect, peak |a|, and the peaks of
    two running mean squares.

    The linear one is over the last `window` samples (ISO 2631-1:1997, 6.3.1, Eq. 2); with a fractional window the
    oldest sample counts in part. running (c,) is the exponential one (Eq. 3 in recursive form). level (c,) is the
    exponential mean of x clipped to 1 g, from which the sections start after a missing sample.

    squares (c, l + 1) is a block of l = floor(window) + 1 samples and a zero: the filled[0] newest squares, whose sum
    is partial (c,), then for each sample of the previous block the sum from it to the end of that block. Nothing is
    subtracted, so a shock that has left the window leaves no rounding error.

    Where a channel is suspect by the rule of `flag_suspect`, with near, settling and longest in rule (3,), the samples
    of its group only count; longest is 0 for no such rule. After a missing sample the sections restart, as after a loss
    of `longest` samples. lost (n, c): of each sample of a line across a loss, the number of samples that were lost.
    suspects (c, 6): that rule's state of each channel (4), whether a group is suspect, and the group of each channel.
    """
    block = squares.shape[1] - 1
    share = window - math.floor(window)
    for n in range(x.shape[0]):
        at = filled[0]
        after = (at + 1) % block
        if rule[2] > 0:
            _find_suspects(x[n], lost[n], level, strong, rule, suspects)
        for c in range(x.shape[1]):
            value = x[n, c]
            if np.isnan(value):
                set_steady_state(sos, state, c, level[c])
                _clear_averages(running, squares, partial, c)
                continue
            level[c] += follow * (_clipped_to_gravity(value) - level[c])
            for s in range(sos.shape[0]):
                fed = value
                value = sos[s, 0] * fed + state[s, 0, c]
                state[s, 0, c] = sos[s, 1] * fed - sos[s, 4] * value + state[s, 1, c]
                state[s, 1, c] = sos[s, 2] * fed - sos[s, 5] * value
            if suspects[suspects[c, 5], 4] > 0:
                _clear_averages(running, squares, partial, c)
                bin_[c, 2] += 1.0
                bin_[c, 3] += 1.0
                continue
            square = value * value
            running[c] += decay * (square - running[c])
            squares[c, at] = square
            partial[c] += square
            if after == 0:
                _sum_backwards(squares, c)
                partial[c] = 0.0
            longer, shorter = squares[c, after] + partial[c], squares[c, after + 1] + partial[c]
            bin_[c, 0] += square
            bin_[c, 1] += square * square
            bin_[c, 2] += 1.0
            bin_[c, 4] = max(bin_[c, 4], abs(value))
            bin_[c, 5] = max(bin_[c, 5], (share * longer + (1.0 - share) * shorter) / window)
            bin_[c, 6] = max(bin_[c, 6], running[c])
        filled[0] = after
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 4)


@compiled
def _find_suspects(
    row: Floats, lost: Integers, level: Floats, strong: float, rule: Integers, suspects: Integers
) -> None:
    """Update suspects (c, 6) by a row (c,), see `dose`."""
    near, settling, longest = rule
    suspects[:, 4] = 0
    for c in range(row.shape[0]):
        state = suspects[c]
        if np.isnan(row[c]):
            state[0], state[1], state[2] = -1, longest, NEVER
            state[3] = max(state[3] - 1, 0)
        elif _is_suspect(lost[c], abs(row[c] - level[c]) > strong, near, settling, longest, state):
            suspects[state[5], 4] = 1


@compiled
def _is_suspect(lost: int, is_strong: bool, near: int, settling: int, longest: int, state: Integers) -> bool:
    """Whether a row is suspect, from the rows lost with it, whether it is strong, and the state, see `flag_suspect`."""
    state[0] += 1
    state[2] += 1
    if lost > 0:
        state[1] = max(lost, state[1] if state[0] <= near else 0)  # the longest of losses close to each other
        state[0] = 0
    if is_strong:
        state[2] = 0
    if (state[0] == 0 and state[2] <= near) or (state[2] == 0 and state[0] <= near):
        state[3] = max(state[3], min(settling * state[1], longest))
    found = state[3] > 0
    state[3] = max(state[3] - 1, 0)
    return bool(found)


@compiled
def planar_dose(
    x: Floats, sos: Floats, state: Floats, follow: float, level: Floats, bin_: Floats, total: Floats, ring: Floats,
    position: Integers, length: int,
) -> None:  # fmt: skip
    """Weight x (n, 2) and sum the moments a_x^p a_y^q for aw and VDV in every horizontal direction.

    Columns: p + q = 2 (3 of them), p + q = 4 (5 of them), samples; bin_ (1, 9). A sample that lacks an axis is missing.
    """
    weighted = np.empty(2)
    for n in range(x.shape[0]):
        missing = np.isnan(x[n, 0]) or np.isnan(x[n, 1])
        for c in range(2):
            if missing:
                set_steady_state(sos, state, c, level[c])
                continue
            value = x[n, c]
            level[c] += follow * (_clipped_to_gravity(value) - level[c])
            for s in range(sos.shape[0]):
                fed = value
                value = sos[s, 0] * fed + state[s, 0, c]
                state[s, 0, c] = sos[s, 1] * fed - sos[s, 4] * value + state[s, 1, c]
                state[s, 1, c] = sos[s, 2] * fed - sos[s, 5] * value
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
    """Integrate the DRI oscillator over x (n, 1), linear between samples; record the largest compression and |z| in m.

    transition (2, 4): [z, z'] after = transition @ [z, z', x before, x now]; state (3,) = z, z', x before;
    seen (2,): samples so far including missing ones, and the sample of the largest compression.
    """
    for n in range(x.shape[0]):
        value = x[n, 0]
        if np.isnan(value):
            state[:] = 0.0
        else:
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
            bin_[0, 0] = max(bin_[0, 0], -z)
            bin_[0, 1] = max(bin_[0, 1], abs(z))
        seen[0] += 1
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 0)


@compiled
def head_injury(
    x: Floats, period_s: float, window_s: float, weights: Floats, history: Floats, filled: Integers, seen: Integers,
    windows: Floats, bin_: Floats, total: Floats, ring: Floats, position: Integers, length: int,
) -> None:  # fmt: skip
    """Record the largest impulse times (duration)^-0.6 of x (n, c), in g, over all windows up to `window_s`.

    To the power of 2.5 it is the HIC (Eq. 23). weights (w + 1,): (h periods)^-0.6 for windows of h samples, and that of
    `window_s`. history (c, 2, 2 l), l = w + 2: the last l samples and their running integrals, each stored twice so
    that any l consecutive ones are contiguous; filled (c, 2): number of valid samples, and index of the newest. x is
    linear between samples, so the integrals at interpolated ends are exact. seen (1,): samples so far including missing
    ones; windows (c, 2): begin and end of the largest window since reset, in samples.
    """
    whole = weights.shape[0] - 1
    size = history.shape[2] // 2
    part = window_s - whole * period_s
    share = part / period_s
    for n in range(x.shape[0]):
        for c in range(x.shape[1]):
            value = x[n, c]
            if np.isnan(value):
                filled[c, 0] = 0
                continue
            depth, last = filled[c, 0], filled[c, 1] + size
            integral = 0.0
            if depth > 0:
                integral = history[c, 1, last] + 0.5 * period_s * (history[c, 0, last] + value)
            at = (filled[c, 1] + 1) % size
            history[c, 0, at] = history[c, 0, at + size] = value
            history[c, 1, at] = history[c, 1, at + size] = integral
            filled[c, 0], filled[c, 1] = min(depth + 1, size), at
            now = at + size
            best, width, end = bin_[c, 0], 0.0, float(seen[0])
            for h in range(1, min(depth, whole) + 1):
                found = (integral - history[c, 1, now - h]) * weights[h - 1]
                if found > best:
                    best, width = found, float(h)
            if depth > whole and part > 0.0 and whole > 0:
                old, older = history[c, 0, now - whole], history[c, 0, now - whole - 1]
                begin = history[c, 1, now - whole] - part * (old + 0.5 * share * (older - old))
                found = (integral - begin) * weights[whole]
                if found > best:
                    best, width = found, whole + share
                before = history[c, 0, now - 1]
                until = history[c, 1, now - 1] + part * (before + 0.5 * share * (value - before))
                found = (until - history[c, 1, now - whole - 1]) * weights[whole]
                if found > best:
                    best, width, end = found, whole + share, seen[0] - 1.0 + share
            if best > bin_[c, 0] and best > total[c, 0]:
                windows[c, 0] = end - width
                windows[c, 1] = end
            bin_[c, 0] = best
        seen[0] += 1
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 0)


@compiled
def residual(
    predicted: Floats, measured: Floats, bin_: Floats, total: Floats, ring: Floats, position: Integers, length: int
) -> None:
    """Accumulate per segment the sums of (predicted - measured)^2, measured^2 and samples; NaN is skipped."""
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


@compiled
def flag_suspect(
    x: Floats, lost: Integers, strong: float, follow: float, shortest: int, near: int, settling: int, longest: int,
    level: Floats, state: Integers, suspect: Flags,
) -> None:  # fmt: skip
    """Flag the rows of x (n, c) that a loss within strong motion may have raised.

    lost (n,): of each interpolated row, the number of rows lost with it; fewer than `shortest` are no loss. Rows are
    flagged from a loss on that lies within `near` rows of a strong one, `settling` times its length, at most `longest`.
    A row is strong if a value differs by more than `strong` from its level (c,), which follows as in `dose`.

    state (4,): rows since a loss, its length, rows since a strong one, and rows that are still to be flagged.
    """
    for n in range(x.shape[0]):
        is_strong = False
        for c in range(x.shape[1]):
            is_strong = is_strong or abs(x[n, c] - level[c]) > strong
            level[c] += follow * (_clipped_to_gravity(x[n, c]) - level[c])
        of_loss = lost[n] if lost[n] >= shortest else 0
        suspect[n] = _is_suspect(of_loss, is_strong, near, settling, longest, state)


@compiled
def end_loss(at: Integers, largest: Floats, strong: float, sums: Floats) -> None:
    """Add an open loss to the sums (2,) of squares and fourth powers, if the largest reading near it is strong.

    at (3,): place in the ring of readings, samples lost in the open loss, 0 without one, and rows since it.
    """
    if at[1] > 0 and largest[0] > strong:
        square = largest[0] * largest[0]
        sums[0] += at[1] * square
        sums[1] += at[1] * square * square
    at[1] = 0


@compiled
def begin_loss(lost: int, recent: Floats, at: Integers, largest: Floats, strong: float, sums: Floats) -> None:
    """End the open loss, and begin one of so many samples after the readings of a ring, recent (near,)."""
    end_loss(at, largest, strong, sums)
    at[1] = lost
    at[2] = 0
    largest[0] = recent.max()


@compiled
def find_losses(
    up: Floats, lost: Integers, shortest: int, longest: int, recent: Floats, at: Integers, largest: Floats,
    strong: float, sums: Floats,
) -> None:  # fmt: skip
    """Add each loss of at least `shortest` samples in up (n,), as long as `longest` at most, to sums; see `end_loss`.

    lost (n,): of each interpolated row, the number of rows lost with it. The largest reading is that of as many rows
    before and after a loss as recent (near,) has.
    """
    for n in range(up.shape[0]):
        value = abs(up[n])
        is_lost = lost[n] >= shortest
        if is_lost and (at[1] == 0 or at[2] > 0):
            begin_loss(min(lost[n], longest), recent, at, largest, strong, sums)
        if at[1] > 0:
            largest[0] = max(largest[0], value)
            if not is_lost:
                at[2] += 1
                if at[2] == recent.shape[0]:
                    end_loss(at, largest, strong, sums)
        recent[at[0]] = value
        at[0] = (at[0] + 1) % recent.shape[0]


@compiled
def peak_forces(force: Floats, bin_: Floats, total: Floats, ring: Floats, position: Integers, length: int) -> None:
    """Accumulate per joint the sum of squares, samples, and largest values of force and of -force; NaN is skipped."""
    for n in range(force.shape[0]):
        for c in range(force.shape[1]):
            value = force[n, c]
            if not np.isnan(value):
                bin_[c, 0] += value * value
                bin_[c, 1] += 1.0
                bin_[c, 2] = max(bin_[c, 2], value)
                bin_[c, 3] = max(bin_[c, 3], -value)
        position[0] += 1
        if position[0] == length:
            _close_bin(bin_, total, ring, position, 2)
