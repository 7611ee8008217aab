"""Spread of predicted figures: standard deviations of their logarithms, from windows of one second.

Two causes add up in squares. The model misses a share of the motion in each octave band, as in the events that it was
not fitted to (`UsualResidual`). Its parameters are known within their covariance: neighbouring chains, one standard
deviation off along independent steps, give other figures, the more so the further a motion goes beyond the fitted ones.
Where the covariance is wide, figures bend along a step: then there is a chain on both sides of each step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.exposure.meters import Meter
from biodyn_core.exposure.tally import Tally

LEAST: Final = 1e-12
"""A mean square so small beside another one is zero but for rounding."""


@dataclass(frozen=True)
class SpreadFactors:
    """Standard deviation of the logarithm of a mean or VDV, and of a peak, over the expected share of the error."""

    doses: float
    peaks: float


ACCEL_FACTORS: Final = SpreadFactors(0.34, 0.44)
FORCE_FACTORS: Final = SpreadFactors(0.20, 0.30)
"""Of accelerations and of joint forces, calibrated on simulated people whose backgrounds differ from the model.

See docs/predictions_study.md. They are below one, because much of a residual is out of phase with the motion, and some
of it is the sensors'. That of the rms of forces is smaller: errors above a joint have not all one sign.
"""


@dataclass(frozen=True)
class FigureSpread:
    """Standard deviations of the logarithms of one channel's mean (aw, rms), VDV and peaks."""

    of_means: float
    of_vdv: float
    of_peaks: float


@dataclass(frozen=True)
class PeakSpread:
    """Standard deviations of the logarithms of one channel's largest positive and negative value; None without one."""

    of_positive: float | None
    of_negative: float | None


def interval(value: float, spread: float) -> tuple[float, float]:
    """The 95 % interval of a figure of positive sign with this standard deviation of its logarithm."""
    factor = math.exp(NORMAL_95 * spread)
    return value / factor, value * factor


class SpreadMeter(Meter[tuple[FigureSpread | None, ...]]):
    """`push` windows of one second; read the spreads by channel. factors: of each channel; both_sides: see `spread`.

    A window has mean squares of each channel (c,) as predicted, their expected error by the model (c,), and the mean
    squares of the neighbouring chains (c, k). VDV and peaks weight each window by the square of its mean square.
    """

    def __init__(
        self, factors: Sequence[SpreadFactors], neighbours: int, window_s: float, both_sides: bool = False
    ) -> None:
        self._factors, self._both_sides = factors, both_sides
        self._tally = Tally(1.0, len(factors), 2 * (2 + neighbours), 2 * (2 + neighbours), window_s)

    def push(self, square: Floats, error: Floats, neighbours: Floats) -> None:
        """Count one window."""
        means = np.column_stack([square, error, neighbours])
        self._tally.bin += np.column_stack([means, square**2, square * error, neighbours**2])
        self._tally.skip(1.0)

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        self._tally.skip(seconds)

    def _figures(self, rows: Floats, rolling: bool) -> tuple[FigureSpread | None, ...]:
        return tuple(
            self._figure_spread(row, factors) if row[0] > 0.0 else None
            for row, factors in zip(rows, self._factors, strict=True)
        )

    def _figure_spread(self, row: Floats, factors: SpreadFactors) -> FigureSpread:
        means, fourths = np.split(row, 2)
        return FigureSpread(
            spread(means, factors.doses, 0.5, self._both_sides),
            spread(fourths, factors.doses, 0.25, self._both_sides),
            spread(fourths, factors.peaks, 0.25, self._both_sides),
        )


class PeakSpreadMeter(Meter[tuple[PeakSpread, ...]]):
    """`push` the values of windows of one second; read the spreads of their peaks by channel, by the chains alone.

    The peaks of each chain are its own: a peak of few strong samples does not follow the mean of the fourth powers.
    chains: the predicted one and its neighbours, on both sides.
    """

    def __init__(self, channels: int, chains: int, window_s: float) -> None:
        self._tally = Tally(1.0, channels, 2 * chains, 0, window_s)

    def push(self, values: Floats) -> None:
        """Count one window (n, 1 + 2 k, c): as predicted, and by the neighbouring chains."""
        peaks = np.concatenate([values.max(axis=0), -values.min(axis=0)]).T
        np.maximum(self._tally.bin, peaks, out=self._tally.bin)
        self._tally.skip(1.0)

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        self._tally.skip(seconds)

    def _figures(self, rows: Floats, rolling: bool) -> tuple[PeakSpread, ...]:
        return tuple(PeakSpread(*map(_peak_spread, np.split(row, 2))) for row in rows)


def _peak_spread(peaks: Floats) -> float | None:
    """Standard deviation of the logarithm of the first of the peaks (1 + 2 k,); None if it is zero."""
    if peaks[0] <= 0.0:
        return None
    changes = np.log(np.maximum(peaks[1:], LEAST * peaks[0]) / peaks[0])
    return math.sqrt(mean_square_change(changes, both_sides=True))


def spread(sums: Floats, factor: float, root: float, both_sides: bool = False) -> float:
    """Standard deviation of the logarithm of the root of a sum of squares or fourth powers.

    sums (2 + k,): of the figure, of its expected error, and of the figure by the neighbouring chains; factor: of the
    error; root: 1/2 or 1/4; both_sides: the second half of the neighbours is opposite the first.
    """
    square, error, *neighbours = sums.tolist()
    changes = root * np.log(np.maximum(neighbours, LEAST * square) / square)
    return math.sqrt(factor**2 * error / square + mean_square_change(changes, both_sides))


def mean_square_change(changes: Floats, both_sides: bool) -> float:
    """Mean square change of a quantity by normal steps, from its changes (k,) by one standard deviation of each.

    With both sides, (2 k,), it has the second order along each step, and allows for the change of the mean (JCGM
    100:2008, note to 5.1.2).
    """
    if not both_sides:
        return float(np.sum(changes**2))
    ahead, back = np.split(changes, 2)
    slope, curvature = 0.5 * (ahead - back), ahead + back
    return float(np.sum(slope**2) + 0.5 * np.sum(curvature**2) + (0.5 * np.sum(curvature)) ** 2)
