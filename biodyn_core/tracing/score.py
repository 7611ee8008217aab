"""Score: whether a subject with an effect predicts events it was not fitted to better than one without (tracing, C).

The mean over windows of log(SSE before / SSE after), every event weighted alike: a plain sum of squares is ruled by one
shock. Windows of one event are not independent; events are what is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.identification.objectives import Clocks, Pull, TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.settings import check_settings, setting
from biodyn_core.subject import Subject

Floats = NDArray[np.float64]

LEAST_EVENTS: Final = 3
LEAST_CASES: Final = 2
"""An effect is believed where it helps in so many events, or in events of so many loading conditions."""


@dataclass(frozen=True)
class ScoreSettings:
    """How held-out events are scored."""

    window_s: float = setting(0.5, "length of a window", "s", 0.05, 10.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class EventScore:
    """One event: its mean log ratio, positive where the second subject is better; SSE over energy, before and after."""

    name: str
    case: str
    mean_log_ratio: float
    before: float
    after: float


@dataclass(frozen=True)
class Score:
    """All events."""

    events: tuple[EventScore, ...]

    @property
    def mean(self) -> float:
        """Mean log ratio, every event alike."""
        return float(np.mean([event.mean_log_ratio for event in self.events]))

    @property
    def agrees(self) -> bool:
        """Whether it helps in enough events, or in events of enough loading conditions, to be more than one shock's."""
        helped = [event for event in self.events if event.mean_log_ratio > 0.0]
        return len(helped) >= LEAST_EVENTS or len({event.case for event in helped}) >= LEAST_CASES


def score(
    before: Subject, after: Subject, cases: Sequence[Case], clocks: Clocks = "estimated",
    settings: ScoreSettings | None = None,
) -> Score:  # fmt: skip
    """Score the step from one subject to another on cases that neither was fitted to."""
    s = settings or ScoreSettings()
    squares = [[_squares(subject, case, clocks) for case in cases] for subject in (before, after)]
    return Score(
        tuple(
            EventScore(case.name, case.case, _mean_log_ratio(one, other, round(s.window_s * case.rate_hz)),
                       float(np.nansum(one)), float(np.nansum(other)))
            for case, one, other in zip(cases, *squares, strict=True)
        )
    )  # fmt: skip


def _squares(subject: Subject, case: Case, clocks: Clocks) -> Floats:
    """Squared residual over energy, summed over segments, (n,), NaN where nothing is compared."""
    theta = subject.parameters.vector()
    residuals = TimeDomain([case], subject, Pull(theta, 0.0), clocks).residuals(0, theta)
    squares = residuals**2 / np.where(case.energy > 0.0, case.energy, np.inf)
    return np.where(np.isnan(squares).all(axis=1), np.nan, np.nansum(squares, axis=1))


def _mean_log_ratio(before: Floats, after: Floats, length: int) -> float:
    """Over the windows (length,) in which something is compared; the last, shorter one is left out."""
    whole = before.size // length * length
    sums = [np.nansum(squares[:whole].reshape(-1, length), axis=1) for squares in (before, after)]
    there = (sums[0] > 0.0) & (sums[1] > 0.0)
    return float(np.mean(np.log(sums[0][there] / sums[1][there]))) if there.any() else 0.0
