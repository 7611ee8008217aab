"""Repeats: stretches in which a sensor repeats one reading, because it is stuck, or too coarse to show its noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers

LEAST_CHANGING: Final = 4
"""Intervals with changes, 2 s, that lie between two stretches: a single glitch of a stuck sensor is no motion."""

LEAST_SHARE: Final = 0.5
"""A stretch repeats one reading if it does in a larger share of its intervals."""

Extent = tuple[int, int]
"""The first interval of a stretch and the one after its last."""


def unsure(means_mps2: Floats, extents: Sequence[Extent], repeats: Flags, changing: Flags, apart_mps2: float) -> Flags:
    """Flags (k,) of stretches that repeat one reading, and no other stretch has it after changes of the reading.

    A stuck sensor does not return to its reading; one that is too coarse does. means (k, 3); extents: in order of
    time; repeats, changing (b,): the intervals with one reading, and with several. Means alike differ by `apart_mps2`
    at most.
    """
    begins: Integers = np.array([begin for begin, _ in extents], dtype=np.int64)
    ends: Integers = np.array([end for _, end in extents], dtype=np.int64)
    changed = np.concatenate([[0], np.cumsum(changing)])
    found = np.array([bool(repeats[begin:end].mean() > LEAST_SHARE) for begin, end in extents], dtype=np.bool_)
    for at in np.flatnonzero(found):
        alike = np.linalg.norm(means_mps2 - means_mps2[at], axis=1) <= apart_mps2
        between = np.maximum(changed[begins] - changed[ends[at]], changed[begins[at]] - changed[ends])
        found[at] = not (alike & (between >= LEAST_CHANGING)).any()
    return found
