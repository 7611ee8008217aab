"""Fit monitor: a sequential test of the residual against the usual one of the subject, by segment.

One-sided CUSUM (Page 1954) on the score of windows of one second. A score is clipped, so that a single shock is no
alarm. Windows are those of stamps, so that block cuts change nothing.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.pipeline.frames import MeasuredFrames

WINDOW_NS: Final = 1_000_000_000
LEAST_COVERED: Final = 0.9
"""A window counts with at least this share of its samples compared."""

ALLOWANCE: Final = 1.0
"""Standard deviations that do not count: roads, levels and persons on another day differ by less."""

THRESHOLD: Final = 10.0
LARGEST_SCORE: Final = 4.0
RECENT: Final = 10
"""It fits again if the mean score of so many windows with motion is below the allowance."""

MOVING: Final = 5.0
"""A window has motion with a predicted rms of so many times the noise: at rest everything fits."""


MOST_ENDED: Final = 1000
"""Times of misfit that are remembered."""


class Window(NamedTuple):
    """Mean squares of residual and prediction over one second, (5,) each by measured segment, NaN where too few."""

    begin_ns: int
    residual_square: Floats
    predicted_square: Floats


@dataclass(frozen=True)
class Misfit:
    """A time in which the model does not fit a segment; end_ns is None while it lasts.

    ratio: rms of the residual over the usual one.
    """

    segment: str
    begin_ns: int
    end_ns: int | None
    ratio: float


class ResidualWindows:
    """Collect frames into windows: `push` frames, get the windows that they complete."""

    def __init__(self) -> None:
        self._parts: list[MeasuredFrames] = []
        self._number: int | None = None

    def push(self, frames: MeasuredFrames) -> Iterator[Window]:
        """Add frames; yield each window that later frames have completed."""
        numbers = frames.stamps_ns // WINDOW_NS
        begin = 0
        for end in [*(np.flatnonzero(np.diff(numbers)) + 1).tolist(), numbers.size]:
            if end > begin:
                if self._number is not None and int(numbers[begin]) != self._number:
                    yield from self._complete()
                self._number = int(numbers[begin])
                part = slice(begin, end)
                self._parts.append(
                    MeasuredFrames(frames.stamps_ns[part], frames.accel_mps2[part], frames.residual_mps2[part])
                )
                begin = end

    def _complete(self) -> Iterator[Window]:
        """The window, unless a gap has left too little of it."""
        assert self._number is not None
        stamps_ns, accel, residual = (np.concatenate(column) for column in zip(*self._parts, strict=True))
        self._parts = []
        period_ns = float(np.median(np.diff(stamps_ns))) if stamps_ns.size > 1 else 0.0
        if stamps_ns.size * period_ns < LEAST_COVERED * WINDOW_NS:
            return
        known = ~np.isnan(residual)
        enough, count = known.mean(axis=0) >= LEAST_COVERED, np.maximum(known.sum(axis=0), 1)
        squares = [
            np.where(enough, (np.where(known, values, 0.0) ** 2).sum(axis=0) / count, np.nan)
            for values in (residual, residual + accel[:, 1:])
        ]
        yield Window(self._number * WINDOW_NS, squares[0], squares[1])


@dataclass
class _Segment:
    """The state of the test of one segment."""

    law: UsualResidual
    total: float = 0.0
    began_ns: int = 0
    failing: bool = False
    squares: tuple[float, float] = (0.0, 0.0)
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))


class FitMonitor:
    """`push` measured frames; read `misfits`. laws: the usual residual by segment; others are not tested."""

    def __init__(self, laws: Mapping[str, UsualResidual]) -> None:
        self._windows = ResidualWindows()
        self._segments = {name: _Segment(law) for name, law in laws.items()}
        self._ended: deque[Misfit] = deque(maxlen=MOST_ENDED)

    def push(self, frames: MeasuredFrames) -> None:
        """Test the windows that these frames complete."""
        if self._segments and frames.stamps_ns.size:
            for window in self._windows.push(frames):
                for column, name in enumerate(MEASURED_SEGMENTS):
                    residual, predicted = window.residual_square.item(column), window.predicted_square.item(column)
                    if name in self._segments and not math.isnan(residual):
                        self._test(name, window.begin_ns, residual, predicted)

    def misfits(self) -> list[Misfit]:
        """All times of misfit, by their beginning."""
        return sorted([*self._ended, *self.lasting()], key=lambda one: one.begin_ns)

    def lasting(self) -> list[Misfit]:
        """The misfits of now."""
        return [Misfit(name, one.began_ns, None, _ratio(one)) for name, one in self._segments.items() if one.failing]

    def _test(self, name: str, begin_ns: int, residual: float, predicted: float) -> None:
        one = self._segments[name]
        score = max(-LARGEST_SCORE, min(LARGEST_SCORE, one.law.score(residual, predicted)))
        if predicted > (MOVING * one.law.noise_mps2) ** 2:
            one.recent.append(score)
        if one.total == 0.0 and not one.failing:
            one.began_ns, one.squares = begin_ns, (0.0, 0.0)
        one.squares = one.squares[0] + residual, one.squares[1] + one.law.square(predicted)
        one.total = max(0.0, one.total + score - ALLOWANCE)
        if not one.failing:
            one.failing = one.total > THRESHOLD
            one.recent.clear()
        elif len(one.recent) == RECENT and sum(one.recent) < RECENT * ALLOWANCE:
            self._ended.append(Misfit(name, one.began_ns, begin_ns + WINDOW_NS, _ratio(one)))
            one.failing, one.total = False, 0.0


def _ratio(one: _Segment) -> float:
    return math.sqrt(one.squares[0] / one.squares[1])
