"""Alignment: a sensor's conditioned samples read at the seat's instants, whatever order they arrive in."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core import kernels
from biodyn_core.conditioning import Block

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

HALF_WIDTH: Final = 4
"""Neighbours on either side: eight-point Lagrange errs by 0.46 % at 100 Hz and 500 Hz sampling, far less above."""


def _lagrange_weights(points: int) -> Floats:
    """Barycentric weights of evenly spaced points, up to a common factor."""
    index = np.arange(points)
    weights = np.array([1.0 / np.prod(j - index[index != j]) for j in index])
    return weights / np.abs(weights).max()


_WEIGHTS: Final = _lagrange_weights(2 * HALF_WIDTH)


class Aligner:
    """Keeps one sensor's recent samples, `keep_s` at most, and answers at grid instants: `feed`, `read`, `forget`."""

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._epoch_ns = 0
        self._time_s: Floats = np.empty(0)
        self._run: Integers = np.empty(0, dtype=np.int64)
        self._values: Floats = np.empty(0)
        self._runs = 0

    def feed(self, blocks: Iterable[Block]) -> None:
        """Take over a sensor's blocks; what is older than `keep_s` before the newest is dropped."""
        for block in blocks:
            self._epoch_ns = block.epoch_ns
            self._runs += block.begins_run
            self._time_s = np.concatenate([self._time_s, block.time_s])
            self._run = np.concatenate([self._run, np.full(block.time_s.shape, self._runs)])
            self._values = np.concatenate([self._values, block.low_passed_mps2])
        if self._time_s.size and self._time_s[0] < self._time_s[-1] - 2.0 * self._keep_s:
            self._forget(float(self._time_s[-1]) - self._keep_s)

    def read(self, grid_s: Floats, epoch_ns: int) -> tuple[Floats, int]:
        """Answer at instants grid_s (n,) since epoch_ns: (values (n,), how many are answered).

        NaN where the sensor has a gap or the edge of a run; unanswered are instants whose neighbours may still come.
        """
        out = np.full(grid_s.shape, np.nan)
        own_s = grid_s + (epoch_ns - self._epoch_ns) * 1e-9
        return out, int(kernels.interpolate(self._time_s, self._run, self._values, own_s, _WEIGHTS, out))

    def reaches(self, time_s: float, epoch_ns: int) -> bool:
        """Whether any sample lies beyond an instant, so that it may be answered."""
        return self._time_s.size > 0 and float(self._time_s[-1]) > time_s + (epoch_ns - self._epoch_ns) * 1e-9

    def forget(self, before_s: float, epoch_ns: int) -> None:
        """Drop samples that no instant from `before_s` since epoch_ns on can need."""
        self._forget(before_s + (epoch_ns - self._epoch_ns) * 1e-9)

    def _forget(self, before_s: float) -> None:
        keep = max(0, int(np.searchsorted(self._time_s, before_s)) - HALF_WIDTH - 1)
        self._time_s, self._run, self._values = self._time_s[keep:], self._run[keep:], self._values[keep:]
