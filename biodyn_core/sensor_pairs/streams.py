"""From the raw samples of two sensors with own clocks to synchronous channels on one time grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.sampling_clock import fit_clock, number_samples
from biodyn_core.sensor_pairs.pairs import Clipping, Pair, clipping_of
from biodyn_core.sensor_pairs.settings import StretchSettings

LEAST_RATE_HZ: Final = 50.0
"""Slower sensors are not compared: the procedure was tested from 100 Hz on."""

LARGEST_STEP_BACK_S: Final = 1.0
"""Stamps that are set back by more do not only arrive out of order."""

LARGEST_STEP_S: Final = 24 * 3600.0
"""Stamps that step ahead by more come from a clock that was set."""

PAUSE_S: Final = 0.5
"""A longer step is a pause of the recording, and no sampling period."""

MARGIN_S: Final = 0.25
"""Samples before and after a stretch that are resampled with it."""

CLOCK_SAMPLES: Final = 4096
"""Number of samples that give the rate of a stream."""

FINER: Final = 4
"""Factor of band-limited upsampling before a cubic spline, whose error at 0.36 of the rate is then below 0.1 %."""

LOW_PASS_SHARE: Final = 0.45
"""Cut-off of the anti-aliasing filter, in shares of the rate of comparison."""


@dataclass(frozen=True, eq=False)
class Stream:
    """Raw samples of one sensor by stamps (n,), s: specific force (n, 3) m/s^2 and angular rate (n, 3) rad/s.

    gyro_radps is None for a sensor without gyro.
    """

    stamps_s: Floats
    accel_mps2: Floats
    gyro_radps: Floats | None

    @cached_property
    def rate_hz(self) -> float:
        """The sampling rate, by samples from the middle of the longest stretch without a pause."""
        longest = max(np.split(self.stamps_s, self._ends_of_pauses), key=len)
        longest = longest if longest.size > 2 else self.stamps_s  # slower than the pause, which is refused later
        middle, half = longest.size // 2, CLOCK_SAMPLES // 2
        return 1.0 / fit_clock(longest[max(0, middle - half) : middle + half]).period_s

    @property
    def _ends_of_pauses(self) -> Integers:
        """The first samples (k,) after pauses."""
        return np.flatnonzero(np.diff(self.stamps_s) > PAUSE_S) + 1

    def pauses_beside(self, others: Sequence[Stream]) -> list[tuple[float, float]]:
        """The pauses, begin and end, s, in which another stream goes on: samples are lost, or its clock was set."""
        ends = self._ends_of_pauses
        pauses = zip(self.stamps_s[ends - 1].tolist(), self.stamps_s[ends].tolist(), strict=True)
        return [
            (begin_s, end_s)
            for begin_s, end_s in pauses
            # By their number, because a stream that pauses at the same time may end and begin a little otherwise.
            if any(one.between(begin_s, end_s).stamps_s.size > 0.5 * PAUSE_S * one.rate_hz for one in others)
        ]

    def between(self, begin_s: float, end_s: float) -> Stream:
        """The samples from one instant up to another."""
        part = slice(*np.searchsorted(self.stamps_s, (begin_s, end_s)))
        return Stream(self.stamps_s[part], self.accel_mps2[part], None if (g := self.gyro_radps) is None else g[part])


@dataclass(frozen=True)
class Span:
    """A stretch of a recording, s from its first sample."""

    begin_s: float
    end_s: float


def stream_of(stamps_ns: Integers, accel_mps2: Floats, gyro_radps: Floats | None, epoch_ns: int) -> Stream:
    """A stream of stamps (n,) ns and samples (n, 3), by seconds since an epoch.

    Unset stamps, repeated messages and values that are not finite are removed. A gyro that is not finite or zero
    throughout is none. Raises InputError below three samples, and for stamps that were set back.
    """
    good = (stamps_ns != 0) & np.isfinite(accel_mps2).all(axis=1)
    stamps_s, accel = 1e-9 * (stamps_ns[good] - epoch_ns), accel_mps2[good]
    gyro = None if gyro_radps is None else gyro_radps[good]
    if stamps_s.size and float((np.maximum.accumulate(stamps_s) - stamps_s).max()) > LARGEST_STEP_BACK_S:
        raise InputError("its stamps are set back within the recording")
    ahead_s = float(np.diff(np.maximum.accumulate(stamps_s)).max(initial=0.0))
    if ahead_s > LARGEST_STEP_S:
        raise InputError(f"its stamps step ahead by {ahead_s / 3600.0:.0f} h: a clock was set; use --time log")
    order = np.argsort(stamps_s, kind="stable")
    stamps_s, accel = stamps_s[order], accel[order]
    repeated = np.zeros(stamps_s.size, dtype=np.bool_)
    repeated[1:] = (np.diff(stamps_s) == 0.0) & (accel[1:] == accel[:-1]).all(axis=1)
    if (~repeated).sum() < 3:
        raise InputError("it has fewer than three samples")
    if gyro is not None:
        gyro = gyro[order][~repeated] if np.isfinite(gyro).all() and gyro.any() else None
    return Stream(stamps_s[~repeated], accel[~repeated], gyro)


def common_spans(reference: Stream, under_test: Stream, count: int, length_s: float, s: StretchSettings) -> list[Span]:
    """The stretch with the most motion in each of `count` equal parts of a recording, without gaps in both streams.

    A part without such a stretch gives none.
    """
    begin_s = max(reference.stamps_s[0], under_test.stamps_s[0])
    end_s = min(reference.stamps_s[-1], under_test.stamps_s[-1])
    found = []
    # A part is at least as long as a stretch.
    parts = np.linspace(begin_s, end_s, max(1, min(count, int((end_s - begin_s) / length_s))) + 1)
    for part_s, until_s in pairwise(parts):
        begins_s = np.arange(part_s, until_s - length_s + 1e-6, 0.25 * length_s)
        spans = [Span(float(at_s), float(at_s) + length_s) for at_s in begins_s]
        whole = [
            span
            for span in spans
            if all(_is_whole(one, span, s.longest_gap_s + 1.5 / one.rate_hz) for one in (reference, under_test))
        ]
        if whole:
            found.append(max(whole, key=lambda span: _motion(reference, span)))
    return found


def _is_whole(stream: Stream, span: Span, longest_s: float) -> bool:
    """Whether no step between samples is longer."""
    stamps_s = stream.between(span.begin_s, span.end_s).stamps_s
    edges_s = np.concatenate([[span.begin_s], stamps_s, [span.end_s]])
    return float(np.diff(edges_s).max()) <= longest_s


def _motion(stream: Stream, span: Span) -> float:
    """Variance of the acceleration."""
    return float(stream.between(span.begin_s, span.end_s).accel_mps2.var(axis=0).sum())


def pair_of(reference: Stream, under_test: Stream, span: Span, axis: int, rate_hz: float, gyro: bool) -> Pair:
    """The channels of a stretch at one rate; axis: of the sensor under test; gyro: whether the reference's is an input.

    Each stream has an even clock, fitted to its own stamps within the stretch.
    """
    grid_s = span.begin_s + np.arange(int((span.end_s - span.begin_s) * rate_hz)) / rate_hz
    inputs, times_s = _even(reference, span, gyro)
    tested, own_s = _even(under_test, span, gyro=False)
    own = _resampled(tested, own_s, grid_s, rate_hz)
    inside = (own_s >= grid_s[0]) & (own_s <= grid_s[-1])
    clipping = _on_grid(clipping_of(tested[inside, axis]), own_s[inside], grid_s, rate_hz)
    others = [(axis + 1) % 3, (axis + 2) % 3]
    return Pair(rate_hz, _resampled(inputs, times_s, grid_s, rate_hz), own[:, axis], own[:, others], clipping)


def _even(stream: Stream, span: Span, gyro: bool) -> tuple[Floats, Floats]:
    """Samples (n, k) on the stream's own even clock, lost ones interpolated, and their times (n,) s."""
    part = stream.between(span.begin_s - MARGIN_S, span.end_s + MARGIN_S)
    values = part.accel_mps2
    if gyro and part.gyro_radps is not None:
        values = np.column_stack([values, part.gyro_radps])
    clock, index = number_samples(part.stamps_s)
    every = np.arange(int(index[-1]) + 1)
    filled = np.column_stack([np.interp(every, index, column) for column in values.T])
    return filled, clock.last_s - clock.period_s * (every[-1] - every)


def _resampled(values: Floats, times_s: Floats, grid_s: Floats, rate_hz: float) -> Floats:
    """Values (n, k) at even times (n,) on a grid (m,), low-passed below a lower rate."""
    own_hz = (times_s.size - 1) / (times_s[-1] - times_s[0])
    if own_hz > 1.05 * rate_hz:
        sos = scipy.signal.butter(8, LOW_PASS_SHARE * rate_hz, fs=own_hz, output="sos")
        values = np.asarray(scipy.signal.sosfiltfilt(sos, values, axis=0))
    finer = scipy.signal.resample_poly(values, FINER, 1, axis=0, padtype="line")
    fine_s = times_s[0] + np.arange(len(finer)) / (FINER * own_hz)
    return np.asarray(scipy.interpolate.CubicSpline(fine_s, finer)(np.clip(grid_s, times_s[0], times_s[-1])))


def _on_grid(clipping: Clipping, times_s: Floats, grid_s: Floats, rate_hz: float) -> Clipping:
    """Clipping of raw samples as a mask of the grid: both neighbours of each clipped sample."""
    flags: Flags = np.zeros(grid_s.size, dtype=np.bool_)
    at = np.floor((times_s[clipping.flags] - grid_s[0]) * rate_hz).astype(np.int64)
    for neighbour in (at, at + 1):
        flags[np.clip(neighbour, 0, grid_s.size - 1)] = True
    return Clipping(flags, clipping.count, clipping.limit_mps2)
