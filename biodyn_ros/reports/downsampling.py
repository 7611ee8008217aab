"""Minimum and maximum of every channel in bins of 0.1 s, returned when they are complete."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers

BIN_NS: Final = 100_000_000


class Bins(NamedTuple):
    """begins_ns (m,), low_mps2 and high_mps2 (m, channels), NaN without a sample."""

    begins_ns: Integers
    low_mps2: Floats
    high_mps2: Floats


class MinMaxDownsampler:
    """One stream: `add` blocks, then `take` the bins that no later sample can change.

    Bins are aligned to 0.1 s of stamp time. The newest bin is kept until a sample lies outside it. Where stamps jump,
    the bins of a block are in order of their stamps. Otherwise the result does not depend on the blocks.
    """

    def __init__(self, channels: int) -> None:
        self._held: list[tuple[Integers, Floats]] = []
        self._none = Bins(np.empty(0, dtype=np.int64), np.empty((0, channels)), np.empty((0, channels)))

    def add(self, stamps_ns: Integers, accel_mps2: Floats) -> None:
        """Add a block: stamps (n,) and acceleration (n, channels)."""
        if stamps_ns.size:
            self._held.append((stamps_ns, accel_mps2))

    def take(self) -> Bins:
        """The complete bins since the last call."""
        if not self._held:
            return self._none
        stamps_ns, accel = (np.concatenate(part) for part in zip(*self._held, strict=True))
        outside = np.flatnonzero(stamps_ns // BIN_NS != stamps_ns[-1] // BIN_NS)
        end = int(outside[-1]) + 1 if outside.size else 0
        self._held = [(stamps_ns[end:], accel[end:])]
        if end == 0:
            return self._none
        return Bins(*binned(stamps_ns[:end], accel[:end], accel[:end], BIN_NS))


def binned(stamps_ns: Integers, low: Floats, high: Floats, width_ns: int) -> tuple[Integers, Floats, Floats]:
    """Reduce the rows of each bin: begins_ns (m,) ascending, minimum of `low` and maximum of `high`, each (m, 6)."""
    bins = stamps_ns // width_ns
    if np.any(bins[1:] < bins[:-1]):  # stamps may jump back, as in a looped bag
        order = np.argsort(bins, kind="stable")
        bins, low, high = bins[order], low[order], high[order]
    first = np.flatnonzero(np.concatenate([[True], bins[1:] != bins[:-1]]))
    return bins[first] * width_ns, np.fmin.reduceat(low, first, axis=0), np.fmax.reduceat(high, first, axis=0)
