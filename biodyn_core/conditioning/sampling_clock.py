"""Sampling clock: a sensor's period and times by its stamps: jittered, in bursts, quantised or repeated."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError

_EVEN: Final = 0.1
"""Largest mean jitter of even stamps, in periods."""

_COMPLETE: Final = 0.4
"""Without losses no stamp lies further from an even clock, in periods: a single loss shifts it by 0.5."""

_MIN_LINE: Final = 0.25
"""Least spectral line of periodic stamps: that of Gaussian jitter of 0.27 periods rms."""

_MIN_LINE_STAMPS: Final = 10
"""Fewer stamps have no spectral line."""

_SPECTRUM_STAMPS: Final = 1024
"""The spectrum is of the first so many stamps: its cost grows with the square of their number."""

_MAX_SHARED: Final = 0.05
"""Largest share of samples in the period of the sample before; with more the line is not the samples' own."""

_REGULAR: Final = 0.2
"""With n random losses, some stamp lies further than this times sqrt(n) periods from an even clock (by simulation)."""


_NEIGHBOURS: Final = 15
"""Samples, at most one in twenty with a wrong number, whose median loss is that of the one in their middle."""


_MOST_STEPS: Final = 50
"""With more losses, a stretch of jittered stamps has no sure numbers."""

_LEAST_GAIN: Final = 30.0
"""Least gain of a step: without one, twice the logarithm of the number of samples, 14 of 1000, is usual."""

_LEAST_HEIGHT: Final = 0.4
"""Least height of the step of a loss, in periods: other losses, not yet found, tilt the line by up to half of it."""


_WORST: Final = 7.0
"""The largest of Gaussian jitter is less than this times the mean; stamps of late callbacks exceed it."""


class Clock(NamedTuple):
    """A sensor's clock by its stamps, seconds: sampling period, fitted time of the last, mean and largest |jitter|."""

    period_s: float
    last_s: float
    jitter_s: float
    worst_s: float
    samples: int


def clock_of(stamps_s: Floats, samples: Floats) -> tuple[Clock, bool]:
    """The clock of stamps (n,) and samples (n, 3) in order of arrival, and whether several samples share a stamp.

    A repeated sample counts once. Raises InputError below three stamps.
    """
    coarse = not _repeats_are_duplicates(stamps_s, samples)
    return _in_order(stamps_s if coarse else stamps_s[first_of_each(stamps_s, samples)]), coarse


def _in_order(stamps_s: Floats) -> Clock:
    """The clock of stamps (n,) in order of arrival, or of the sorted ones where these are even.

    Sorted jitter gives no even clock, so even sorted stamps mean samples out of order.
    """
    clock = fit_clock(stamps_s)
    if (np.diff(stamps_s) >= 0.0).all():
        return clock
    in_order = fit_clock(np.sort(stamps_s))
    return in_order if in_order.jitter_s < _EVEN * in_order.period_s else clock


def _repeats_are_duplicates(stamps_s: Floats, samples: Floats) -> bool:
    """Whether a sample with stamp and reading of another is a duplicate, and not a further sample of a coarse stamp.

    It is where readings repeat within a stamp far more often than from one stamp to the next. Where they repeat
    everywhere, all readings of a stamp must be equal, and their number the same under each.
    """
    order = np.argsort(stamps_s, kind="stable")
    stamps_s, samples = stamps_s[order], samples[order]
    shared = np.diff(stamps_s) == 0.0
    alike = (samples[1:] == samples[:-1]).all(axis=1)
    if shared.all() or not shared.any():
        return True
    within, across = float(alike[shared].mean()), float(alike[~shared].mean())
    if across < 0.5:
        return within - across > 0.4 * (1.0 - across)
    each = np.diff(np.flatnonzero(~shared))  # the first and the last stamp may be cut
    return within == 1.0 and each.size > 0 and bool((each == each[0]).all())


def first_of_each(stamps_s: Floats, samples: Floats) -> Integers:
    """Indices of the samples without repetitions of earlier ones, ascending."""
    if (np.diff(stamps_s) > 0.0).all():
        return np.arange(stamps_s.size)  # the usual case; sorting the rows takes longer than the fit of the clock
    rows = np.column_stack([stamps_s, samples])
    return np.sort(np.unique(rows, axis=0, return_index=True)[1])


def fit_clock(stamps_s: Floats) -> Clock:
    """Fit an even clock to stamps (n,) in order of arrival: jittered, in bursts, quantised, or with losses.

    Samples count as lost only in gaps larger than jitter; raises InputError below three stamps.
    """
    return _fit(stamps_s)[0]


def number_samples(stamps_s: Floats) -> tuple[Clock, Floats]:
    """The clock of stamps (n,) in order, and the number (n,) of each sample on it, from 0 on, without lost samples.

    Raises InputError as `fit_clock`.
    """
    clock, index = _fit(stamps_s)
    if (np.diff(index) <= 0.0).any():
        index = _in_sequence(index)
        clock = _line(index, stamps_s)
    if clock.jitter_s < _EVEN * clock.period_s:
        return clock, index
    stepped = _by_steps(stamps_s)
    return stepped if stepped and stepped[0].jitter_s < clock.jitter_s else (clock, index)


def _in_sequence(index: Floats) -> Floats:
    """Numbers (n,) of samples, ascending: a stamp with much jitter took the number of a neighbour.

    The samples around it tell how many were lost before; no more than before any later one, as late stamps pretend.
    """
    order = np.arange(index.size, dtype=np.float64)
    around = scipy.ndimage.median_filter(index - order, size=_NEIGHBOURS, mode="reflect")
    lost = np.minimum.accumulate(around[::-1])[::-1]
    return np.asarray(order + lost - lost[0])


def _by_steps(stamps_s: Floats) -> tuple[Clock, Floats] | None:
    """The clock and the samples' numbers (n,) of stamps with independent jitter, which hides a loss in its gap.

    All stamps after a loss are late by a period. None where stamps depart from the clock in another way.
    """
    index = np.arange(stamps_s.size, dtype=np.float64)
    for _ in range(_MOST_STEPS):
        at, height, gain = _largest_step(index, stamps_s)
        if gain < _LEAST_GAIN:
            clock = _line(index, stamps_s)
            independent = clock.worst_s < _WORST * clock.jitter_s and clock.jitter_s < 0.5 * clock.period_s
            return (clock, index) if independent else None
        if height < _LEAST_HEIGHT:
            return None
        index[at:] += 1.0
    return None


def _largest_step(index: Floats, stamps_s: Floats) -> tuple[int, float, float]:
    """The step in the stamps that improves a line most: first sample after it, height in periods, and gain.

    The gain is the decrease of the sum of squares, over the variance that is left.
    """
    k, t = index - index.mean(), stamps_s - stamps_s.mean()
    spread = float(k @ k)
    period_s = float(k @ t) / spread
    off_s = t - period_s * k
    after = np.arange(k.size - 1.0, 0.0, -1.0)
    off_after_s, k_after = (np.cumsum(values[::-1])[::-1][1:] for values in (off_s, k))
    # The part of a step (0 before, 1 after) that a line cannot follow, squared.
    own = np.maximum(after - after**2 / k.size - k_after**2 / spread, 1e-3)
    gains = np.where(off_after_s > 0.0, off_after_s**2 / own, 0.0)
    best = int(gains.argmax())
    left_s2 = max(float(off_s @ off_s) - float(gains[best]), 1e-30) / k.size
    return best + 1, float(off_after_s[best] / own[best]) / period_s, float(gains[best]) / left_s2


def _fit(stamps_s: Floats) -> tuple[Clock, Floats]:
    """The clock of `fit_clock`, and the number of each sample on it, which two samples may share."""
    if stamps_s.size < 3:
        raise InputError("fewer than three different samples: the rate is unknown")
    order = np.arange(stamps_s.size, dtype=np.float64)
    even = _line(order, stamps_s)
    if even.worst_s < _COMPLETE * even.period_s:
        return even, order
    clock, index = _by_typical_step(stamps_s) or _by_spectrum(stamps_s, even.period_s) or _with_losses(stamps_s, even)
    lost = float(index[-1]) + 1.0 - index.size
    # Stamps closer to an even clock than with losses are complete: quantised, late, or in bursts.
    regular = even.worst_s < _REGULAR * math.sqrt(max(lost, 0.0)) * even.period_s
    return (even, order) if regular or even.jitter_s < clock.jitter_s else (clock, index)


def _by_typical_step(stamps_s: Floats) -> tuple[Clock, Floats] | None:
    """The clock of stamps whose steps are whole multiples of the typical one, and the samples' numbers."""
    gaps_s = np.diff(stamps_s)
    typical_s = float(np.median(gaps_s))
    if typical_s <= 0.0:
        return None
    periods = np.rint(gaps_s / typical_s)
    index = np.concatenate([[0.0], np.cumsum(periods)])
    clean = _line(index, stamps_s)
    if periods.min() <= 0.0 or clean.jitter_s >= _EVEN * clean.period_s or periods.mean() >= 2.0:
        return None
    return clean, index


def _by_spectrum(stamps_s: Floats, longest_period_s: float) -> tuple[Clock, Floats] | None:
    """The clock of the strongest line in the stamps' spectrum, and the samples' numbers.

    Losses do not hide the line, jitter of a third of a period does. They only increase the mean step, by a quarter for
    one sample in five. None without a line, or where several samples would share a period.
    """
    time_s = stamps_s - stamps_s[0]
    first = time_s[:_SPECTRUM_STAMPS]
    span_s = float(first.max())
    if longest_period_s <= 0.0 or span_s <= 0.0 or stamps_s.size < _MIN_LINE_STAMPS:
        return None
    frequency = np.arange(0.98 / longest_period_s, 1.35 / longest_period_s, 0.25 / span_s)
    turn, step = (np.exp(-2j * np.pi * f * first) for f in (frequency[0], 0.25 / span_s))
    line = np.empty(frequency.size, dtype=np.complex128)
    for k in range(frequency.size):
        line[k] = turn.mean()
        turn *= step
    best = int(np.argmax(np.abs(line)))
    if np.abs(line[best]) < max(_MIN_LINE, 6.0 / math.sqrt(first.size)):
        return None
    index = np.rint(frequency[best] * first + np.angle(line[best]) / (2.0 * np.pi))
    while index.size < time_s.size:
        # The period of a part numbers the stamps of a part twice as long.
        period_s, begin_s = np.polyfit(index, first, 1)
        first = time_s[: 2 * index.size]
        index = np.rint((first - begin_s) / period_s)
    if (np.diff(index) <= 0.0).mean() > _MAX_SHARED:
        return None
    index -= index[0]
    return _line(index, stamps_s), index


def _with_losses(stamps_s: Floats, clock: Clock) -> tuple[Clock, Floats]:
    """The clock and the samples' numbers, starting from the clock without losses."""
    gaps_s = np.diff(stamps_s)
    typical_s = float(np.median(gaps_s))
    spread_s = 1.4826 * float(np.median(np.abs(gaps_s - typical_s)))
    lost = np.zeros(gaps_s.size)
    for _ in range(2):
        longest_s = max(1.5 * clock.period_s, clock.period_s + 5.0 * spread_s)
        lost = np.where(gaps_s > longest_s, np.maximum(np.rint(gaps_s / clock.period_s) - 1.0, 0.0), 0.0)
        if lost.sum() > 0.5 * stamps_s.size:
            lost[:] = 0.0  # no stream loses that much: it comes in bursts
        index = np.concatenate([[0.0], np.cumsum(1.0 + lost)])
        clock = _line(index, stamps_s)
    return clock, index


def _line(index: Floats, stamps_s: Floats) -> Clock:
    slope, offset = (float(v) for v in np.polyfit(index, stamps_s, 1))
    off_s = np.abs(stamps_s - offset - slope * index)
    return Clock(slope, offset + slope * float(index[-1]), float(off_s.mean()), float(off_s.max()), stamps_s.size)
