"""Rails: where a sensor's own range ends, found by readings that come back to the extreme of an axis, or stay there.

Each axis has two sides, and each side carries one row of floats, laid out here. The extreme is compared with the `NEXT`
distinct levels next to it, so neither the step nor the noise of the sensor must be known. A stay at the extreme, of one
reading or more, counts if

- the motion came to the extreme in one step, from below all of these levels. A slow motion passes through them.
- no stay that counts came from the same place. A looped record and a periodic motion repeat themselves.

Either of two laws makes it a rail, each with a probability of at most `CHANCE` for a motion that turns round by itself:

- Readings that follow another one in a stay. A motion that moves by more than 8 levels a sample stays in one of 9
  levels with a chance of at most 1/9: 9 such readings. Another axis must have changed: a held sample tells nothing.
- Stays. The crest of a smooth motion is a parabola, whose time in the upper n of N levels is as the root of n: of all
  readings in 9 levels at most 1/3 lie in the uppermost one. With k stays and s readings in the next levels the binomial
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
"""No rail lies below: a sensor reads gravity, with its bias and gain, however it is mounted."""

SAME: Final = 2.0**-17
"""Readings that differ by less than this share are the same level: a quarter of a 16-bit step, above rounding."""

NEXT: Final = 8
"""So many distinct levels next to the extreme are known before it is judged."""

CHANCE: Final = 9.0**-9
"""The largest probability that a motion within the range passes for one at a rail: 3e-9."""

STAYED_NEEDED: Final = 9.0
SHARE: Final = 1.0 / math.sqrt(NEXT + 1.0)
MOST_STAYS: Final = 64
"""So many stays are told apart: nearly twice as many as a rail needs."""

ALIKE: Final = 1.0 / 32.0
"""Stays that came by steps this much alike came from one place. A sine whose period is nearly a whole number of samples
comes by steps that are alike for long: from fewer places than the laws ask for, unless its crest is read beside it."""

# One side's row: its extreme and the next levels, falling; how often these were read; whether it is a rail ...
EXTREME, LOWEST = 0, NEXT
READ: Final = NEXT + 1
FOUND: Final = READ + NEXT + 1
# ... how many readings stayed, whether this stay counts, how many stays did, and from where they came.
STAYED, COUNTS, STAYS = range(FOUND + 1, FOUND + 4)
ENTRIES: Final = STAYS + 1
ROW_SIZE: Final = ENTRIES + MOST_STAYS

AXES, SIDES = 3, 2
ROWS: Final = AXES * SIDES
STATE_SIZE: Final = ROWS * ROW_SIZE
"""Six rows of floats: of each axis that of its largest readings, then that of its smallest ones, mirrored."""

COUNT_SIZE: Final = (1 + SIDES) ** AXES
"""Samples by where each axis lies: 0 elsewhere, 1 at its largest, 2 at its smallest; the first axis runs fastest."""

_BELOW, _AT_EXTREME, _GREW = range(3)


@inlined
def _is_at(value: float, level: float) -> bool:
    return abs(value - level) <= SAME * level


@inlined
def _judge(row: Floats) -> None:
    """Tell whether the extreme is a rail; it remains one until a reading exceeds it."""
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
def _enter(entry: float, row: Floats) -> None:
    """Begin a stay at the extreme, and count it if it tells something."""
    stays = int(row[STAYS])
    row[COUNTS] = 0.0
    if row[LOWEST] == 0.0 or entry >= row[LOWEST] or stays == MOST_STAYS:
        return
    alike = max(0.5 * (row[EXTREME] - row[LOWEST]), ALIKE * (row[EXTREME] - entry))
    for k in range(stays):
        if abs(entry - row[ENTRIES + k]) < alike:
            return
    row[ENTRIES + stays] = entry
    row[STAYS] += 1.0
    row[COUNTS] = 1.0
    _judge(row)


@inlined
def _rise(value: float, row: Floats) -> None:
    """A new extreme: what was found of the one before is void."""
    for k in range(NEXT, 0, -1):
        row[k], row[READ + k] = row[k - 1], row[READ + k - 1]
    row[EXTREME], row[READ] = value, 1.0
    row[FOUND] = row[STAYED] = row[STAYS] = 0.0


@inlined
def _place(value: float, row: Floats) -> None:
    """Note a level among those next to the extreme, unless it is below all."""
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
def _look(value: float, before: float, joined: bool, changed: bool, row: Floats) -> int:
    """Look at one reading of a side, mirrored so that it is positive, and at the one before it."""
    extreme = row[EXTREME]
    is_at = _is_at(value, extreme)
    if value < extreme and not is_at:
        _place(value, row)
        return _BELOW
    if not is_at:
        _rise(value, row)
    if not joined:
        row[COUNTS] = 0.0
    elif not _is_at(before, row[EXTREME]):
        _enter(before, row)
    elif changed and row[COUNTS] > 0.0:
        row[STAYED] += 1.0
        _judge(row)
    return _AT_EXTREME if is_at else _GREW


@compiled
def _leave(side: int, weight: int, counts: Integers) -> None:
    """An extreme was exceeded: samples that lay there lie elsewhere."""
    for k in range(COUNT_SIZE):
        if k // weight % (1 + SIDES) == side + 1:
            counts[k - (side + 1) * weight] += counts[k]
            counts[k] = 0


@inlined
def _place_of(
    samples: Floats, n: int, before: tuple[float, float, float], joined: bool, rows: Floats, counts: Integers
) -> int:
    """Look at one sample's readings; returns its place in `counts`, 0 where no axis lies at an extreme."""
    place, weight = 0, 1
    for c in range(AXES):
        value = samples[n, c]
        side = 0 if value > 0.0 else 1
        row = (SIDES * c + side) * ROW_SIZE
        if abs(value) >= max(LEAST_MPS2, rows[row + LOWEST] * (1.0 - SAME)):
            sign = 1.0 - 2.0 * side
            changed = before[0] != samples[n, 0] or before[1] != samples[n, 1] or before[2] != samples[n, 2]
            looked = _look(sign * value, sign * before[c], joined, changed, rows[row : row + ROW_SIZE])
            if looked == _GREW:
                _leave(side, weight, counts)
            if looked != _BELOW:
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
    """Look for rails in a sensor's samples (n, 3) m/s^2; source (m,) is below zero where one was interpolated.

    before (3,): the reading before the first sample; joined: it belongs to the same run. Samples from `saturation` on
    are in no place. rows (STATE_SIZE,) and counts (COUNT_SIZE,) are carried on.
    """
    earlier = before[0], before[1], before[2]
    for n in range(samples.shape[0]):
        largest = max(abs(samples[n, 0]), abs(samples[n, 1]), abs(samples[n, 2]))
        if largest < LEAST_MPS2 or source[n] < 0:
            continue
        if n > 0:
            earlier = samples[n - 1, 0], samples[n - 1, 1], samples[n - 1, 2]
            joined = source[n - 1] >= 0
        place = _place_of(samples, n, earlier, joined, rows, counts)
        if place > 0 and largest < saturation:
            counts[place] += 1
