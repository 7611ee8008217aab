"""Fit monitor: a sequential test of the residual against the usual one of the subject, by segment.

One-sided CUSUM (Page 1954) on the excess of windows of one second: the logarithm of the mean square of the residual
over the usual one. An excess is clipped, so that a single shock is no alarm. Windows without motion decide nothing: at
rest every model fits. Windows are those of stamps, so that block cuts change nothing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.body.usual_residual import LEAST_SQUARE, UsualResidual, usual_residuals
from biodyn_core.effects import SensorTransform, active
from biodyn_core.pipeline.frames import MeasuredFrames
from biodyn_core.pipeline.windows import LEAST_COVERED, WINDOW_NS, SecondWindows, Window
from biodyn_core.signals.octaves import octave_squares

MOST_ENDED: Final = 1000
"""Times of misfit that are remembered."""


@dataclass(frozen=True)
class MonitorSettings:
    """Settings of the test, of natural logarithms of mean squares; chosen by `make blind` (docs/predictions_study.md).

    allowance: an excess that does not count, because levels and kinds of motion differ by it: 1.6 is 2.2 times the rms.
    threshold: of the sum beyond it. largest_excess: of one window. least_share: a model that misses less of the motion
    is good enough. recent: it fits again if the mean excess of so many windows is below the allowance. moving: a window
    has motion if the predicted rms is so many times the noise.
    """

    allowance: float = 1.6
    threshold: float = 20.0
    largest_excess: float = 3.0
    least_share: float = 0.05
    recent: int = 10
    moving: float = 5.0

    @property
    def least_windows(self) -> int:
        """Windows in motion before the largest misfit could be found: a test of fewer decides nothing."""
        return math.ceil(self.threshold / (self.largest_excess - self.allowance))


@dataclass(frozen=True)
class Misfit:
    """A time in which the model does not fit a segment; end_ns is None while it lasts.

    ratio: rms of the residual over the usual one.
    """

    segment: str
    begin_ns: int
    end_ns: int | None
    ratio: float


@dataclass
class _Segment:
    """The state of the test of one segment."""

    name: str
    law: UsualResidual
    windows: int = 0
    total: float = 0.0
    began_ns: int = 0
    failing: bool = False
    squares: tuple[float, float] = (0.0, 0.0)
    recent: list[float] = field(default_factory=list)


class FitMonitor:
    """`push` measured frames; read `misfits`. laws: the usual residual by segment; others are not tested."""

    def __init__(self, laws: Mapping[str, UsualResidual], settings: MonitorSettings | None = None) -> None:
        self._settings = settings or MonitorSettings()
        self._windows = SecondWindows()
        self._segments = {name: _Segment(name, law) for name, law in laws.items()}
        self._ended: deque[Misfit] = deque(maxlen=MOST_ENDED)

    def push(self, frames: MeasuredFrames, rate_hz: float) -> None:
        """Test the windows that these frames complete; rate_hz: of the seat's clock."""
        if self._segments and frames.stamps_ns.size:
            rows = np.concatenate([frames.residual_mps2, frames.accel_mps2[:, 1:]], axis=1)
            for window in self._windows.push(frames.stamps_ns, rows, rate_hz):
                self.test(window.begin_ns, *squares_of(window))

    def test(self, begin_ns: int, residual_square: Floats, predicted_squares: Floats) -> None:
        """Test one window by the mean squares of its residual (5,) and prediction (6, 5); see `squares_of`."""
        for column, name in enumerate(MEASURED_SEGMENTS):
            if name in self._segments and not math.isnan(residual_square[column]):
                self._test(self._segments[name], begin_ns, residual_square.item(column), predicted_squares[:, column])

    @property
    def tested(self) -> tuple[str, ...]:
        """The segments with enough windows in motion for the test to find a misfit."""
        return tuple(name for name, one in self._segments.items() if one.windows >= self._settings.least_windows)

    @property
    def unknown(self) -> str:
        """Why it is unknown whether the model fits, while no segment is tested; empty if one is."""
        if self.tested:
            return ""
        most = max((one.windows for one in self._segments.values()), default=0)
        compared = f"only {most} s in motion were compared" if most else "no whole second in motion was compared"
        return f"{compared}, {self._settings.least_windows} s are needed"

    def misfits(self) -> list[Misfit]:
        """All times of misfit, by their beginning."""
        return sorted([*self._ended, *self.lasting()], key=lambda one: one.begin_ns)

    def lasting(self) -> list[Misfit]:
        """The misfits of now."""
        return [Misfit(one.name, one.began_ns, None, _ratio(one)) for one in self._segments.values() if one.failing]

    def _test(self, one: _Segment, begin_ns: int, residual: float, predicted: Floats) -> None:
        s, usual = self._settings, one.law.square(predicted, self._settings.least_share)
        if float(predicted.sum()) <= s.moving**2 * one.law.rest_square:
            return
        one.windows += 1
        excess = math.log(max(residual, LEAST_SQUARE) / usual)
        beyond = max(-s.largest_excess, min(s.largest_excess, excess)) - s.allowance
        if one.total == 0.0 and not one.failing:
            one.began_ns, one.squares = begin_ns, (0.0, 0.0)
        one.squares = one.squares[0] + residual, one.squares[1] + usual
        one.total = max(0.0, one.total + beyond)
        one.recent = [*one.recent, beyond][-s.recent :] if one.failing else []
        if not one.failing:
            one.failing = one.total > s.threshold
        elif len(one.recent) == s.recent and sum(one.recent) < 0.0:
            self._ended.append(Misfit(one.name, one.began_ns, begin_ns + WINDOW_NS, _ratio(one)))
            one.failing, one.total = False, 0.0


def sensor_effects(subject: Subject) -> dict[str, str]:
    """The names of the effects of sensors by segment; streams are compared without them, unlike in a fit."""
    found: dict[str, list[str]] = {}
    for applied, effect in active(subject.effects, SensorTransform):
        found.setdefault(applied.site, []).append(effect.name)
    return {segment: ", ".join(names) for segment, names in found.items()}


def monitored_laws(subject: Subject) -> tuple[dict[str, UsualResidual], str]:
    """The usual residuals that hold for streams, by segment, and why there are none, empty if there are.

    That of a segment with an effect of its sensor is the residual of the changed prediction.
    """
    laws, why = usual_residuals(subject.provenance)
    without = sensor_effects(subject)
    left = {name: law for name, law in laws.items() if name not in without}
    if laws and not left:
        why = f"streams are compared without the effects of its sensors ({', '.join(without.values())})"
    return left, why


def squares_of(window: Window) -> tuple[Floats, Floats]:
    """Mean squares of the residual (5,) and, by band, of the prediction (6, 5); NaN where too little was compared.

    The rows of the window are residual and measurement (n, 10).
    """
    residual, measured = np.hsplit(window.rows, 2)
    missing = np.isnan(residual)
    residual, predicted = np.where(missing, 0.0, residual), np.where(missing, 0.0, residual + measured)
    known = 1.0 - missing.mean(axis=0)
    square = octave_squares(residual, window.rate_hz).sum(axis=0)
    scale = np.where(known >= LEAST_COVERED, 1.0 / np.maximum(known, LEAST_COVERED), np.nan)
    return square * scale, octave_squares(predicted, window.rate_hz) * scale


def _ratio(one: _Segment) -> float:
    return math.sqrt(one.squares[0] / one.squares[1])
