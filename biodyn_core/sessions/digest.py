"""Digests: sums of a session's sensors over short intervals, from which events are found after the last sample.

A sensor has intervals of 0.5 s, and of 20 ms for its vertical acceleration. The seat has more of the latter: the peak
and the squares, whole, above the frequency of an engine that idles, and weighted by Wk (ISO 2631-1).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioned import Block, SensorStatus
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.gravity import LEAST_OTHERS, SAME_REST_MPS2
from biodyn_core.conditioning.tilt import Vector, rotation_to_vertical
from biodyn_core.recording.flags import around
from biodyn_core.sessions.bins import Bins, Recut
from biodyn_core.sessions.settings import SessionSettings
from biodyn_core.signals.waterfall import Waterfall, WaterfallMeter
from biodyn_core.signals.weighting import weighting_sections

COARSE_S: Final = 0.5
FINE_S: Final = 0.02
"""Half the time in which a wheel crosses a joint, and a fifth of the error that an event's time may have."""

SET_BACK_S: Final = 0.5
"""A run that begins so long before the end of the last one comes from a clock that was set back."""

LEVELLED: Final = slice(0, 3)
SQUARE: Final = 3
CHANGES: Final = 4
"""Columns of a sensor's sums: levelled acceleration x, y, z, the square of its length, and samples unlike the last."""

LOW_PASSED, HIGH, WEIGHTED = 0, 1, 2
"""Columns of the seat's sums of squares."""


class SensorDigest:
    """One sensor: `push` conditioned blocks and `finish`; `coarse` and `mean` hold its sums.

    mean: of the low-passed vertical acceleration over 20 ms, for the comparison of clocks. is_earlier: whether all its
    samples are before the seat's.
    """

    def __init__(self, conditioner: Conditioner, epoch_ns: int, settings: SessionSettings) -> None:
        self.conditioner, self._epoch_ns, self._settings = conditioner, epoch_ns, settings
        self.coarse = Bins(COARSE_S, sums=5)
        self.clipped = Bins(COARSE_S, sums=0)
        self.mean = Bins(FINE_S, sums=1, short=True)
        self._recut = Recut()
        self._last_s = -np.inf
        self.is_earlier = False

    def push(self, blocks: list[Block]) -> None:
        """Add conditioned blocks; raises InputError for a time that was set back, or far beyond a session."""
        for block in blocks:
            time_s = self._seconds(block.stamps_ns)
            self._check(block, time_s)
            if block.begins_run:
                self._end_run()
            self._last_s = float(time_s[-1])
            after = time_s >= 0.0  # a sensor may begin before the seat
            self.is_earlier = not after.any() and not self.coarse.counts.any()
            rows = np.column_stack([time_s, block.levelled_mps2, block.low_passed_mps2])[after]
            for piece in self._recut.push(rows):
                self._add(piece, block.rate_hz)

    def add_clipped(self, stamps_ns: Integers) -> None:
        """Add the stamps (n,) of samples at the limit of the sensor's range."""
        time_s = self._seconds(stamps_ns)
        inside = (time_s >= 0.0) & (time_s < 3600.0 * self._settings.longest_h)
        self.clipped.add(time_s[inside], np.empty((int(inside.sum()), 0)))

    def finish(self) -> None:
        """Add the samples that are left."""
        self._end_run()

    def status(self) -> SensorStatus:
        """The status of the sensor's conditioning."""
        return self.conditioner.status()

    @property
    def repeats(self) -> Flags:
        """The intervals (b,) in which it repeats one reading."""
        return repeats_in(self.coarse)

    def rms(self, intervals: int) -> Floats:
        """The rms over all axes about the mean of each of so many intervals; NaN without samples and changes."""
        counts, sums = self.coarse.counts[:intervals], self.coarse.sums[:intervals]
        found = np.full(intervals, np.nan)
        there = np.flatnonzero((counts > 0.0) & ~self.repeats[:intervals])
        mean = sums[there, LEVELLED] / counts[there, None]
        found[there] = np.sqrt(np.maximum(sums[there, SQUARE] / counts[there] - (mean**2).sum(axis=1), 0.0))
        return found

    def stuck(self, begin_s: float, end_s: float) -> Flags:
        """The intervals (k,) of a rest that a stuck sensor spoils: it repeats a reading that differs from its others.

        None where it reads others in less than `LEAST_OTHERS` of the rest.
        """
        here = self.coarse.extent(begin_s, end_s)
        counts, repeats = self.coarse.counts[here], repeats_in(self.coarse, here)
        others, apart = ~repeats & (counts > 0.0), np.zeros_like(repeats)
        if others.any() and others.mean() >= LEAST_OTHERS:
            mean = self.coarse.sums[here, LEVELLED][others].sum(axis=0) / counts[others].sum()
            each = self.coarse.sums[here, LEVELLED] / np.maximum(counts, 1.0)[:, None]
            apart = repeats & (np.linalg.norm(each - mean, axis=1) > SAME_REST_MPS2)
        return around(apart, 1, 1)  # the intervals at its ends have both readings

    def mean_reading(self, begin_s: float, end_s: float) -> Vector | None:
        """The mean reading, gravity and bias, in the sensor's axes, where it is not stuck; None without samples."""
        here = self._usable(begin_s, end_s)
        count = float(self.coarse.counts[here].sum())
        rest, vertical = self.conditioner.rest, self.conditioner.status().vertical
        if count == 0.0 or rest is None or vertical is None:
            return None
        levelled = self.coarse.sums[here, LEVELLED].sum(axis=0) / count
        x, y, z = (levelled @ rotation_to_vertical(np.array(vertical)) + rest.mean_mps2).tolist()
        return x, y, z

    def rms_about_mean(self, begin_s: float, end_s: float) -> float:
        """The rms over all axes about the mean, where it is not stuck; 0 without samples."""
        here = self._usable(begin_s, end_s)
        count = max(float(self.coarse.counts[here].sum()), 1e-300)
        mean = self.coarse.sums[here, LEVELLED].sum(axis=0) / count
        return float(np.sqrt(max(0.0, self.coarse.sums[here, SQUARE].sum() / count - mean @ mean)))

    def _usable(self, begin_s: float, end_s: float) -> Integers:
        here = self.coarse.extent(begin_s, end_s)
        return np.arange(here.start, here.stop)[~self.stuck(begin_s, end_s)]

    def _seconds(self, stamps_ns: Integers) -> Floats:
        return np.asarray(1e-9 * (stamps_ns - self._epoch_ns), dtype=np.float64)

    def _check(self, block: Block, time_s: Floats) -> None:
        back_s = self._last_s - float(time_s[0])
        if back_s > SET_BACK_S:
            raise InputError(
                f"{self.conditioner.sensor}: time is set back by {back_s:.1f} s after {self._last_s:.1f} s: give the"
                " parts before and after it as two bags"
            )
        if time_s[-1] > 3600.0 * self._settings.longest_h:
            raise InputError(
                f"{self.conditioner.sensor}: its stamps reach {time_s[-1] / 3600.0:.0f} h after the seat's first one,"
                f" a session has {self._settings.longest_h:g} h at most (longest_h): if its clock is another one or was"
                " set, use --time log"
            )

    def _end_run(self) -> None:
        for piece in self._recut.rest():
            self._add(piece, self.conditioner.rate_hz)

    def _add(self, rows: Floats, rate_hz: float) -> None:
        """Add rows (n, 5): time, levelled x, y, z, low-passed vertical."""
        levelled = rows[:, 1:4]
        changes = np.diff(levelled, axis=0, prepend=levelled[:1]).any(axis=1)
        self.coarse.add(rows[:, 0], np.column_stack([levelled, (levelled**2).sum(axis=1), changes]))
        self.mean.add(rows[:, 0], rows[:, 4:])


def repeats_in(coarse: Bins, here: slice = slice(None)) -> Flags:
    """The intervals (b,) of a sensor's sums, or some of them, in which it repeats one reading."""
    return np.asarray((coarse.counts[here] > 1.0) & (coarse.sums[here, CHANGES] == 0.0))


class SeatDigest(SensorDigest):
    """The seat; `fine` holds the sums of its vertical acceleration."""

    def __init__(self, conditioner: Conditioner, epoch_ns: int, settings: SessionSettings) -> None:
        super().__init__(conditioner, epoch_ns, settings)
        self.fine = Bins(FINE_S, sums=3, maxima=1, short=True)
        self._filters: list[_Filter] | None = None
        self._waterfall: WaterfallMeter | None = None

    def waterfall(self) -> Waterfall | None:
        """Power over time and frequency, by time since the first sample; None without samples."""
        return self._waterfall.waterfall() if self._waterfall is not None and self._waterfall.stored else None

    def _end_run(self) -> None:
        super()._end_run()
        self._filters = None
        if self._waterfall is not None:
            self._waterfall.part()

    def _add(self, rows: Floats, rate_hz: float) -> None:
        super()._add(rows, rate_hz)
        if self._filters is None:
            high = scipy.signal.butter(4, self._settings.idle_above_hz, "highpass", fs=rate_hz, output="sos")
            self._filters = [_Filter(high), _Filter(weighting_sections("Wk", rate_hz))]
        low_passed, (high_passed, weighted) = rows[:, 4], self._filters
        squares = np.column_stack([low_passed, high_passed(low_passed), weighted(rows[:, 3])]) ** 2
        self.fine.add(rows[:, 0], squares, np.abs(low_passed)[:, None])
        if self._waterfall is None:
            self._waterfall = WaterfallMeter(rate_hz, channels=1)
        self._waterfall.push(np.rint(1e9 * rows[:, 0]).astype(np.int64), low_passed[:, None])


class _Filter:
    """Second-order sections (s, 6) with their state."""

    def __init__(self, sections: Floats) -> None:
        self._sections, self._state = sections, np.zeros((len(sections), 2))

    def __call__(self, values: Floats) -> Floats:
        filtered, self._state = scipy.signal.sosfilt(self._sections, values, zi=self._state)
        return np.asarray(filtered)
