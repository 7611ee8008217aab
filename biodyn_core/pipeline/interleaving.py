"""Interleaving: samples of several sensors in the order of their stamps, so that no sensor runs ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.sensor import LEAP_S

Part = tuple[int, int, int]
"""Index of a series, first and end of its samples."""

SLICE_S: Final = 0.05
"""Largest lead of a sensor over another: a fraction of the shortest wait_s."""


def in_turns(times_s: Sequence[Floats], slice_s: float) -> list[Part]:
    """Cut series with times (n,) s that do not decrease into slices, ordered by time, then by series."""
    parts: list[tuple[float, Part]] = []
    for number, time_s in enumerate(times_s):
        slots = np.floor(time_s / slice_s)
        edges = [0, *(np.flatnonzero(np.diff(slots)) + 1).tolist(), time_s.size]
        parts += [(float(slots[a]), (number, a, b)) for a, b in pairwise(edges) if a < b]
    return [part for _, part in sorted(parts, key=lambda item: item[0])]


def in_stamp_order(stamps_ns: Mapping[str, Integers]) -> list[tuple[str, slice]]:
    """Order arrived samples of several sensors by their raw stamps (n,) ns; the order within a sensor stays.

    Single stray stamps have no effect, and a common leap of all sensors keeps them together.
    """
    names = [name for name, stamps in stamps_ns.items() if stamps.size]
    if not names:
        return []
    epoch_ns = int(np.median(stamps_ns[names[0]]))
    turns = in_turns([_progress_s(stamps_ns[name], epoch_ns) for name in names], SLICE_S)
    return [(names[number], slice(begin, end)) for number, begin, end in turns]


def _progress_s(stamps_ns: Integers, epoch_ns: int) -> Floats:
    """Non-decreasing seconds by stamps: steps back and leaps count as zero, most stamps keep their time."""
    time_s = 1e-9 * (stamps_ns - epoch_ns)
    steps_s = np.diff(time_s, prepend=time_s[0])
    progress_s: Floats = np.cumsum(np.where(np.abs(steps_s) < LEAP_S, np.maximum(steps_s, 0.0), 0.0))
    return progress_s + np.median(time_s - progress_s)
