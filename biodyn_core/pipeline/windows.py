"""Windows of one second of stamp time, so that block cuts change nothing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers

WINDOW_NS: Final = 1_000_000_000
LEAST_COVERED: Final = 0.9
"""A window counts with at least this share of its samples."""


class Window(NamedTuple):
    """The rows (n, c) of one second that begins at begin_ns; rate_hz of their stamps, in whole Hz."""

    begin_ns: int
    rate_hz: float
    rows: Floats


class SecondWindows:
    """Collect rows into windows: `push` rows, get the windows that they complete; `end` completes the last one."""

    def __init__(self) -> None:
        self._stamps_ns: list[Integers] = []
        self._rows: list[Floats] = []
        self._number: int | None = None

    def push(self, stamps_ns: Integers, rows: Floats) -> Iterator[Window]:
        """Add rows (n, c) with their stamps (n,) ns; yield each window that later rows have completed."""
        numbers = stamps_ns // WINDOW_NS
        begin = 0
        for end in [*(np.flatnonzero(np.diff(numbers)) + 1).tolist(), numbers.size]:
            if end > begin:
                if self._number is not None and int(numbers[begin]) != self._number:
                    yield from self._complete()
                self._number = int(numbers[begin])
                self._stamps_ns.append(stamps_ns[begin:end])
                self._rows.append(rows[begin:end])
                begin = end

    def end(self) -> Iterator[Window]:
        """Yield the last window; the next rows begin another."""
        if self._number is not None:
            yield from self._complete()
            self._number = None

    def _complete(self) -> Iterator[Window]:
        """The window, unless a gap has left too little of it."""
        assert self._number is not None
        stamps_ns, rows = np.concatenate(self._stamps_ns), np.concatenate(self._rows)
        self._stamps_ns, self._rows = [], []
        period_ns = float(np.median(np.diff(stamps_ns))) if stamps_ns.size > 1 else 0.0
        if stamps_ns.size * period_ns >= LEAST_COVERED * WINDOW_NS:
            yield Window(self._number * WINDOW_NS, float(round(1e9 / period_ns)), rows)
