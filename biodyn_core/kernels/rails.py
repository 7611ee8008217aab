"""Rails: the limits of a sensor's range, detected by readings that return to the extreme of an axis or stay there.

Each axis has two sides, and each side has one row of floats, with the layout below. The extreme is compared with the
`NEXT` distinct levels next to it, so neither the resolution nor the noise of the sensor must be known. A stay is one or
more consecutive readings at the extreme. It counts if

- the motion reached the extreme in one step from below all of these levels; a slow motion passes through them.
- no counted stay has the same previous level; looped records and periodic motions repeat.

Either of two criteria makes the extreme a rail, each with a probability of at most `CHANCE` for motion within range:

- Readings that follow another one in a stay. A motion that moves by more than 8 levels per sample stays in one of 9
  levels with a probability of at most 1/9: 9 such readings. Another axis must have changed, since a held sample is no
  evidence.
- Stays. The crest of a smooth motion is a parabola, whose time in the upper n of N levels grows with the root of n: of
  all readings in 9 levels at most 1/3 lie in the top one. With k stays and s readings in the next levels the binomial
  probability of so many is below exp(-(k + s) D), D the divergence of k / (k + s) from 1/3 (Chernoff): 34 stays if each
  of the next levels was read once.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.compiling import compiled, inlined

LEAST_MPS2: Final = 12.0
"""Lower limit of a rail: every sensor reads gravity, with its bias and gain, in any mounting."""

SAME: Final = 2.0**-17
"""Readings that differ by less than this share are the same level: a quarter of a 16-bit step, above rounding."""

NEXT: Final = 8
"""Number of distinct levels next to the extreme that are needed for a decision."""

CHANCE: Final = 9.0**-9
"""The largest probability that a motion within the range is taken for one at a rail: 3e-9."""

STAYED_NEEDED: Final = 9.0
SHARE: Final = 1.0 / math.sqrt(NEXT + 1.0)
MAX_STAYS: Final = 64
"""Number of stays that are stored: nearly twice as many as a rail needs."""

ALIKE: Final = 1.0 / 32.0
"""Stays whose steps differ by less than this share came from one level. A sine whose period is nearly a whole number of
samples has similar steps for long, so from fewer levels than the criteria need, unless its crest is read as well."""

# One side's row: its extreme and the next levels, descending; how often each was read; whether it is a rail ...
EXTREME, LOWEST = 0, NEXT
READ: Final = NEXT + 1
FOUND: Final = READ + NEXT + 1
# ... how many readings stayed, whether this stay counts, the number of counted stays, and the level before each.
STAYED, COUNTS, STAYS = range(FOUND + 1, FOUND + 4)
ENTRIES: Final = STAYS + 1
ROW_SIZE: Final = ENTRIES + MAX_STAYS

AXES, SIDES = 3, 2
ROWS: Final = AXES * SIDES
STATE_SIZE: Final = ROWS * ROW_SIZE
"""Six rows of floats: for each axis the row of its largest readings, then of its smallest ones, mirrored."""

COUNT_SIZE: Final = (1 + SIDES) ** AXES
"""Samples by where each axis lies: 0 elsewhere, 1 at its largest, 2 at its smallest; the first axis runs fastest."""

_BELOW, _AT_EXTREME, _EXCEEDED = range(3)


@inlined
def _is_at(value: float, level: float) -> bool:
    return abs(value - level) <= SAME * level


@inlined
def _test_rail(row: Floats) -> None:
    """Test whether the extreme is a rail; it remains one until a reading exceeds it."""
    if row[STAYED] >= STAYED_NEEDED:
        row[FOUND] = 1.0
    seen = row[STAYS]
    for k in range(1, NEXT + 1):
        seen += row[READ + k]
    share = row[STAYS] / seen
    if SHARE < share < 1.0:
        divergence = share * np.log(share / SHARE) + (1.0 - share) * np.log((1.0 - share) / (1.0 - SHARE))
        if seen * divergence >= -np.log(CHANCE):
            row[FOUND] = 1.0


@inlined
def _begin_stay(entry: float, row: Floats) -> None:
    """Begin a stay at the extreme, and count it if it meets the conditions."""
    stays = int(row[STAYS])
    row[COUNTS] = 0.0
    if row[LOWEST] == 0.0 or entry >= row[LOWEST] or stays == MAX_STAYS:
        return
    alike = max(0.5 * (row[EXTREME] - row[LOWEST]), ALIKE * (row[EXTREME] - entry))
    for k in range(stays):
        if abs(entry - row[ENTRIES + k]) < alike:
            return
    row[ENTRIES + stays] = entry
    row[STAYS] += 1.0
    row[COUNTS] = 1.0
    _test_rail(row)


@inlined
def _set_extreme(value: float, row: Floats) -> None:
    """Set a new extreme and discard the findings on the previous one."""
    for k in range(NEXT, 0, -1):
        row[k], row[READ + k] = row[k - 1], row[READ + k - 1]
    row[EXTREME], row[READ] = value, 1.0
    row[FOUND] = row[STAYED] = row[STAYS] = 0.0


@inlined
def _insert_level(value: float, row: Floats) -> None:
    """Insert a level among those next to the extreme, unless it is below all."""
    place = NEXT
    while value > row[place - 1]:
        place -= 1
    if _is_at(value, row[place - 1]):
        row[READ + place - 1] += 1.0
    elif _is_at(value, row[place]):
        row[READ + place] += 1.0
    else:
        for k in range(NEXT, place, -1):
            row[k], row[READ + k] = row[k - 1], row[READ + k - 1]
        row[place], row[READ + place] = value, 1.0


@compiled
def _process_reading(value: float, before: float, joined: bool, changed: bool, row: Floats) -> int:
    """Process one reading of a side, mirrored to be positive, with the previous one."""
    extreme = row[EXTREME]
    is_at = _is_at(value, extreme)
    if value < extreme and not is_at:
        _insert_level(value, row)
        return _BELOW
    if not is_at:
        _set_extreme(value, row)
    if not joined:
        row[COUNTS] = 0.0
    elif not _is_at(before, row[EXTREME]):
        _begin_stay(before, row)
    elif changed and row[COUNTS] > 0.0:
        row[STAYED] += 1.0
        _test_rail(row)
    return _AT_EXTREME if is_at else _EXCEEDED


@compiled
def _discard_counts(side: int, weight: int, counts: Integers) -> None:
    """Move the samples counted at an exceeded extreme to elsewhere."""
    for k in range(COUNT_SIZE):
        if k // weight % (1 + SIDES) == side + 1:
            counts[k - (side + 1) * weight] += counts[k]
            counts[k] = 0


@inlined
def _index_of(
    samples: Floats, n: int, before: tuple[float, float, float], joined: bool, rows: Floats, counts: Integers
) -> int:
    """Process the readings of one sample; returns its index in `counts`, 0 where no axis lies at an extreme."""
    place, weight = 0, 1
    for c in range(AXES):
        value = samples[n, c]
        side = 0 if value > 0.0 else 1
        row = (SIDES * c + side) * ROW_SIZE
        if abs(value) >= max(LEAST_MPS2, rows[row + LOWEST] * (1.0 - SAME)):
            sign = 1.0 - 2.0 * side
            changed = before[0] != samples[n, 0] or before[1] != samples[n, 1] or before[2] != samples[n, 2]
            side_state = _process_reading(sign * value, sign * before[c], joined, changed, rows[row : row + ROW_SIZE])
            if side_state == _EXCEEDED:
                _discard_counts(side, weight, counts)
            if side_state != _BELOW:
                place += (side + 1) * weight
        weight *= 1 + SIDES
    return place


@compiled
def find_rails(
    samples: Floats,
    source: Integers,
    before: Floats,
    joined: bool,
    saturation: float,
    rows: Floats,
    counts: Integers,
) -> None:
    """Detect rails in a sensor's samples (n, 3) m/s^2; source (m,) is negative where a sample was interpolated.

    before (3,): the reading before the first sample; joined: it belongs to the same run. Samples at or above
    `saturation` are not counted. rows (STATE_SIZE,) and counts (COUNT_SIZE,) are updated in place.
    """
    earlier = before[0], before[1], before[2]
    for n in range(samples.shape[0]):
        largest = max(abs(samples[n, 0]), abs(samples[n, 1]), abs(samples[n, 2]))
        if largest < LEAST_MPS2 or source[n] < 0:
            continue
        if n > 0:
            earlier = samples[n - 1, 0], samples[n - 1, 1], samples[n - 1, 2]
            joined = source[n - 1] >= 0
        place = _index_of(samples, n, earlier, joined, rows, counts)
        if place > 0 and largest < saturation:
            counts[place] += 1
