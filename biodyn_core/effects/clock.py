"""Clock: a sensor whose stamps are late, and more so with time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy  # its parts load where they are used: they take longer than a model to its first result

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects.effect import Effect, EffectParameter


def _measured(
    accel_mps2: Floats, rate_hz: float, channels: Mapping[str, Floats], values: Mapping[str, float]
) -> Floats:
    """a(t - d - rho t) by a cubic spline; what lies before the record is its first sample."""
    time_s = np.arange(accel_mps2.size) / rate_hz
    true_s = time_s - values["delay_s"] - values["drift"] * time_s
    return np.asarray(scipy.interpolate.CubicSpline(time_s, accel_mps2)(np.clip(true_s, 0.0, time_s[-1])))


EFFECT = Effect(
    name="clock",
    family="sensor",
    equation="a(t - d - rho t)",
    signature="proportional to -a', one channel",
    place="sensor",
    parameters=(
        EffectParameter("delay_s", "s", -0.02, 0.02, 0.002, "strength"),
        EffectParameter("drift", "s/s", -5e-4, 5e-4, 0.0, "strength", acts_at=5e-05),
    ),
    sites=MEASURED_SEGMENTS,
    measured=_measured,
    constant_part=True,
)
