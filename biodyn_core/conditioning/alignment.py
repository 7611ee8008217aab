"""Alignment: a sensor's conditioned samples interpolated at the seat's instants, in any order of arrival."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Final

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.conditioning.conditioned import Block

LARGEST_ERROR: Final = 0.005
"""Largest relative error of interpolation up to the low-pass's cut-off, at every accepted rate."""

DROP_SAMPLES: Final = 64
"""Unneeded samples are dropped so many at a time: dropping at each instant took as long as interpolation."""

_HALF_WIDTHS: Final = (4, 6, 8, 10, 12, 16, 24, 32, 48, 64)


@lru_cache(maxsize=64)
def half_width(rate_hz: float, cutoff_hz: float) -> int:
    """Neighbours needed on either side: for a cut-off of 100 Hz 4 from a rate of 500 Hz on, 48 at 250 Hz."""
    per_rate = cutoff_hz / rate_hz
    return next((h for h in _HALF_WIDTHS if interpolation_error(h, per_rate) < LARGEST_ERROR), _HALF_WIDTHS[-1])


def interpolation_error(half: int, frequency_per_rate: float) -> float:
    """Largest relative error of 2 x half points for a sine, over instants anywhere between two samples."""
    distance = np.linspace(0.05, 0.95, 19)[:, None] + half - 1 - np.arange(2 * half)
    share = lagrange_weights(2 * half) / distance
    share /= share.sum(axis=1, keepdims=True)
    read = (share * np.exp(-2j * np.pi * frequency_per_rate * distance)).sum(axis=1)
    return float(np.abs(read - 1.0).max())


@lru_cache(maxsize=16)
def lagrange_weights(points: int) -> Floats:
    """Barycentric weights of evenly spaced points, up to a common factor."""
    index = np.arange(points)
    weights = np.array([1.0 / np.prod((j - index[index != j]).astype(np.float64)) for j in index])
    return weights / np.abs(weights).max()


class Aligner:
    """Hold one sensor's samples of the last `keep_s`: `add` blocks, `read` at instants, `drop` unneeded samples.

    shortest_loss_s: shorter losses are not told by `lost_s`.
    """

    def __init__(self, keep_s: float, shortest_loss_s: float = math.inf) -> None:
        self._keep_s, self._shortest_loss_s = keep_s, shortest_loss_s
        self._epoch_ns = 0
        self._time_s: Floats = np.empty(0)
        self._run: Integers = np.empty(0, dtype=np.int64)
        self._values: Floats = np.empty(0)
        self._lines: list[tuple[float, float, float]] = []
        self._runs = 0
        self._half = _HALF_WIDTHS[0]

    def add(self, blocks: Iterable[Block]) -> None:
        """Add a sensor's blocks; drop samples older than `keep_s` before the newest."""
        for block in blocks:
            self._epoch_ns = block.epoch_ns
            self._half = half_width(round(block.rate_hz, 1), block.cutoff_hz)
            self._runs += block.begins_run
            if block.begins_run and self._time_s.size and block.time_s[0] <= self._time_s[-1]:
                self._drop_from(float(block.time_s[0]))
            self._time_s = np.concatenate([self._time_s, block.time_s])
            self._run = np.concatenate([self._run, np.full(block.time_s.shape, self._runs)])
            self._values = np.concatenate([self._values, block.low_passed_mps2])
            if block.lost is not None:
                self._add_lines(block, block.lost)
        if self._time_s.size and self._time_s[0] < self._time_s[-1] - 2.0 * self._keep_s:
            self._drop_before(float(self._time_s[-1]) - self._keep_s)

    def _add_lines(self, block: Block, lost: Integers) -> None:
        """Add the lines of a block; the first one is the rest of the last one if blocks have cut its loss."""
        for begin_s, end_s, length_s in _lines(block, lost, self._shortest_loss_s):
            is_rest = bool(self._lines) and begin_s < self._lines[-1][1] - 0.5 / block.rate_hz
            self._lines.append((self._lines.pop()[0] if is_rest else begin_s, end_s, length_s))

    def read(self, grid_s: Floats, epoch_ns: int) -> tuple[Floats, int]:
        """Interpolate at instants grid_s (n,) since epoch_ns: (values (n,), number of instants answered).

        NaN in a gap of the sensor and at the edges of a run; instants whose neighbours may still arrive are left out.
        """
        out = np.empty(grid_s.shape)
        out.fill(np.nan)
        own_s = grid_s + (epoch_ns - self._epoch_ns) * 1e-9
        weights = lagrange_weights(2 * self._half)
        return out, int(kernels.interpolate(self._time_s, self._run, self._values, own_s, weights, out))

    @property
    def has_lines(self) -> bool:
        """Whether it holds lines across losses."""
        return bool(self._lines)

    def lost_s(self, grid_s: Floats, epoch_ns: int, period_s: float) -> Floats:
        """Length of the loss in whose line each instant (n,) lies, seconds, 0 outside of lines.

        period_s: that of the instants; a shorter line has one instant.
        """
        own_s, found = grid_s + (epoch_ns - self._epoch_ns) * 1e-9, np.zeros(grid_s.shape)
        for begin_s, end_s, length_s in self._lines:
            found[(own_s > begin_s) & (own_s < max(end_s, begin_s + period_s))] = length_s
        return found

    @property
    def look_ahead(self) -> int:
        """Number of samples beyond an instant that its answer needs."""
        return self._half

    def reaches(self, time_s: float, epoch_ns: int) -> bool:
        """Whether an instant can be interpolated: its neighbours have arrived, or all samples held lie beyond it."""
        size = self._time_s.size
        if not size:
            return False
        farthest_neighbour_s = float(self._time_s[max(0, size - self._half)])
        return farthest_neighbour_s > time_s + (epoch_ns - self._epoch_ns) * 1e-9

    def drop(self, before_s: float, epoch_ns: int) -> None:
        """Drop the samples that no instant from `before_s` since epoch_ns on needs, many at a time."""
        if self._time_s.size > DROP_SAMPLES + 2 * self._half:
            self._drop_before(before_s + (epoch_ns - self._epoch_ns) * 1e-9)

    def _drop_before(self, before_s: float) -> None:
        self._keep(slice(max(0, int(np.searchsorted(self._time_s, before_s)) - self._half - 1), None))
        if self._lines:
            self._lines = [line for line in self._lines if line[1] > before_s]

    def _drop_from(self, time_s: float) -> None:
        """Drop the samples from a time on: their stamps had leapt ahead and have returned."""
        self._keep(slice(None, int(np.searchsorted(self._time_s, time_s))))
        self._lines = [(begin, min(end, time_s), length) for begin, end, length in self._lines if begin < time_s]

    def _keep(self, part: slice) -> None:
        self._time_s, self._run, self._values = self._time_s[part], self._run[part], self._values[part]


def _lines(block: Block, lost: Integers, shortest_s: float) -> Iterator[tuple[float, float, float]]:
    """Begin and end of the lines across losses of at least shortest_s, and the length of each loss, all in seconds."""
    period_s = 1.0 / block.rate_hz
    told = lost >= max(shortest_s * block.rate_hz, 1.0)
    edges = np.flatnonzero(np.diff(told, prepend=False, append=False)).reshape(-1, 2)
    for begin, end in edges.tolist():
        length_s = float(lost[begin]) * period_s
        yield float(block.time_s[begin]) - period_s, float(block.time_s[end - 1]) + period_s, length_s
