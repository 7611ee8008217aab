"""Tally: sums and maxima of samples since reset and over a rolling window, in bins."""

from __future__ import annotations

import copy
import math
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError

BIN_S: Final = 0.1
"""Rolling figures move in steps of this."""


class Tally:
    """Bins that close into a total since reset and a ring over the window.

    The first `sums` columns of a bin are sums, the others maxima. absent: bins between the last sample and the end of
    the window, when it is read.
    """

    def __init__(self, rate_hz: float, channels: int, columns: int, sums: int, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._left_over = 0.0
        self.length = max(1, round(BIN_S * rate_hz))
        self.sums = sums
        self.bin = np.zeros((channels, columns))
        self.total = np.zeros((channels, columns))
        self.ring = np.zeros((max(1, math.ceil(window_s * rate_hz / self.length)), channels, columns))
        self.position = np.zeros(2, dtype=np.int64)
        self._before_reset = np.zeros((channels, columns))
        self._reset_in = -1
        self.absent = 0

    def since_reset(self) -> Floats:
        """The total since reset, (c, k)."""
        return self.joined(self.total, self.bin)

    def rolling(self) -> Floats:
        """The total of the window, (c, k)."""
        self._close_reset_bin()
        ring = self.ring
        if self.absent:  # the next slots have the oldest bins, which the window has left
            ring = ring[(int(self.position[1]) + np.arange(min(self.absent, len(ring)), len(ring))) % len(ring)]
        past = ring.max(axis=0, initial=0.0)
        past[:, : self.sums] = ring[:, :, : self.sums].sum(axis=0)
        return self.joined(past, self.joined(self._before_reset, self.bin))

    def end_window(self, absent_s: float) -> None:
        """Let the window end so long after the last sample, until this is called again."""
        self.absent = int(absent_s * self._rate_hz / self.length)

    def joined(self, past: Floats, now: Floats) -> Floats:
        """The total (c, k) of two totals."""
        joined = np.maximum(past, now)
        joined[:, : self.sums] = past[:, : self.sums] + now[:, : self.sums]
        return joined

    def totals(self) -> Floats:
        """The total since reset (c, k), sums times the sampling period: measured rates differ between starts."""
        rows = self.since_reset()
        rows[:, : self.sums] /= self._rate_hz
        return rows

    def resume(self, totals: Floats) -> None:
        """Add totals of an earlier run; the rolling window stays without them."""
        earlier = totals.copy()
        earlier[:, : self.sums] *= self._rate_hz
        self.total = self.joined(self.total, earlier)

    def reset(self) -> None:
        """Set the total since reset to zero; the rolling window continues, and so does its open bin."""
        self._close_reset_bin()
        self._before_reset = self.joined(self._before_reset, self.bin)
        self._reset_in = int(self.position[1])
        self.bin[:] = 0.0
        self.total[:] = 0.0

    def _close_reset_bin(self) -> None:
        """Add what a bin had before a reset to its place in the ring, once it has closed."""
        passed = int(self.position[1]) - self._reset_in
        if self._reset_in < 0 or passed == 0:
            return
        if passed <= len(self.ring):
            slot = self._reset_in % len(self.ring)
            self.ring[slot] = self.joined(self.ring[slot], self._before_reset)
        self._before_reset[:] = 0.0
        self._reset_in = -1

    def skip(self, seconds: float) -> int:
        """Let time pass without samples; return their number. The rounding error is carried to the next break."""
        if not 0.0 <= seconds < math.inf:
            raise InputError(f"a break of {seconds:g} s is impossible: it lasts 0 s or longer")
        passed = self._left_over + seconds * self._rate_hz
        samples = round(passed)
        self._left_over = passed - samples
        self.pass_over(samples)
        return samples

    def pass_over(self, samples: int) -> None:
        """Let samples pass without counting them."""
        closed, self.position[0] = divmod(int(self.position[0]) + samples, self.length)
        if closed:
            slots = len(self.ring)
            self.total = self.since_reset()
            self.ring[self.position[1] % slots] = self.bin
            self.bin[:] = 0.0
            self.position[1] += closed
            # The open bin closes at the break with its present content, the bins after it are empty.
            self.ring[(self.position[1] - 1 - np.arange(min(closed - 1, slots))) % slots] = 0.0

    def at_zero(self) -> Tally:
        """A tally at the same time with the same window, in which nothing is counted."""
        other = copy.deepcopy(self)
        for rows in (other.bin, other.total, other.ring, other._before_reset):
            rows[:] = 0.0
        return other

    def read(self, rolling: bool) -> Floats:
        """The total of the window, or since reset, (c, k)."""
        return self.rolling() if rolling else self.since_reset()
