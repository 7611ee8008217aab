"""Sensor tilt: the mean tilt of a sensor in motion, from its own gyro.

Recordings correct this tilt, so it leaves no residual. Only a tilt beyond the typical one is reported.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.settings import TiltSettings


def mean_tilts(cases: Sequence[Case]) -> dict[str, float]:
    """Mean tilt over all events, as a share of g, of each sensor with a gyro in every event."""
    return {name: float(np.linalg.norm(tilt)) for name, tilt in _mean_tilts(cases).items()}


def _mean_tilts(cases: Sequence[Case]) -> dict[str, Floats]:
    return {
        sensor: np.mean([case.mean_tilts[sensor] for case in cases], axis=0)
        for sensor in MEASURED_SEGMENTS
        if cases and all(sensor in case.mean_tilts for case in cases)
    }


def sensor_tilts(
    cases: Sequence[Case], spread: float, settings: TiltSettings | None = None
) -> tuple[AppliedEffect, ...]:
    """Sensors with an atypical mean tilt over all events, as effects; only sensors with a gyro in every event.

    spread: the typical tilt, as a share of g.
    """
    s = settings or TiltSettings()
    limit = s.most_typical * spread
    return tuple(
        effect.sized(sensor, *mean_tilt.tolist())
        for effect in CATALOGUE.values()
        for sensor, mean_tilt in _mean_tilts(cases).items()
        if effect.seen_by_gyro and float(np.linalg.norm(mean_tilt)) > limit
    )


def tilt_deg(tilt: AppliedEffect) -> float:
    """The angle of a tilt, degrees."""
    x, y = (tilt.values[name] for name in tilt.effect.strengths)
    return float(np.degrees(np.arcsin(np.hypot(x, y))))
