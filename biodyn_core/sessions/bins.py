"""Bins: sums, maxima and counts of samples in equal intervals of time, for streams of any length in little memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.arrays import Floats

PIECE: Final = 8192
"""Samples that are summed at once: a fixed number, so that cuts into blocks change no digit."""


class Recut:
    """Rows (n, c) pushed in any cuts leave in pieces of `PIECE` rows; `rest` gives the last, shorter one."""

    def __init__(self) -> None:
        self._waiting: list[Floats] = []
        self._rows = 0

    def push(self, rows: Floats) -> Iterator[Floats]:
        """Add rows, and yield the pieces that are complete."""
        self._waiting.append(rows)
        self._rows += len(rows)
        while self._rows >= PIECE:
            joined = np.concatenate(self._waiting)
            self._waiting, self._rows = [joined[PIECE:]], self._rows - PIECE
            yield joined[:PIECE]

    def rest(self) -> Iterator[Floats]:
        """Yield the rows that are left, if any."""
        if self._rows:
            yield np.concatenate(self._waiting)
        self._waiting, self._rows = [], 0


class Bins:
    """Counts (b,), sums (b, s) and maxima (b, m) by interval of width_s; 0 for an interval without samples.

    short: stored with seven digits, in half of the memory.
    """

    def __init__(self, width_s: float, sums: int, maxima: int = 0, short: bool = False) -> None:
        self.width_s = width_s
        self._first = self._used = 0
        kind: Any = np.float32 if short else np.float64
        self._counts: NDArray[Any] = np.zeros(0, kind)
        self._sums: NDArray[Any] = np.zeros((0, sums), kind)
        self._maxima: NDArray[Any] = np.zeros((0, maxima), kind)

    def add(self, time_s: Floats, sums: Floats, maxima: Floats | None = None) -> None:
        """Add samples at times (n,) with the columns to sum (n, s) and those of maxima (n, m), not negative."""
        if time_s.size == 0:
            return
        at = np.floor(time_s / self.width_s).astype(np.int64) - self._first
        if self._first > 0 and at.min() < 0:
            late = at < 0
            at, sums, maxima = at[~late], sums[~late], None if maxima is None else maxima[~late]
            if at.size == 0:
                return
        low, high = int(at.min()), int(at.max())
        self._grow(high + 1)
        here = slice(low, high + 1)
        self._counts[here] += np.bincount(at - low)
        for column in range(sums.shape[1]):
            self._sums[here, column] += np.bincount(at - low, sums[:, column])
        if maxima is not None:
            np.maximum.at(self._maxima, at, maxima)

    @property
    def counts(self) -> Floats:
        """The number of samples (b,)."""
        return self._counts[: self._used]

    @property
    def sums(self) -> Floats:
        """The sums of columns (b, s)."""
        return self._sums[: self._used]

    @property
    def maxima(self) -> Floats:
        """The maxima of columns (b, m)."""
        return self._maxima[: self._used]

    def extent(self, begin_s: float, end_s: float) -> slice:
        """The intervals whose centre lies between two times."""
        begin, end = (max(0, int(np.ceil(at / self.width_s - 0.5))) for at in (begin_s, end_s))
        return slice(min(begin, self._used), min(end, self._used))

    @property
    def end(self) -> int:
        """The number of intervals since the first, those that were dropped included."""
        return self._first + self._used

    def means(self, begin: int, end: int) -> tuple[Floats, Floats]:
        """Mean of the first column and count in the intervals of these numbers (n,); 0 without samples."""
        low, high = max(begin - self._first, 0), max(min(end - self._first, self._used), 0)
        values, counts = np.zeros(end - begin), np.zeros(end - begin)
        if high > low:
            here = slice(low + self._first - begin, high + self._first - begin)
            counts[here] = self._counts[low:high]
            values[here] = self._sums[low:high, 0] / np.maximum(self._counts[low:high], 1.0)
        return values, counts

    def drop(self, before: int) -> None:
        """Forget the intervals before this number; later samples in them are ignored."""
        gone = min(max(before - self._first, 0), self._used)
        self._counts, self._sums, self._maxima = (
            each[gone:].copy() for each in (self._counts, self._sums, self._maxima)
        )
        self._first, self._used = self._first + gone, self._used - gone

    def _grow(self, used: int) -> None:
        self._used = max(self._used, used)
        if self._used > len(self._counts):
            room = max(self._used, len(self._counts) * 5 // 4, 1024)
            self._counts, self._sums, self._maxima = (
                _longer(each, room) for each in (self._counts, self._sums, self._maxima)
            )


def _longer(values: NDArray[Any], room: int) -> NDArray[Any]:
    """The rows with zeros behind them."""
    return np.concatenate([values, np.zeros((room - len(values), *values.shape[1:]), values.dtype)])
