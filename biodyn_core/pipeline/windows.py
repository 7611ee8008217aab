"""Windows of one second of stamp time, so that block cuts change nothing.

Stamps say to which second a row belongs. How many rows a second has is known from the rate, because the steps of
stamps do not show it: stamps may be quantised, or come in bursts.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers

WINDOW_NS: Final = 1_000_000_000
LEAST_COVERED: Final = 0.9
"""A window counts with at least this share of its samples."""


class Window(NamedTuple):
    """The rows (n, c) of one second that begins at begin_ns; rate_hz of the rows."""

    begin_ns: int
    rate_hz: float
    rows: Floats


class SecondWindows:
    """Collect evenly sampled rows into windows: `push` rows, get the windows that they complete; `end` the last one."""

    def __init__(self) -> None:
        self._rows: list[Floats] = []
        self._number: int | None = None
        self._rate_hz = 0.0

    def push(self, stamps_ns: Integers, rows: Floats, rate_hz: float) -> Iterator[Window]:
        """Add rows (n, c) with their stamps (n,) ns; yield each window that later rows have completed.

        rate_hz: of the sensor's clock, always the same.
        """
        self._rate_hz = rate_hz
        numbers = stamps_ns // WINDOW_NS
        begin = 0
        for end in [*(np.flatnonzero(np.diff(numbers)) + 1).tolist(), numbers.size]:
            if end > begin:
                if self._number is not None and int(numbers[begin]) != self._number:
                    yield from self._complete()
                self._number = int(numbers[begin])
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
        rows, self._rows = np.concatenate(self._rows), []
        if len(rows) >= LEAST_COVERED * self._rate_hz:
            yield Window(self._number * WINDOW_NS, self._rate_hz, rows)
