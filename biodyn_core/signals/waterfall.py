"""Waterfall: power over time and frequency of a stream, in constant memory.

Periodograms of one second, averaged in bins of time; with more than `BINS` bins, neighbours are merged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats, Integers

BIN_NS: Final = 1_000_000_000
BINS: Final = 240
"""Most bins that a page can show; a longer record doubles their width."""

MAX_HZ: Final = 50.0
USABLE: Final = 0.45
"""Largest frequency per sampling rate."""


@dataclass(frozen=True, eq=False)
class Waterfall:
    """Power spectral density (b, f, m), (unit)^2/Hz, of m channels in bins of time that begin at begins_ns (b,).

    NaN for a channel without an unmasked second. frequency_hz (f,) is spaced evenly.
    """

    width_ns: int
    begins_ns: Integers
    frequency_hz: Floats
    density: Floats


class WaterfallMeter:
    """Build a waterfall: `push` samples, `part` at a break of time. Any cut into blocks gives the same."""

    def __init__(self, rate_hz: float, channels: int) -> None:
        size = max(2, int(rate_hz * (1.0 + 1e-9)))  # not longer than a bin, so that no bin stays empty
        self._window = scipy.signal.get_window("hann", size)
        frequency = np.arange(size // 2 + 1) * rate_hz / size
        self._at = np.flatnonzero((frequency > 0.5) & (frequency <= min(MAX_HZ + 0.5, USABLE * rate_hz)))
        self._frequency_hz = frequency[self._at]
        self._scale = 2.0 / (rate_hz * float((self._window**2).sum()))
        self._channels, self._width_ns = channels, BIN_NS
        self._bins: dict[int, tuple[Floats, Integers]] = {}
        self.part()

    @property
    def stored(self) -> int:
        """Number of samples and bins held."""
        return self._stamps_ns.size + len(self._bins)

    def part(self) -> None:
        """Begin another stretch of time, which shares no periodogram with the one before."""
        self._stamps_ns, self._rows = np.empty(0, dtype=np.int64), np.empty((0, self._channels))

    def push(self, stamps_ns: Integers, values: Floats) -> None:
        """Add samples (n, m) at stamps (n,), NaN where masked."""
        stamps_ns, rows = np.concatenate([self._stamps_ns, stamps_ns]), np.concatenate([self._rows, values])
        size = self._window.size
        count = rows.shape[0] // size
        for begin in range(0, count * size, size):
            part = rows[begin : begin + size]
            lines = np.fft.rfft((part - part.mean(axis=0)) * self._window[:, None], axis=0)[self._at]
            self._add(int(stamps_ns[begin + size // 2]), self._scale * np.abs(lines) ** 2)
        self._stamps_ns, self._rows = stamps_ns[count * size :].copy(), rows[count * size :].copy()

    def _add(self, middle_ns: int, density: Floats) -> None:
        """Add a periodogram to the bin of its middle: its first sample may lie just before the bin that it covers."""
        known = np.asarray(~np.isnan(density).any(axis=0), dtype=np.int64)
        self._join(middle_ns // self._width_ns, np.where(known, density, 0.0), known)
        while max(self._bins) - min(self._bins) >= BINS:
            narrow, self._bins = self._bins, {}
            self._width_ns *= 2
            for number, (total, seen) in narrow.items():
                self._join(number // 2, total, seen)

    def _join(self, number: int, total: Floats, seen: Integers) -> None:
        before = self._bins.get(number)
        self._bins[number] = (total, seen) if before is None else (before[0] + total, before[1] + seen)

    def waterfall(self) -> Waterfall:
        """The waterfall so far."""
        numbers = sorted(self._bins)
        density = np.full((len(numbers), self._at.size, self._channels), np.nan)
        for row, number in enumerate(numbers):
            total, seen = self._bins[number]
            density[row, :, seen > 0] = (total[:, seen > 0] / seen[seen > 0]).T
        begins_ns = np.array(numbers, dtype=np.int64) * self._width_ns
        return Waterfall(self._width_ns, begins_ns, self._frequency_hz, density)
