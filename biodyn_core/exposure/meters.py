"""Meters: aw, MTVV, crest factor, VDV and MSDV, by one class for live and batch.

Every meter takes blocks of any size and reads since reset or over the last `window_s`; cuts never change a number.
A NaN sample is missing. `skip(seconds)` is a break, 0 s where time jumped back: windows move on by it, nothing is
counted, and filters, oscillators and windows restart after it. So missing samples make every figure a lower bound,
except for the false dose of a weighting that restarts from a wrong level (`_Weighting`) or in the middle of a shock,
and of the straight line over a short loss. Samples that these may have raised are `suspect`: their part in the figures
is kept apart.
ISO 2631-1:1997; Zaman et al., Eq. 23-27, in definitions that resolve their contradictions.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.exposure.suspect import LONGEST_SETTLING_S, NEAR_S, SETTLING, STRONG_MPS2
from biodyn_core.exposure.tally import Tally
from biodyn_core.kernels.exposure import NEVER
from biodyn_core.signals.weighting import CURVES, WeightingName, weighting_sections

Figures = TypeVar("Figures")

MTVV_AVERAGING_S: Final = 1.0
"""Length of the linear average and time constant of the exponential one (ISO 2631-1:1997, 6.3.1)."""

LEVEL_SHARE: Final = 0.2
"""A channel's slow level is its mean by a first-order low-pass at this share of the weighting's high-pass frequency.

2 s for Wk and Wd, 10 s for Wf. A shorter time takes vibration for level; a longer one misses braking, bends and a
leaning body. On cars, trams and buses 1 to 3 s leave the least false dose after breaks.
"""

SHORTEST_MSDV_S: Final = 100.0
"""A shorter record has no motion sickness dose: eight periods of Wf's lower band limit.

ISO 2631-1:1997, 5.5 requires a duration of reasonable statistical precision and gives no figure for Wf.
"""


@dataclass(frozen=True)
class Dose:
    """Weighted exposure of one channel: aw and MTVV m/s^2, VDV m/s^1.75, weighted peak m/s^2, seconds counted.

    MTVV is the largest running rms, by the linear average over 1 s (ISO 2631-1:1997, 6.3.1, Eq. 2) and by the
    exponential one (Eq. 3). Both running mean squares start at zero after a break or a reset, so both are lower bounds,
    and neither contains what was before a reset. left_out_s: counted seconds that no figure contains, suspect ones and
    those after the restart of a weighting in strong motion.
    """

    aw_mps2: float
    mtvv_linear_mps2: float
    mtvv_exponential_mps2: float
    vdv_mps175: float
    peak_mps2: float
    seconds: float
    left_out_s: float = 0.0

    @property
    def mtvv_mps2(self) -> float:
        """The larger MTVV: the standard allows both averages, and either may be the larger."""
        return max(self.mtvv_linear_mps2, self.mtvv_exponential_mps2)

    @property
    def has_figures(self) -> bool:
        """Whether it contains a sample."""
        return self.seconds > self.left_out_s

    @property
    def crest_factor(self) -> float | None:
        """Weighted peak over aw, None where aw is zero."""
        if self.aw_mps2 == 0.0:
            return None
        # The peak is of the samples in the figures, and so must the mean be.
        return self.peak_mps2 / self.aw_mps2 * math.sqrt(1.0 - self.left_out_s / self.seconds)


class _Weighting:
    """A weighting's sections, their state for channels, and each channel's slow level.

    A sensor that has tilted since its rest reads a constant, 1.7 m/s^2 at 10 degrees. Sections that start from zero
    take it for a step: a false VDV of 0.73 by Wd. So after a break they start in steady state for the level, the mean
    of the readings within 1 g. A change of level within a break remains a step. At the very start the level is zero,
    as at rest, unless `begin` gives another one.
    """

    def __init__(self, name: WeightingName, rate_hz: float, channels: int) -> None:
        self.sos = weighting_sections(name, rate_hz)
        self.state = np.zeros((len(self.sos), 2, channels))
        self.level = np.zeros(channels)
        self.follow = 1.0 - math.exp(-2.0 * math.pi * LEVEL_SHARE * CURVES[name].f1_hz / rate_hz)

    def begin(self, accel_mps2: Floats) -> None:
        """Start in steady state for the mean of the first readings (n, c), each clipped to 1 g; NaN is missing."""
        clipped = np.clip(accel_mps2, -STANDARD_GRAVITY_MPS2, STANDARD_GRAVITY_MPS2)
        given = np.isfinite(clipped)
        self.level = np.where(given, clipped, 0.0).sum(axis=0) / np.maximum(given.sum(axis=0), 1)
        self.restart()

    def restart(self) -> None:
        """Start after a break, in steady state for the level."""
        for channel, level in enumerate(self.level.tolist()):
            kernels.set_steady_state(self.sos, self.state, channel, level)


class Meter(ABC, Generic[Figures]):
    """Base of all meters: figures of a tally, whose totals since reset can be stored and continued.

    Samples that are suspect are counted in a tally of their own, which exists from the first one on. Figures are
    without them, but their time counts, so that means are lower bounds too. _count: the column of counted samples.
    """

    _tally: Tally
    _suspect: Tally | None = None
    _count: int | None = None

    def since_reset(self) -> Figures:
        """The figures since the last reset, without suspect samples."""
        return self._figures(self._sure(rolling=False), rolling=False)

    def rolling(self) -> Figures:
        """The figures over the last `window_s`, without suspect samples."""
        return self._figures(self._sure(rolling=True), rolling=True)

    def with_suspect(self) -> Figures:
        """The figures since the last reset, with suspect samples."""
        rows = self._tally.since_reset()
        if self._suspect:
            rows = self._tally.joined(rows, self._suspect.since_reset())
        return self._figures(rows, rolling=False)

    def suspect_samples(self, rolling: bool) -> Floats:
        """The number of suspect samples of each channel, (c,)."""
        channels = len(self._tally.total)
        if self._suspect is None or self._count is None:
            return np.zeros(channels)
        return self._suspect.read(rolling)[:, self._count]

    def _sure(self, rolling: bool) -> Floats:
        rows = self._tally.read(rolling)
        if self._count is not None:
            rows[:, self._count] += self.suspect_samples(rolling)
        return rows

    def _counting(self, samples: int, suspect: bool) -> Tally:
        """The tally that counts the next samples; the other one lets them pass."""
        if suspect and self._suspect is None:
            self._suspect = self._tally.at_zero()
        if self._suspect is None:
            return self._tally
        passive, active = (self._tally, self._suspect) if suspect else (self._suspect, self._tally)
        passive.pass_over(samples)
        return active

    def _skip(self, seconds: float) -> int:
        """Let time pass without samples; return their number."""
        if self._suspect:
            self._suspect.skip(seconds)
        return self._tally.skip(seconds)

    def end_window(self, absent_s: float) -> None:
        """Let the rolling window end so long after the last sample, until this is called again."""
        self._tally.end_window(absent_s)
        if self._suspect:
            self._suspect.end_window(absent_s)

    @abstractmethod
    def _figures(self, rows: Floats, rolling: bool) -> Figures:
        """The figures of rows (c, k) of the tally."""

    @abstractmethod
    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""

    def reset(self) -> None:
        """Set everything "since reset" to zero."""
        self._tally.reset()
        if self._suspect:
            self._suspect.reset()

    def forget(self) -> None:
        """Forget all earlier samples, as after a warm-up; only the states of filters continue."""
        self.reset()

    def totals(self) -> Floats:
        """The totals since reset, for `resume` of a meter of another run."""
        return self._tally.totals()

    def resume(self, totals: Floats) -> None:
        """Continue from totals of an earlier run; raises InputError for sums of powers below zero."""
        self._check(totals)
        self._tally.resume(totals)

    def suspect_totals(self) -> Floats:
        """The totals of suspect samples since reset, for `resume_suspect`; zeros without any."""
        return self._suspect.totals() if self._suspect else np.zeros_like(self._tally.total)

    def resume_suspect(self, totals: Floats) -> None:
        """Continue from totals of suspect samples of an earlier run; raises InputError as `resume`."""
        self._check(totals)
        self._suspect = self._suspect or self._tally.at_zero()
        self._suspect.resume(totals)

    def _check(self, totals: Floats) -> None:
        if totals.min(initial=0.0) < 0.0:
            raise InputError("a stored sum of powers is below zero")


class DoseMeter(Meter[tuple[Dose, ...]]):
    """aw, MTVV, VDV and peak, one `Dose` for each of the channels: `push` blocks (n, c) of m/s^2, unweighted.

    groups (c,): the group of each channel, by the number of one of its channels. Where one is suspect, by the rule of
    `SuspectSamples`, the samples of the group are in no figure; their time counts. A weighting that restarts after
    missing samples is like one that follows a loss. Without groups all samples count.
    """

    _count, _left_out = 2, 3

    def __init__(
        self,
        weighting: WeightingName,
        rate_hz: float,
        channels: int,
        window_s: float,
        groups: Integers | None = None,
    ) -> None:
        self._rate_hz = rate_hz
        self._weighting = _Weighting(weighting, rate_hz, channels)
        self._window = MTVV_AVERAGING_S * rate_hz
        self._squares = np.zeros((channels, math.floor(self._window) + 2))
        self._partial = np.zeros(channels)
        self._filled = np.zeros(1, dtype=np.int64)
        self._decay = 1.0 - math.exp(-1.0 / self._window)
        self._running = np.zeros(channels)
        longest = 0 if groups is None else round(LONGEST_SETTLING_S * rate_hz)
        self._rule = np.array([round(NEAR_S * rate_hz), SETTLING, longest])
        self._suspects = np.tile(np.array([NEVER, 0, NEVER, 0, 0, 0]), (channels, 1))
        self._suspects[:, 5] = np.arange(channels) if groups is None else groups
        self._no_loss = np.zeros((1, channels), dtype=np.int64)
        self._was_suspect = False
        self._tally = Tally(rate_hz, channels, 7, 4, window_s)

    def begin(self, accel_mps2: Floats) -> None:
        """Start in motion, before the first block: `accel_mps2` (n, c) are the first readings. See `_Weighting`."""
        self._weighting.begin(accel_mps2)

    def push(self, accel_mps2: Floats, suspect: bool = False, lost: Integers | None = None) -> None:
        """Count a block (n, c); after suspect samples the running averages begin again.

        lost (n, c): of each sample of a line across a loss, the number of samples that were lost.
        """
        w, t = self._weighting, self._counting(len(accel_mps2), suspect)
        if lost is None:
            lost = self._no_loss if len(accel_mps2) == 1 else np.zeros(accel_mps2.shape, dtype=np.int64)
        if self._was_suspect and not suspect:
            self._clear_averages()
        self._was_suspect = suspect
        kernels.dose(
            accel_mps2, w.sos, w.state, w.follow, w.level, self._decay, self._running, self._squares, self._partial,
            self._filled, self._window, lost, STRONG_MPS2, self._rule, self._suspects, t.bin, t.total, t.ring,
            t.position, t.length,
        )  # fmt: skip

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        samples = self._skip(seconds)
        self._suspects[:, :3] = -1, self._rule[2], NEVER
        self._suspects[:, 3] = np.maximum(self._suspects[:, 3] - samples, 0)
        self._filled[0] = (self._filled[0] + samples) % (self._squares.shape[1] - 1)
        self._weighting.restart()
        self._clear_averages()

    def reset(self, averages: bool = True) -> None:
        """Set everything "since reset" to zero, with the running averages; a rolling MTVV begins again too.

        averages: False where samples from before the reset still follow.
        """
        super().reset()
        if averages:
            self._clear_averages()

    def _sure(self, rolling: bool) -> Floats:
        rows = super()._sure(rolling)
        rows[:, self._left_out] += self.suspect_samples(rolling)
        return rows

    def _clear_averages(self) -> None:
        for average in (self._running, self._squares, self._partial):
            average[:] = 0.0

    def _figures(self, rows: Floats, rolling: bool) -> tuple[Dose, ...]:
        return tuple(
            Dose(
                aw_mps2=math.sqrt(square / max(count, 1.0)),
                mtvv_linear_mps2=math.sqrt(linear),
                mtvv_exponential_mps2=math.sqrt(exponential),
                vdv_mps175=(fourth / self._rate_hz) ** 0.25,
                peak_mps2=peak,
                seconds=count / self._rate_hz,
                left_out_s=left_out / self._rate_hz,
            )
            for square, fourth, count, left_out, peak, linear, exponential in rows.tolist()
        )


class HorizontalMeter(Meter[Floats]):
    """Wd-weighted aw and VDV of the horizontal plane in every direction at once, from the moments (9,) of both axes.

    first_axis_rad: direction of the sensor's own first axis, laid level, in the axes that are pushed. Stored totals are
    along the sensor's own axes, because levelling may leave other ones in the next run: those of a sensor that hangs
    upside down turn with the smallest tilt.
    """

    _count = 8

    def __init__(self, rate_hz: float, window_s: float, first_axis_rad: float = 0.0) -> None:
        self._rate_hz, self._first_axis_rad = rate_hz, first_axis_rad
        self._weighting = _Weighting("Wd", rate_hz, 2)
        self._tally = Tally(rate_hz, 1, 9, 9, window_s)

    def begin(self, accel_mps2: Floats) -> None:
        """Start in motion, before the first block: `accel_mps2` (n, 2) are the first readings. See `_Weighting`."""
        self._weighting.begin(accel_mps2)

    def push(self, accel_mps2: Floats, suspect: bool = False) -> None:
        """Count a block (n, 2)."""
        w, t = self._weighting, self._counting(len(accel_mps2), suspect)
        kernels.planar_dose(accel_mps2, w.sos, w.state, w.follow, w.level, t.bin, t.total, t.ring, t.position, t.length)

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        self._skip(seconds)
        self._weighting.restart()

    def totals(self) -> Floats:
        """The totals since reset, along the sensor's own axes."""
        return _rotated(self._tally.totals(), self._first_axis_rad)

    def resume(self, totals: Floats) -> None:
        """Continue from totals of an earlier run."""
        super().resume(_rotated(totals, -self._first_axis_rad))

    def suspect_totals(self) -> Floats:
        """The totals of suspect samples since reset, along the sensor's own axes."""
        return _rotated(super().suspect_totals(), self._first_axis_rad)

    def resume_suspect(self, totals: Floats) -> None:
        """Continue from totals of suspect samples of an earlier run."""
        super().resume_suspect(_rotated(totals, -self._first_axis_rad))

    def _check(self, totals: Floats) -> None:
        """Mixed moments of both axes may be below zero."""

    def _figures(self, rows: Floats, rolling: bool) -> Floats:
        return rows[0]

    def along(self, angles_rad: ArrayLike, rolling: bool = False, suspect: bool = False) -> tuple[Floats, Floats]:
        """Return (aw m/s^2, VDV m/s^1.75) along directions (n,) from the first axis, each (n,).

        suspect: with suspect samples, since reset alone.
        """
        row = self.with_suspect() if suspect else self.rolling() if rolling else self.since_reset()
        angle = np.atleast_1d(np.asarray(angles_rad, dtype=np.float64))
        c, s = np.cos(angle), np.sin(angle)
        second = row[0] * c**2 + 2.0 * row[1] * c * s + row[2] * s**2
        fourth = (
            row[3] * c**4
            + 4.0 * row[4] * c**3 * s
            + 6.0 * row[5] * (c * s) ** 2
            + 4.0 * row[6] * c * s**3
            + row[7] * s**4
        )
        aw = np.sqrt(np.maximum(second, 0.0) / max(row[8], 1.0))
        return aw, (np.maximum(fourth, 0.0) / self._rate_hz) ** 0.25


def _rotated(rows: Floats, angle_rad: float) -> Floats:
    """Moments of a plane (1, 9), as `planar_dose` lays them out, along axes rotated by an angle."""
    along = np.array([math.cos(angle_rad), math.sin(angle_rad)])
    across = np.array([-along[1], along[0]])
    rotated = rows.copy()
    for begin, power in ((0, 2), (3, 4)):
        moments = rows[:, begin : begin + power + 1]
        for k in range(power + 1):
            factors = np.ones(1)  # of x^(power - j) y^j in (along)^(power - k) (across)^k
            for axis in (along,) * (power - k) + (across,) * k:
                factors = np.convolve(factors, axis)
            rotated[:, begin + k] = moments @ factors
    return rotated


def motion_sickness_mps15(weighted: Dose) -> float | None:
    """Motion sickness dose value MSDVz of a vertical weighted by Wf, m/s^1.5; None below SHORTEST_MSDV_S.

    Root of the integral of the squared acceleration (ISO 2631-1:1997, clause 9 and Annex D).
    """
    return weighted.aw_mps2 * math.sqrt(weighted.seconds) if weighted.seconds >= SHORTEST_MSDV_S else None
