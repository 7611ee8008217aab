"""Clocks: drift of a sensor's header stamps against another clock, the recorder's log times or times of arrival.

Transport delays, in bursts, and never advances. So a robust line through the smallest lag of each second gives rate and
offset (Theil 1950, Sen 1968). Memory does not grow with the record; block cuts never change a bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers

BIN_NS: Final = 1_000_000_000
"""The smallest lag is over one second: longer than the bursts of recorders."""

LEAP_NS: Final = 1_000_000_000
"""A lag that differs from the typical one by more is no delay: the stamp is stray, or the clock was set."""

MIN_POINTS: Final = 5
"""Fewer seconds give no rate."""

QUANTUM_NS: Final = 1_000_000
"""Stamps that advance in steps of this or more are quantised."""

_BATCH_NS: Final = 8 * BIN_NS
_BATCH_SAMPLES: Final = 1 << 16
_WAITING_SAMPLES: Final = 4096
_MAX_POINTS: Final = 256
_LEAP_CONFIRMED_BY: Final = 20
_MAX_REPEATED_SHARE: Final = 0.01
_NONE: Final = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class ClockDrift:
    """Drift of one clock against the reference, over the longest stretch in which neither leapt.

    ppm > 0: the sensor's clock is fast, its stamps gain so many microseconds on the reference per second; None below
    MIN_POINTS seconds. ppm_error: half the 95 % interval of the line (Sen 1968); for quantised stamps at least the
    spread about it over the stretch, because a slow beat of rate and quantum looks like drift. offset_s > 0: the
    reference is later than the stamp of the same sample, at the stretch's start and by the least delay; a late clock
    and a late transport cannot be distinguished. scatter_s: standard deviation, by the median, of each second's least
    lag about the line. seconds: the stretch's length by the reference. leaps: how often either clock was set by more
    than a second. quantum_s: the stamps are multiples of it, None below QUANTUM_NS.
    """

    ppm: float | None
    ppm_error: float | None
    offset_s: float
    scatter_s: float
    seconds: float
    leaps: int
    quantum_s: float | None

    @property
    def copied(self) -> bool:
        """Whether the reference is the stamps themselves."""
        return self.offset_s == 0.0 and self.scatter_s == 0.0 and not self.ppm


class _Point(NamedTuple):
    """The smallest lag of some seconds: its time, and reference minus stamp, ns."""

    reference_ns: int
    lag_ns: int


class ClockComparison:
    """Compare a sensor's stamps with a reference: `push` both, and read the `result` at any time."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Integers, Integers]] = []
        self._waiting_samples = 0
        self._batch: tuple[Integers, Integers] = _NONE, _NONE
        self._steps = _Steps()
        self._history = _History()

    def push(self, stamps_ns: Integers, reference_ns: Integers) -> None:
        """Take stamps (n,) and the reference's times (n,) of the same samples, ns, in order of arrival.

        Stamps of zero were never set and are ignored. The arrays must not be written to afterwards.
        """
        self._waiting.append((stamps_ns, reference_ns))
        self._waiting_samples += stamps_ns.shape[0]
        if self._waiting_samples >= _WAITING_SAMPLES:
            self._process()

    def result(self) -> ClockDrift | None:
        """The drift over the longest stretch so far; None before a stamp is set."""
        history = self._so_far()
        return self._fitted(history.longest, history.leaps)

    def since_leap(self) -> ClockDrift | None:
        """The drift over the present stretch, which alone shows the clock's present setting; None without one."""
        history = self._so_far()
        return self._fitted(history.current, history.leaps)

    def _so_far(self) -> _History:
        self._process()
        history = self._history.copy()
        if self._batch[0].size:
            history.add(*self._batch)
        return history

    def _fitted(self, stretch: _Stretch, leaps: int) -> ClockDrift | None:
        return _fitted(stretch, leaps, self._steps.quantum_ns()) if stretch.points() else None

    def _process(self) -> None:
        """Reduce every complete batch of the waiting samples to a few points."""
        if not self._waiting:
            return
        stamps_ns, reference_ns = (np.concatenate(part) for part in zip(*self._waiting, strict=True))
        self._waiting, self._waiting_samples = [], 0
        is_set = stamps_ns != 0
        if not is_set.all():
            stamps_ns, reference_ns = stamps_ns[is_set], reference_ns[is_set]
        self._steps.add(stamps_ns)
        reference_ns, lags_ns = (
            np.concatenate(part) for part in zip(self._batch, (reference_ns, reference_ns - stamps_ns), strict=True)
        )
        while (end := _batch_end(reference_ns)) is not None:
            self._history.add(reference_ns[:end], lags_ns[:end])
            reference_ns, lags_ns = reference_ns[end:], lags_ns[end:]
        self._batch = reference_ns, lags_ns


def _batch_end(reference_ns: Integers) -> int | None:
    """End of the first batch, None while it is incomplete; slight disorder of the reference ends none."""
    if reference_ns.size == 0:
        return None
    batch = reference_ns[:_BATCH_SAMPLES] // _BATCH_NS  # a look at all that wait would take a square of their number
    ends = np.flatnonzero((batch > batch[0]) | (batch < batch[0] - 1))
    if ends.size:
        return int(ends[0])
    return _BATCH_SAMPLES if batch.size == _BATCH_SAMPLES else None


def _lowest(reference_ns: Integers, lags_ns: Integers) -> tuple[int, list[_Point]]:
    """The typical lag of a batch, and the smallest of each second, without stray stamps."""
    middle = lags_ns.size // 2
    typical_ns = int(np.partition(lags_ns, middle)[middle])
    near = np.abs(lags_ns - typical_ns) < LEAP_NS
    if not near.all():
        reference_ns, lags_ns = reference_ns[near], lags_ns[near]
    bins = np.maximum.accumulate(reference_ns // BIN_NS)
    edges = [0, *(np.flatnonzero(bins[1:] != bins[:-1]) + 1).tolist(), bins.size]
    lowest = [lo + int(lags_ns[lo:hi].argmin()) for lo, hi in pairwise(edges)]
    return typical_ns, [_Point(int(reference_ns[i]), int(lags_ns[i])) for i in lowest]


class _History:
    """The present stretch and the longest one before it, both without a leap of either clock."""

    def __init__(self) -> None:
        self.current, self._before = _Stretch(), _Stretch()
        self._typical_ns: int | None = None
        self.leaps = 0

    def copy(self) -> _History:
        other = _History()
        other.current, other._before = self.current.copy(), self._before
        other._typical_ns, other.leaps = self._typical_ns, self.leaps
        return other

    def add(self, reference_ns: Integers, lags_ns: Integers) -> None:
        """Add one batch; ignore one with a leap that has too few samples to confirm it."""
        typical_ns, points = _lowest(reference_ns, lags_ns)
        if self._typical_ns is not None and abs(typical_ns - self._typical_ns) > LEAP_NS:
            if lags_ns.size < _LEAP_CONFIRMED_BY:
                return
            self.leaps += 1
            self._before, self.current = self.longest, _Stretch()
        self._typical_ns = typical_ns
        self.current.add(points, int(reference_ns[0]), int(reference_ns[-1]))

    @property
    def longest(self) -> _Stretch:
        return max(self._before, self.current, key=lambda stretch: stretch.length_ns)


class _Stretch:
    """The points of a stretch without a leap: one per second at first, one per 2, 4, 8 ... as it grows."""

    def __init__(self) -> None:
        self._points: list[_Point] = []
        self._open: list[_Point] = []
        self._width = 1
        self.begin_ns: int | None = None
        self.end_ns = 0

    def copy(self) -> _Stretch:
        other = _Stretch()
        other._points, other._open, other._width = list(self._points), list(self._open), self._width
        other.begin_ns, other.end_ns = self.begin_ns, self.end_ns
        return other

    def add(self, points: list[_Point], begin_ns: int, end_ns: int) -> None:
        """Add a batch's points, and the times of its first and last samples."""
        self.begin_ns = begin_ns if self.begin_ns is None else self.begin_ns
        self.end_ns = end_ns
        for point in points:
            self._open.append(point)
            if len(self._open) < self._width:
                continue
            self._points.append(_least(self._open))
            self._open = []
            if len(self._points) == _MAX_POINTS:
                self._points = [_least(self._points[i : i + 2]) for i in range(0, _MAX_POINTS, 2)]
                self._width *= 2

    def points(self) -> list[_Point]:
        return [*self._points, _least(self._open)] if self._open else self._points

    @property
    def length_ns(self) -> int:
        """By the reference; -1 for an empty stretch."""
        return -1 if self.begin_ns is None else max(self.end_ns - self.begin_ns, 0)


def _least(points: list[_Point]) -> _Point:
    return min(points, key=lambda point: point.lag_ns)


def _fitted(stretch: _Stretch, leaps: int, quantum_ns: int | None) -> ClockDrift:
    points, begin_ns = stretch.points(), stretch.begin_ns or 0
    least_ns, seconds = points[0].lag_ns, stretch.length_ns * 1e-9
    quantum_s = None if quantum_ns is None else quantum_ns * 1e-9
    # Subtract as integers: a float cannot hold whole nanoseconds.
    t = np.array([point.reference_ns - begin_ns for point in points]) * 1e-9
    lag = np.array([point.lag_ns - least_ns for point in points]) * 1e-9
    ppm, ppm_error, residual = None, None, lag
    if t.size >= MIN_POINTS and seconds > 0.0 and np.ptp(t) > 0.0:
        slope, error = _theil_sen(t, lag)
        residual = lag - slope * t
        if quantum_s is not None:
            low, high = np.percentile(residual, [10.0, 90.0])
            error = max(error, float(high - low) / seconds)
        ppm, ppm_error = -1e6 * slope, 1e6 * error
    level = float(np.median(residual))
    return ClockDrift(
        ppm=ppm,
        ppm_error=ppm_error,
        offset_s=least_ns * 1e-9 + level,
        scatter_s=1.4826 * float(np.median(np.abs(residual - level))),
        seconds=seconds,
        leaps=leaps,
        quantum_s=quantum_s,
    )


def _theil_sen(t: Floats, y: Floats) -> tuple[float, float]:
    """Median slope of all pairs, and half its 95 % interval (Sen 1968)."""
    i, j = np.triu_indices(t.size, 1)
    apart = t[j] != t[i]
    slopes = np.sort((y[j] - y[i])[apart] / (t[j] - t[i])[apart])
    n = t.size
    reach = 0.5 * 1.96 * np.sqrt(n * (n - 1) * (2 * n + 5) / 18.0)
    low = max(int(slopes.size / 2 - reach), 0)
    high = min(int(np.ceil(slopes.size / 2 + reach)), slopes.size - 1)
    return float(np.median(slopes)), 0.5 * float(slopes[high] - slopes[low])


class _Steps:
    """The quantum of stamps, by their steps."""

    def __init__(self) -> None:
        self._last = _NONE
        self._divisor_ns = 0
        self._least_ns, self._least_count = 0, 0
        self._repeated = 0
        self._count = 0

    def add(self, stamps_ns: Integers) -> None:
        if 0 < self._divisor_ns < QUANTUM_NS or not stamps_ns.size:
            return
        steps_ns = np.abs(np.diff(_to_microseconds(np.concatenate([self._last, stamps_ns]))))
        self._last = stamps_ns[-1:]
        moving = steps_ns[steps_ns != 0]
        self._count += steps_ns.size
        self._repeated += steps_ns.size - moving.size
        if moving.size:
            self._divisor_ns = int(np.gcd(self._divisor_ns, np.gcd.reduce(moving)))
            least_ns = int(moving.min())
            if not self._least_count or least_ns < self._least_ns:
                self._least_ns, self._least_count = least_ns, 0
            self._least_count += int((moving == self._least_ns).sum())

    def quantum_ns(self) -> int | None:
        """The steps' common divisor, unless it is fine, or the period of an even clock."""
        coarse = self._divisor_ns >= QUANTUM_NS
        on_a_grid = self._least_ns == self._divisor_ns and self._least_count > 0.5 * self._count
        even = on_a_grid and self._repeated <= _MAX_REPEATED_SHARE * self._count
        return self._divisor_ns if coarse and not even else None


def _to_microseconds(stamps_ns: Integers) -> Integers:
    """Nearest whole microseconds, in ns: drivers that compute in seconds err by a nanosecond."""
    return (stamps_ns + 500) // 1000 * 1000
