"""Interleaving: samples of several sensors in the order of their stamps, so that no sensor runs ahead of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.sensor import LEAP_S

Part = tuple[int, int, int]
"""The number of a series, and the first and the end of its samples."""

SLICE_S: Final = 0.05
"""A sensor is ahead of another by less than this: a fraction of the shortest time that comparisons wait."""


def in_turns(times_s: Sequence[Floats], slice_s: float) -> list[Part]:
    """Cut series, whose times (n,) s do not decrease, into slices, and order the slices by time, then as given."""
    parts: list[tuple[float, Part]] = []
    for number, time_s in enumerate(times_s):
        slots = np.floor(time_s / slice_s)
        edges = [0, *(np.flatnonzero(np.diff(slots)) + 1).tolist(), time_s.size]
        parts += [(float(slots[a]), (number, a, b)) for a, b in pairwise(edges) if a < b]
    return [part for _, part in sorted(parts, key=lambda item: item[0])]


def in_stamp_order(stamps_ns: Mapping[str, Integers]) -> list[tuple[str, slice]]:
    """Order samples that arrived of several sensors by their raw stamps (n,) ns; within a sensor their order stays.

    Single stamps that lie astray do not count, and a leap that all sensors make alike keeps them together.
    """
    names = [name for name, stamps in stamps_ns.items() if stamps.size]
    if not names:
        return []
    epoch_ns = int(np.median(stamps_ns[names[0]]))
    turns = in_turns([_progress_s(stamps_ns[name], epoch_ns) for name in names], SLICE_S)
    return [(names[number], slice(begin, end)) for number, begin, end in turns]


def _progress_s(stamps_ns: Integers, epoch_ns: int) -> Floats:
    """Seconds by stamps that never decrease: steps back and leaps count as none, most stamps keep their time."""
    time_s = 1e-9 * (stamps_ns - epoch_ns)
    steps_s = np.diff(time_s, prepend=time_s[0])
    progress_s: Floats = np.cumsum(np.where(np.abs(steps_s) < LEAP_S, np.maximum(steps_s, 0.0), 0.0))
    return progress_s + np.median(time_s - progress_s)
