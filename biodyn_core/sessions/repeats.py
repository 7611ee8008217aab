"""Repeats: stretches in which a sensor repeats one reading, because it is stuck, or too coarse to show its noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats

LEAST_CHANGING: Final = 4
"""Intervals without repeats, 2 s, that lie between two stretches: a single glitch of a stuck sensor is no motion."""

Extent = tuple[int, int]
"""The first interval of a stretch and the one after its last."""


def recur(means_mps2: Floats, extents: Sequence[Extent], repeats: Flags, apart_mps2: float) -> Flags:
    """Flags (k,) of stretches whose mean reading (k, 3) another one has too, with other readings between both.

    A stuck sensor does not return to its reading; one that is too coarse does. extents: in order of time; repeats (b,):
    the intervals with one reading. Means alike differ by `apart_mps2` at most.
    """
    count = len(extents)
    alike = np.linalg.norm(means_mps2[:, None] - means_mps2, axis=2) <= apart_mps2
    found = np.zeros(count, dtype=np.bool_)
    for one in range(count):
        for other in range(one + 1, count):
            between = repeats[extents[one][1] : extents[other][0]]
            if alike[one, other] and (~between).sum() >= LEAST_CHANGING:
                found[[one, other]] = True
    return found
