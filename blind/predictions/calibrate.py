"""Calibration: factors of the intervals and settings of the fit monitor, from drives that are not tested on."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.exposure.figure_spread import SpreadFactors
from biodyn_core.pipeline.fit_monitor import MonitorSettings
from blind.predictions.driven import Drive
from blind.predictions.score import Scored, answer, scored

COVERAGE: Final = 0.95
ALLOWANCES: Final = (0.9, 1.2, 1.4, 1.6, 1.8, 2.0)
THRESHOLDS: Final = (5.0, 7.0, 10.0, 14.0, 20.0, 28.0)
MARGIN: Final = 0.7
"""No false alarm with this share of a threshold: one that is chosen at its limit gives alarms in other drives."""


@dataclass(frozen=True)
class Calibration:
    """The results: factors of accelerations and forces, settings of the monitor, and how it does on its own drives."""

    accel: SpreadFactors
    force: SpreadFactors
    monitor: MonitorSettings
    false_alarms: int
    hours: float
    in_time: float


def calibrated(drives: Sequence[Drive]) -> Calibration:
    """Factors with which 95 % are covered, and the monitor that finds most without a false alarm."""
    found = list(scored(drives))
    accel, force = (
        SpreadFactors(*(_factor([one for one in found if one.figure in figures]) for figures in pair))
        for pair in ((("aw", "vdv"), ("peak",)), (("rms",), ("compression", "tension")))
    )
    steady = [drive for drive in drives if not drive.drifts]
    allowed = []
    for allowance, threshold in itertools.product(ALLOWANCES, THRESHOLDS):
        settings = replace(MonitorSettings(), allowance=allowance, threshold=threshold)
        if not _alarms(steady, replace(settings, threshold=MARGIN * threshold)):
            allowed.append((*_found(drives, settings), settings))
    share, _, settings = max(allowed, key=lambda one: one[:2])
    hours = sum(drive.seconds for drive in steady) / 3600.0
    return Calibration(accel, force, settings, _alarms(steady, settings), hours, share)


def _alarms(drives: Sequence[Drive], settings: MonitorSettings) -> int:
    return sum(answer(drive, settings).false_alarms for drive in drives)


def _found(drives: Sequence[Drive], settings: MonitorSettings) -> tuple[float, float]:
    """Share of the effects found in time, and the median delay with its sign changed."""
    hidden = [one for one in (answer(drive, settings) for drive in drives) if one.counts]
    delays = [math.inf if one.delay_s is None else one.delay_s for one in hidden]
    return float(np.mean([one.in_time for one in hidden])), -float(np.median(delays))


def _factor(found: Sequence[Scored]) -> float:
    """The factor with which the wanted share is covered, by bisection."""
    low, high = 0.0, 5.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        inside = float(np.mean([abs(one.score(middle)) <= NORMAL_95 for one in found]))
        low, high = (low, middle) if inside >= COVERAGE else (middle, high)
    return high
