"""Rest: what a sensor tells while nothing moves, its clock and its mean reading, gravity and bias together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.arrays import Floats, Integers
from biodyn_core.errors import InputError
from biodyn_core.kernels.sensor import LEAP_S

_STANDING_SAMPLES: Final = 1_000
"""So many samples without a later stamp mean that stamps stand still."""

_LEAST_SAMPLES: Final = 10
"""Fewer samples than this are no rest, however slow the sensor."""

_MOST_PER_S: Final = 50_000.0
"""More samples than this in a second of a sensor's stamps come from no sensor: the stamps do not move on."""

_SLOW_STEPS: Final = 5.0
"""A step of the stamps up to so many typical ones is no gap: a slow sensor is not one that is full of gaps."""

_TYPICAL_STEPS: Final = 100
"""The first so many steps of a window tell the typical one; no more, so that block cuts never change the verdict."""

_EVEN: Final = 0.1
"""Mean jitter, in periods, up to which stamps count as even."""

_COMPLETE: Final = 0.4
"""Where no stamp lies further than so many periods from an even clock none is lost: a single loss bends it by 0.5."""

_LEAST_BEAT: Final = 0.25
"""Stamps keep a beat whose spectral line is at least so strong: that of Gaussian jitter of 0.27 periods rms."""

_BEAT_SAMPLES: Final = 1024
"""The first so many stamps tell their beat: its spectrum costs by the square of their number."""

_SHARED_BEATS: Final = 0.05
"""More samples than this that share a beat with the one before mean that it is not the samples' own."""

_REGULAR: Final = 0.2
"""Of n samples lost at random some lies further than this times sqrt(n) periods from an even clock (by simulation)."""

_STANDING: Final = "stamps stand still: use log time (--time log), or mend the driver's stamps"


@dataclass(frozen=True)
class Rest:
    """A sensor at rest: its clock by its stamps, its mean reading, and the last reading, all (3,) m/s^2.

    last_time_s since epoch_ns, fitted; jitter_s mean absolute; samples: how many the clock was fitted to; coarse:
    several samples share a stamp; in_motion: no rest came, and motion was averaged instead.
    """

    epoch_ns: int
    period_s: float
    last_time_s: float
    jitter_s: float
    samples: int
    coarse: bool
    mean_mps2: tuple[float, float, float]
    last_mps2: tuple[float, float, float]
    in_motion: bool


class RestWindow:
    """Collects the first seconds of a sensor until one window of them is at rest, or patience runs out.

    No window spans a gap or a jump of the stamps: behind one, waiting starts anew. Readings from `implausible_mps2` on
    count for the clock alone.
    """

    def __init__(
        self, rest_s: float, patience_s: float, rms_mps2: float, max_gap_s: float, implausible_mps2: float
    ) -> None:
        self._rest_s, self._patience_s, self._rms_mps2 = rest_s, patience_s, rms_mps2
        self._max_gap_s, self._implausible_mps2 = max_gap_s, implausible_mps2
        self._room: tuple[Integers, Floats] = np.empty(0, dtype=np.int64), np.empty((0, 3))
        self._stamps_ns, self._samples = self._room
        self._start = 0
        self._first = 0
        self.dropped = 0

    def add(self, stamps_ns: Integers, samples_mps2: Floats) -> None:
        """Collect stamps (n,) ns and samples (n, 3) m/s^2, in order of arrival."""
        held, end = len(self._stamps_ns), len(self._stamps_ns) + len(stamps_ns)
        if end > len(self._room[0]):
            # Twice what is needed: copied sample by sample, ten minutes of patience would cost more than they last.
            self._room = np.empty(2 * end, dtype=np.int64), np.empty((2 * end, 3))
            self._room[0][:held], self._room[1][:held] = self._stamps_ns, self._samples
        self._room[0][held:end], self._room[1][held:end] = stamps_ns, samples_mps2
        self._stamps_ns, self._samples = self._room[0][:end], self._room[1][:end]

    def look(self) -> Rest | None:
        """Return the rest found, None while more must come; InputError where what came cannot be one.

        Either way but the second, what was judged is dropped and counted: the next look begins behind it.
        """
        while True:
            end = self._window_end()
            if end is None:
                return None
            window = self._plausible(self._start, end)
            moving = len(window) < 2 or _rms_about_mean(window) > self._rms_mps2
            waited_s = 1e-9 * int(self._stamps_ns[end] - self._stamps_ns[self._first])
            if not moving or waited_s >= self._patience_s:
                return self._told(self._first if moving else self._start, end, moving)
            self._start = end

    @property
    def collected(self) -> int:
        """Samples that came so far."""
        return self.dropped + len(self._stamps_ns)

    def end(self) -> int:
        """Forget what came after the rest, which the newest samples only can have done: how many did."""
        left = len(self._stamps_ns)
        self._drop(left)
        self._room = self._stamps_ns, self._samples = np.empty(0, dtype=np.int64), np.empty((0, 3))
        return left

    def _window_end(self) -> int | None:
        """End of the window that begins at `_start`, moved behind the first break in it; None while it is not full."""
        while True:
            stamps_ns = self._stamps_ns[self._start :]
            first = stamps_ns[:_STANDING_SAMPLES]
            if first.size == _STANDING_SAMPLES and first.max() == first.min():
                self._drop(self._start + _STANDING_SAMPLES)
                raise InputError(_STANDING)
            past = np.flatnonzero(stamps_ns - stamps_ns[:1] >= round(self._rest_s * 1e9))
            past = past[past >= _LEAST_SAMPLES]
            inside = stamps_ns[: past[0] + 1] if past.size else stamps_ns
            steps_s = np.diff(inside) * 1e-9
            if past.size == 0 and steps_s.size < _TYPICAL_STEPS:
                return None
            longest_s = max(self._max_gap_s, _SLOW_STEPS * float(np.median(steps_s[:_TYPICAL_STEPS])))
            breaks = np.flatnonzero((steps_s > longest_s) | (steps_s < -LEAP_S))
            most = int(_MOST_PER_S * self._rest_s)
            if breaks.size and breaks[0] < most:
                self._drop(self._start + int(breaks[0]) + 1)
            elif inside.size > most:
                self._drop(self._start + most)
                raise InputError(_STANDING)
            else:
                return self._start + int(past[0]) if past.size else None

    def _told(self, begin: int, end: int, in_motion: bool) -> Rest:
        stamps_ns, samples = self._stamps_ns[begin:end], self._samples[begin:end]
        readings = self._plausible(begin, end)
        self._drop(end)
        if len(readings) < 2:
            raise InputError("no finite sample arrived: check the sensor")
        stamps_s = np.asarray(stamps_ns - stamps_ns[0], dtype=np.float64) * 1e-9
        coarse = not _told_apart(stamps_s, samples)
        clock = _clock(stamps_s if coarse else stamps_s[_first_of_each(stamps_s, samples)])
        # What was lost meanwhile passed too, and what came twice passed once.
        self.dropped += round(clock.last_s / clock.period_s) + 1 - len(stamps_s)
        mean, last = readings.mean(axis=0).tolist(), readings[-1].tolist()
        return Rest(
            int(stamps_ns[0]), clock.period_s, clock.last_s, clock.jitter_s, clock.samples, coarse, tuple(mean),
            tuple(last), in_motion,
        )  # fmt: skip

    def _plausible(self, begin: int, end: int) -> Floats:
        # Squares of what no sensor reads may overflow, and one such sample spoils a mean; NaN compares as False.
        part = self._samples[begin:end]
        plausible: Floats = part[(np.abs(part) < self._implausible_mps2).all(axis=1)]
        return plausible

    def _drop(self, end: int) -> None:
        self._room = self._room[0][end:], self._room[1][end:]
        self._stamps_ns, self._samples = self._stamps_ns[end:], self._samples[end:]
        self._start = self._first = 0
        self.dropped += end


def _rms_about_mean(samples: Floats) -> float:
    return float(np.sqrt(((samples - samples.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _told_apart(stamps_s: Floats, samples: Floats) -> bool:
    """Whether a sample with stamp and reading of another is that one again, and not one more of coarse stamps.

    It is if readings repeat within a stamp far more often than from one stamp to the next. Where they repeat anyway,
    all of a stamp must be alike, and as many under each.
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


def _first_of_each(stamps_s: Floats, samples: Floats) -> Integers:
    """Indices of the samples that are no repetition of an earlier one, ascending."""
    rows = np.column_stack([stamps_s, samples])
    return np.sort(np.unique(rows, axis=0, return_index=True)[1])


def _clock(stamps_s: Floats) -> Clock:
    """The clock of stamps (n,) in order of arrival, or of the sorted ones where these are even.

    Jitter does not sort into an even clock, so such samples came out of order.
    """
    clock = fit_clock(stamps_s)
    if (np.diff(stamps_s) >= 0.0).all():
        return clock
    in_order = fit_clock(np.sort(stamps_s))
    return in_order if in_order.jitter_s < _EVEN * in_order.period_s else clock


class Clock(NamedTuple):
    """A sensor's clock by its stamps, seconds: sampling period, fitted time of the last, mean and largest |jitter|."""

    period_s: float
    last_s: float
    jitter_s: float
    worst_s: float
    samples: int


def fit_clock(stamps_s: Floats) -> Clock:
    """Fit an even clock to stamps (n,) in order of arrival; jittered, in bursts, quantised, or with samples lost.

    Samples are counted as lost only in gaps that jitter does not explain; raises InputError below three stamps.
    """
    if stamps_s.size < 3:
        raise InputError("fewer than three different samples: the rate is unknown")
    even = _line(np.arange(stamps_s.size, dtype=np.float64), stamps_s)
    if even.worst_s < _COMPLETE * even.period_s:
        return even
    clock, lost = _by_typical_step(stamps_s) or _by_beat(stamps_s, even.period_s) or _with_losses(stamps_s, even)
    # What stays closer to an even clock than losses would lost nothing: its stamps are quantised, late, or in bursts.
    regular = even.worst_s < _REGULAR * math.sqrt(max(lost, 0.0)) * even.period_s
    return even if regular or even.jitter_s < clock.jitter_s else clock


def _by_typical_step(stamps_s: Floats) -> tuple[Clock, float] | None:
    """The clock of stamps whose steps are whole multiples of the typical one, and how many samples seem lost."""
    gaps_s = np.diff(stamps_s)
    typical_s = float(np.median(gaps_s))
    if typical_s <= 0.0:
        return None
    periods = np.rint(gaps_s / typical_s)
    clean = _line(np.concatenate([[0.0], np.cumsum(periods)]), stamps_s)
    if periods.min() <= 0.0 or clean.jitter_s >= _EVEN * clean.period_s or periods.mean() >= 2.0:
        return None
    return clean, float(periods.sum() - periods.size)


def _by_beat(stamps_s: Floats, longest_period_s: float) -> tuple[Clock, float] | None:
    """The clock whose beat the stamps keep, by their spectrum, and how many samples seem lost.

    Losses do not hide a beat, jitter of a third of a period does. They only make a period look longer, by a quarter for
    one sample in five. None where there is no such beat, or where several samples would share one.
    """
    time_s = stamps_s - stamps_s[0]
    first = time_s[:_BEAT_SAMPLES]
    span_s = float(first.max())
    if longest_period_s <= 0.0 or span_s <= 0.0 or stamps_s.size < _LEAST_SAMPLES:
        return None
    frequency = np.arange(0.98 / longest_period_s, 1.35 / longest_period_s, 0.25 / span_s)
    turn, step = (np.exp(-2j * np.pi * f * first) for f in (frequency[0], 0.25 / span_s))
    beat = np.empty(frequency.size, dtype=np.complex128)
    for k in range(frequency.size):
        beat[k] = turn.mean()
        turn *= step
    best = int(np.argmax(np.abs(beat)))
    if np.abs(beat[best]) < max(_LEAST_BEAT, 6.0 / math.sqrt(first.size)):
        return None
    index = np.rint(frequency[best] * first + np.angle(beat[best]) / (2.0 * np.pi))
    while index.size < time_s.size:
        # The beat of a part counts the beats of one twice as long.
        period_s, begin_s = np.polyfit(index, first, 1)
        first = time_s[: 2 * index.size]
        index = np.rint((first - begin_s) / period_s)
    if (np.diff(index) <= 0.0).mean() > _SHARED_BEATS:
        return None
    return _line(index - index[0], stamps_s), float(index[-1] - index[0] + 1.0 - index.size)


def _with_losses(stamps_s: Floats, clock: Clock) -> tuple[Clock, float]:
    """The clock, and how many samples seem lost; starting from that of a stream which lost none."""
    gaps_s = np.diff(stamps_s)
    typical_s = float(np.median(gaps_s))
    spread_s = 1.4826 * float(np.median(np.abs(gaps_s - typical_s)))
    lost = np.zeros(gaps_s.size)
    for _ in range(2):
        longest_s = max(1.5 * clock.period_s, clock.period_s + 5.0 * spread_s)
        lost = np.where(gaps_s > longest_s, np.maximum(np.rint(gaps_s / clock.period_s) - 1.0, 0.0), 0.0)
        if lost.sum() > 0.5 * stamps_s.size:
            lost[:] = 0.0  # not a stream that loses most of itself, but one that comes in bursts
        clock = _line(np.concatenate([[0.0], np.cumsum(1.0 + lost)]), stamps_s)
    return clock, float(lost.sum())


def _line(index: Floats, stamps_s: Floats) -> Clock:
    slope, offset = (float(v) for v in np.polyfit(index, stamps_s, 1))
    off_s = np.abs(stamps_s - offset - slope * index)
    return Clock(slope, offset + slope * float(index[-1]), float(off_s.mean()), float(off_s.max()), stamps_s.size)
