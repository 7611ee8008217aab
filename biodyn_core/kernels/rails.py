"""Rails: the value at which a sensor's own range ends, found by readings that stay at their extreme.

Each axis has two sides, and each side carries one row of floats, laid out here. The test compares the extreme with the
`NEXT` distinct levels below it, so it needs neither the step nor the noise of the sensor. It counts a reading that
follows another one at the extreme, provided that

- the motion came to the extreme in one step, from below all of these levels: a slow motion, whose crest is a parabola,
  passes through them, and stays in the uppermost of 4 equal ones at most;
- another axis changed: a sample that is held or sent twice says nothing;
- no counted stay came from the same place: a looped record, or a periodic motion, repeats itself.

A motion that moves by more than 8 levels a sample stays in the uppermost of 9 with a chance of at most 1/9. So the chance
that `NEEDED` readings do is at most 9^-9, 3e-9.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from biodyn_core.arrays import Floats, Integers
from biodyn_core.kernels.compiling import compiled, inlined

LEAST_MPS2: Final = 12.0
"""No rail lies below: a sensor reads gravity, with its bias and gain, however it is mounted."""

SAME: Final = 2.0**-17
"""Readings that differ by less than this share are the same level: a quarter of a 16-bit step, above rounding."""

NEXT: Final = 8
"""So many distinct levels next to the extreme are known before it is judged."""

NEEDED: Final = 9
"""So many readings that stay at the extreme make it a rail."""

# One side's row: its extreme and the next levels, falling; whether it is a rail; how many readings stayed ...
EXTREME, LOWEST = 0, NEXT
FOUND, STAYED, STAYS, ENTRY = range(NEXT + 1, NEXT + 5)
# ... and from where the stays that count came.
ENTRIES: Final = ENTRY + 1
ROW_SIZE: Final = ENTRIES + NEEDED

AXES, SIDES = 3, 2
ROWS: Final = AXES * SIDES
STATE_SIZE: Final = ROWS * ROW_SIZE
"""Six rows of floats: of each axis that of its largest readings, then that of its smallest ones, mirrored."""

COUNT_SIZE: Final = (1 + SIDES) ** AXES
"""Samples by where each axis lies: 0 elsewhere, 1 at its largest reading, 2 at its smallest; the last axis runs first."""

_BELOW, _AT_EXTREME, _GREW = range(3)


@inlined
def _is_at(value: float, level: float) -> bool:
    return abs(value - level) <= SAME * level


@inlined
def _enter(entry: float, row: Floats) -> None:
    """Begin a stay at the extreme; one that does not count comes from infinity."""
    row[ENTRY] = np.inf
    if row[LOWEST] == 0.0 or entry >= row[LOWEST]:
        return
    for k in range(int(row[STAYS])):
        if abs(entry - row[ENTRIES + k]) < 0.5 * (row[EXTREME] - row[LOWEST]):
            return
    row[ENTRY] = entry


@inlined
def _stay(row: Floats) -> None:
    """Count a reading that stays at the extreme."""
    if row[FOUND] > 0.0 or row[ENTRY] == np.inf:
        return
    stays = int(row[STAYS])
    if stays == 0 or row[ENTRIES + stays - 1] != row[ENTRY]:
        row[ENTRIES + stays] = row[ENTRY]
        row[STAYS] += 1.0
    row[STAYED] += 1.0
    if row[STAYED] >= NEEDED:
        row[FOUND] = 1.0


@inlined
def _place(value: float, row: Floats) -> None:
    """Keep a level among those next to the extreme, unless it is one of them or below all."""
    if value <= row[LOWEST]:
        return
    place = NEXT
    while value > row[place - 1]:
        place -= 1
    if _is_at(value, row[place - 1]) or _is_at(value, row[place]):
        return
    for k in range(NEXT, place, -1):
        row[k] = row[k - 1]
    row[place] = value


@compiled
def _look(value: float, before: float, joined: bool, changed: bool, row: Floats) -> int:
    """Look at one reading of a side, mirrored so that it is positive, and at the one before it."""
    extreme = row[EXTREME]
    if value > extreme and not _is_at(value, extreme):
        for k in range(NEXT, 0, -1):
            row[k] = row[k - 1]
        row[EXTREME] = value
        row[FOUND] = row[STAYED] = row[STAYS] = 0.0
        _enter(before if joined else np.inf, row)
        return _GREW
    if not _is_at(value, extreme):
        _place(value, row)
        return _BELOW
    if not joined:
        row[ENTRY] = np.inf
    elif not _is_at(before, extreme):
        _enter(before, row)
    elif changed:
        _stay(row)
    return _AT_EXTREME


@compiled
def _leave(side: int, weight: int, counts: Integers) -> None:
    """An extreme was exceeded: samples that lay there lie elsewhere."""
    for k in range(COUNT_SIZE):
        if k // weight % (1 + SIDES) == side + 1:
            counts[k - (side + 1) * weight] += counts[k]
            counts[k] = 0


@inlined
def find_rails(
    samples: Floats, at: int, before: Floats, joined: bool, changed: bool, rows: Floats, counts: Integers
) -> int:
    """Look at a sample's readings (n, 3); returns its place in `counts`, 0 where no axis lies at an extreme.

    before (3,): the readings of the sample before; joined: none is missing in between; changed: they differ.
    rows (STATE_SIZE,) and counts (COUNT_SIZE,) are carried on.
    """
    place, weight = 0, 1
    for c in range(AXES):
        value = samples[at, c]
        if abs(value) >= LEAST_MPS2:
            side = 0 if value > 0.0 else 1
            sign = 1.0 - 2.0 * side
            begin = (SIDES * c + side) * ROW_SIZE
            looked = _look(sign * value, sign * before[c], joined, changed, rows[begin : begin + ROW_SIZE])
            if looked == _GREW:
                _leave(side, weight, counts)
            if looked != _BELOW:
                place += (side + 1) * weight
        weight *= 1 + SIDES
    return place
