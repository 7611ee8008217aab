"""Rails: where a sensor's own range ends, found by readings that stay at the extreme of an axis.

Each axis has two sides, and each side carries one row of floats, laid out here. The extreme is compared with the `NEXT`
distinct levels next to it, so neither the step nor the noise of the sensor must be known. A reading counts that follows
another one at the extreme, provided that

- the motion came to the extreme in one step, from below all of these levels. The crest of a smooth motion is a parabola:
  where three readings lie in one level, the reading before them lies within four levels.
- another axis changed. A sample that is held or sent twice tells nothing.
- no stay that counts came from the same place. A looped record and a periodic motion repeat themselves.

A motion that moves by more than 8 levels from sample to sample stays in one of 9 levels with a chance of at most 1/9. So
`NEEDED` readings stay there by chance with a probability of at most 9^-9, 3e-9.
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
"""Samples by where each axis lies: 0 elsewhere, 1 at its largest, 2 at its smallest; the first axis runs fastest."""

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
def _place_of(
    samples: Floats, n: int, before: tuple[float, float, float], joined: bool, rows: Floats, counts: Integers
) -> int:
    """Look at one sample's readings; returns its place in `counts`, 0 where no axis lies at an extreme."""
    place, weight = 0, 1
    for c in range(AXES):
        value = samples[n, c]
        side = 0 if value > 0.0 else 1
        row = (SIDES * c + side) * ROW_SIZE
        if abs(value) > max(LEAST_MPS2, rows[row + LOWEST]):
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
