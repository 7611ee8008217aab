"""Scores of drives: coverage of the intervals, false alarms, and misfits found."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from world.seats import CASES

from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.body.usual_residual import UsualResidual, usual_residuals
from biodyn_core.exposure import figure_spread
from biodyn_core.pipeline.fit_monitor import FitMonitor, MonitorSettings
from blind.predictions.driven import FIGURES, MOVING_MPS2, WHOLE, Drive, Figures
from blind.predictions.people import LEVELS

Floats = NDArray[np.float64]

MEANS: Final = ("aw", "rms")
DOSES: Final = (*MEANS, "vdv")
ACCEL: Final = ("aw", "vdv", "peak")
LEAST_RATIO: Final = 0.8
"""Weaker effects are not asked for: some forms cannot be made as strong as intended."""

WITHIN_S: Final = 30.0
"""A misfit is found in time within so much motion."""


@dataclass(frozen=True)
class Scored:
    """One figure of one segment or joint: ln of true over predicted, and the two parts of its spread.

    condition: "whole drive", "kind not in the fit", or of the level of the motion beside the fit.
    """

    person: int
    figure: str
    segment: int
    condition: str
    log_ratio: float
    model: float
    parameters: float

    def score(self, factor: float) -> float:
        """The error in standard deviations."""
        return self.log_ratio / math.hypot(factor * self.model, self.parameters)


def scored(drives: Iterable[Drive]) -> Iterator[Scored]:
    """All figures that are known on both sides."""
    for drive in drives:
        for number, of in enumerate(drive.figures):
            means, peaks = np.hsplit(of.sums, 2)
            condition = condition_of(of, number)
            for row, figure in enumerate(FIGURES):
                first = 6 * (row >= 3)
                for segment in range(6):
                    sums, root = (means, 0.5) if figure in MEANS else (peaks, 0.25)
                    one = sums[first + segment]
                    if one[0] > 0.0 and not np.isnan(of.log_ratio[row, segment]):
                        yield Scored(
                            drive.number, figure, segment, condition, float(of.log_ratio[row, segment]),
                            figure_spread.spread(one, 1.0, 0.0), figure_spread.spread(one, 0.0, root),
                        )  # fmt: skip


def condition_of(of: Figures, number: int) -> str:
    """The condition of the figures of the event with this number in the drive."""
    if of.kind == WHOLE:
        return "the whole drive"
    if not of.fitted:
        return "a kind of motion not in the fit"
    level = LEVELS[number // len(CASES) % len(LEVELS)]
    return "the level of the fit" if level == 1.0 else f"{level:g} x the level of the fit"


def factor_of(figure: str) -> float:
    """The factor of the package for a figure."""
    factors = figure_spread.ACCEL_FACTORS if figure in ACCEL else figure_spread.FORCE_FACTORS
    return factors.doses if figure in DOSES else factors.peaks


def covered(found: Sequence[Scored]) -> float:
    """Share of the figures within their 95 % interval, percent."""
    inside = [abs(one.score(factor_of(one.figure))) <= NORMAL_95 for one in found]
    return 100.0 * float(np.mean(inside))


def resampled(found: Sequence[Scored], people: int = 400) -> tuple[float, float]:
    """95 % interval of the coverage by resampling whole people."""
    by_person: dict[int, list[bool]] = {}
    for one in found:
        inside = abs(one.score(factor_of(one.figure))) <= NORMAL_95
        by_person.setdefault(one.person, []).append(inside)
    hits = np.array([sum(values) for values in by_person.values()], dtype=float)
    counts = np.array([len(values) for values in by_person.values()], dtype=float)
    chosen = np.random.default_rng(0).integers(len(hits), size=(people, len(hits)))
    shares = 100.0 * hits[chosen].sum(axis=1) / counts[chosen].sum(axis=1)
    return float(np.quantile(shares, 0.025)), float(np.quantile(shares, 0.975))


# --- misfits ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Answer:
    """The alarms of one drive: number before the effect, and seconds of motion from its begin to the first alarm.

    delay_s: infinite without an alarm, None without an effect.
    """

    drive: Drive
    false_alarms: int
    delay_s: float | None

    @property
    def counts(self) -> bool:
        """Whether there is an effect strong enough to be asked for."""
        return self.delay_s is not None and (self.drive.ratio or 0.0) >= LEAST_RATIO

    @property
    def in_time(self) -> bool:
        """Whether the misfit was found within `WITHIN_S` of motion."""
        return self.delay_s is not None and self.delay_s <= WITHIN_S


def answer(drive: Drive, settings: MonitorSettings | None = None) -> Answer:
    """Run the monitor over the windows of a drive; an alarm before the effect is false.

    An alarm begins when no segment fails and one begins to; others that follow belong to it.
    """
    laws, _ = usual_residuals(drive.provenance)
    before = drive.begin_s < drive.begins_s
    false_alarms = len(_alarms(drive, laws, before, settings))
    if not drive.kind:
        return Answer(drive, false_alarms, None)
    moving = np.cumsum(np.sqrt(np.nan_to_num(drive.predicted[:, :, 0]).sum(axis=1)) > MOVING_MPS2)
    start = int(moving[before][-1]) if before.any() else 0
    alarms = _alarms(drive, laws, ~before, settings)
    return Answer(drive, false_alarms, float(moving[alarms[0]] - start) if alarms else math.inf)


def _alarms(
    drive: Drive, laws: dict[str, UsualResidual], use: NDArray[np.bool_] | None, settings: MonitorSettings | None
) -> list[int]:
    """The windows in which alarms begin."""
    monitor, failed, found = FitMonitor(laws, settings), False, []
    for at in np.flatnonzero(use) if use is not None else range(len(drive.begin_s)):
        monitor.test(round(1e9 * drive.begin_s[at]), drive.residual[at], drive.predicted[at])
        if (fails := bool(monitor.lasting())) and not failed:
            found.append(int(at))
        failed = fails
    return found
