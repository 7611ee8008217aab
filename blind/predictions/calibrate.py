"""Calibration: factors of the intervals and settings of the fit monitor, from drives that are not tested on."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from biodyn_core.exposure.figure_spread import NORMAL_95
from biodyn_core.pipeline.fit_monitor import MonitorSettings
from blind.predictions.driven import FIGURES, Drive
from blind.predictions.score import DOSES, Scored, answer, scored

COVERAGE: Final = 0.95
ALLOWANCES: Final = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
THRESHOLDS: Final = (4.0, 6.0, 8.0, 10.0, 14.0, 18.0, 24.0, 32.0)
ALARMS_PER_H: Final = 1.0 / 16.0
"""Half of the allowed rate: a setting chosen at its limit exceeds it in other drives."""


@dataclass(frozen=True)
class Calibration:
    """The results: factors of doses and of peaks, settings of the monitor, and how they do on their own drives."""

    dose_factor: float
    peak_factor: float
    monitor: MonitorSettings
    false_alarms: int
    hours: float
    in_time: float


def calibrated(drives: Sequence[Drive]) -> Calibration:
    """Factors with which 95 % are covered, and the monitor that finds most within the allowed rate of false alarms."""
    found = list(scored(drives))
    doses = _factor([one for one in found if one.figure in DOSES])
    peaks = _factor([one for one in found if one.figure in FIGURES and one.figure not in DOSES])
    hours = sum(drive.seconds for drive in drives) / 3600.0
    tried = []
    for allowance, threshold in itertools.product(ALLOWANCES, THRESHOLDS):
        settings = replace(MonitorSettings(), allowance=allowance, threshold=threshold)
        answers = [answer(drive, settings) for drive in drives]
        hidden = [one for one in answers if one.delay_s is not None]
        alarms = sum(one.false_alarms for one in answers)
        tried.append((float(np.mean([one.in_time for one in hidden])), -alarms, settings))
    allowed = [one for one in tried if -one[1] <= ALARMS_PER_H * hours] or [max(tried, key=lambda one: one[1])]
    share, alarms, settings = max(allowed, key=lambda one: one[:2])
    return Calibration(doses, peaks, settings, -alarms, hours, share)


def _factor(found: Sequence[Scored]) -> float:
    """The factor with which the wanted share is covered, by bisection."""
    low, high = 0.0, 5.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        inside = float(np.mean([abs(one.score(middle)) <= NORMAL_95 for one in found]))
        low, high = (low, middle) if inside >= COVERAGE else (middle, high)
    return high
