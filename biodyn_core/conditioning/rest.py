"""Rest: the first seconds of a sensor without motion, and its mean reading there, gravity and bias together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.sampling_clock import clock_of, first_of_each

_CONSTANT_SAMPLES: Final = 1_000
"""So many samples with one stamp mean that stamps do not advance."""

_MIN_SAMPLES: Final = 10
"""A rest has at least so many samples, however slow the sensor."""

_MAX_PER_S: Final = 50_000.0
"""No sensor sends more samples in a second: with more the stamps do not advance."""

_MAX_STEPS: Final = 5.0
"""A step of the stamps up to so many typical ones, ahead or back, is no break, so that a slow sensor has none."""

_TYPICAL_STEPS: Final = 100
"""The typical step is the median of so many at the start of a window, a fixed number, so that cuts change nothing."""

_CONSTANT: Final = "stamps stand still: use log time (--time log), or correct the driver's stamps"


@dataclass(frozen=True)
class Rest:
    """A sensor at rest: its clock by its stamps, its mean reading, and the last reading, all (3,) m/s^2.

    last_time_s: since epoch_ns, fitted. jitter_s: mean absolute. samples: number in the fit of the clock. coarse:
    several samples share a stamp. in_motion: without a rest, the mean over motion.
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
    """Collect the first seconds of a sensor until one window of them is at rest, or patience ends.

    No window contains a gap or a jump of the stamps: waiting restarts after it. Readings from `implausible_mps2` on
    count for the clock alone. clock_only: gravity is known, and all windows together give the clock, at rest or not,
    until a gap, the end of the record, or of patience.

    dropped: samples that are no longer collected. before: samples before the averaged ones. repeated: dropped samples
    with stamp and reading of an earlier one; with clock_only without those of the clock, which are conditioned later.
    moving_rms_mps2: of the last window, if it moved; None before. rms_mps2: of the last window.
    """

    def __init__(
        self,
        rest_s: float,
        patience_s: float,
        rms_mps2: float,
        max_gap_s: float,
        implausible_mps2: float,
        clock_only: bool = False,
    ) -> None:
        self._clock_only = clock_only
        self._rest_s, self._patience_s, self._rms_mps2 = rest_s, patience_s, rms_mps2
        self._max_gap_s, self._implausible_mps2 = max_gap_s, implausible_mps2
        self._buffer: tuple[Integers, Floats] = np.empty(0, dtype=np.int64), np.empty((0, 3))
        self._stamps_ns, self._samples = self._buffer
        self._start = 0
        self._first = 0
        self.dropped = 0
        self.moving_rms_mps2: float | None = None
        self.rms_mps2 = math.inf
        self._broken = False
        self.before = self.repeated = 0

    def add(self, stamps_ns: Integers, samples_mps2: Floats) -> None:
        """Collect stamps (n,) ns and samples (n, 3) m/s^2, in order of arrival."""
        held, end = len(self._stamps_ns), len(self._stamps_ns) + len(stamps_ns)
        if end > len(self._buffer[0]):
            # Twice the size needed: copied sample by sample, ten minutes of patience would take longer than they last.
            self._buffer = np.empty(2 * end, dtype=np.int64), np.empty((2 * end, 3))
            self._buffer[0][:held], self._buffer[1][:held] = self._stamps_ns, self._samples
        self._buffer[0][held:end], self._buffer[1][held:end] = stamps_ns, samples_mps2
        self._stamps_ns, self._samples = self._buffer[0][:end], self._buffer[1][:end]

    def find(self) -> Rest | None:
        """The rest found, None while it needs more samples; raises InputError for samples that cannot contain one.

        A result or an error drops the samples it is about: the next search begins after them.
        """
        while True:
            end = self._window_end()
            if end is None:
                return None
            window = self._plausible(self._start, end)
            rms_mps2 = _rms_about_mean(window) if len(window) > 1 else math.inf
            moving = self._clock_only or rms_mps2 > self._rms_mps2
            self.moving_rms_mps2 = rms_mps2 if moving and len(window) > 1 else None
            self.rms_mps2 = rms_mps2
            waited_s = 1e-9 * int(self._stamps_ns[end] - self._stamps_ns[self._first])
            if not moving or waited_s >= self._patience_s or self._broken:
                return self._drop_as_rest(self._first if moving else self._start, end, moving)
            self._start = end

    def conclude(self) -> Rest | None:
        """End the record: the clock of all windows so far, None without any."""
        return (
            self._drop_as_rest(self._first, len(self._stamps_ns), in_motion=True) if self._start > self._first else None
        )

    @property
    def waited_s(self) -> float:
        """Seconds of stamps since the first sample that is still collected."""
        stamps_ns = self._stamps_ns[self._first :]
        return 1e-9 * int(stamps_ns[-1] - stamps_ns[0]) if len(stamps_ns) else 0.0

    @property
    def collected(self) -> int:
        """Number of samples so far."""
        return self.dropped + len(self._stamps_ns)

    def clear(self) -> int:
        """Drop the samples after the rest, which are the newest ones; return their number."""
        left = len(self._stamps_ns)
        self._drop(left)
        self._buffer = self._stamps_ns, self._samples = np.empty(0, dtype=np.int64), np.empty((0, 3))
        return left

    def _window_end(self) -> int | None:
        """End of the window that begins at `_start`, moved after the first break in it; None while it is not full."""
        while True:
            stamps_ns = self._stamps_ns[self._start :]
            first = stamps_ns[:_CONSTANT_SAMPLES]
            if first.size == _CONSTANT_SAMPLES and first.max() == first.min():
                self._drop_unused(self._start + _CONSTANT_SAMPLES)
                raise InputError(_CONSTANT)
            past = np.flatnonzero(stamps_ns - stamps_ns[:1] >= round(self._rest_s * 1e9))
            past = past[past >= _MIN_SAMPLES]
            inside = stamps_ns[: past[0] + 1] if past.size else stamps_ns
            steps_s = np.diff(inside) * 1e-9
            if past.size == 0 and steps_s.size < _TYPICAL_STEPS:
                return None
            longest_s = max(self._max_gap_s, _MAX_STEPS * float(np.median(steps_s[:_TYPICAL_STEPS])))
            # A clock that is set back within a window falsifies the rate like a gap, unless by a few samples.
            breaks = np.flatnonzero(np.abs(steps_s) > longest_s)
            most = int(_MAX_PER_S * self._rest_s)
            if breaks.size and breaks[0] < most:
                after_break = self._start + int(breaks[0]) + 1
                self._broken = self._clock_only and self._start > self._first
                if self._broken:
                    return after_break
                self._drop_unused(after_break)
            elif inside.size > most:
                self._drop_unused(self._start + most)
                raise InputError(_CONSTANT)
            else:
                return self._start + int(past[0]) if past.size else None

    def _drop_as_rest(self, begin: int, end: int, in_motion: bool) -> Rest:
        stamps_ns, samples = self._stamps_ns[begin:end], self._samples[begin:end]
        readings = self._plausible(begin, end)
        self.before = self.dropped + begin
        if self._clock_only:
            self._drop(end)
        else:
            self._drop_unused(end)
        if len(readings) < 2:
            raise InputError("no finite sample arrived: check the sensor")
        stamps_s = np.asarray(stamps_ns - stamps_ns[0], dtype=np.float64) * 1e-9
        clock, coarse = clock_of(stamps_s, samples)
        # In sampling periods: lost samples count, repeated ones count once.
        self.dropped += round(clock.last_s / clock.period_s) + 1 - len(stamps_s)
        mean, last = readings.mean(axis=0).tolist(), readings[-1].tolist()
        return Rest(
            int(stamps_ns[0]), clock.period_s, clock.last_s, clock.jitter_s, clock.samples, coarse, tuple(mean),
            tuple(last), in_motion,
        )  # fmt: skip

    def _plausible(self, begin: int, end: int) -> Floats:
        # One implausible sample makes a mean useless, and its square may overflow; NaN compares as False.
        part = self._samples[begin:end]
        plausible: Floats = part[is_plausible(part, self._implausible_mps2)]
        return plausible

    def _drop_unused(self, end: int) -> None:
        """Drop samples that are not conditioned later, and count the repeated ones."""
        stamps_ns, samples = self._stamps_ns[:end], self._samples[:end]
        if np.unique(stamps_ns).size < len(stamps_ns):
            read = is_plausible(samples, self._implausible_mps2)
            # As a difference, because a float does not hold a stamp to the nanosecond.
            since_ns = (stamps_ns[read] - stamps_ns[0]).astype(np.float64)
            self.repeated += int(read.sum()) - first_of_each(since_ns, samples[read]).size
        self._drop(end)

    def _drop(self, end: int) -> None:
        self._buffer = self._buffer[0][end:], self._buffer[1][end:]
        self._stamps_ns, self._samples = self._stamps_ns[end:], self._samples[end:]
        self._start = self._first = 0
        self.dropped += end


def is_plausible(samples_mps2: Floats, implausible_mps2: float) -> Flags:
    """Whether all axes of each sample (n, 3) are finite and below the limit, (n,)."""
    return np.asarray((np.abs(samples_mps2) < implausible_mps2).all(axis=1))


def _rms_about_mean(samples: Floats) -> float:
    return float(np.sqrt(((samples - samples.mean(axis=0)) ** 2).sum(axis=1).mean()))
