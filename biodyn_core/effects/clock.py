"""Clock: a sensor whose stamps are late, and more so with time."""

from __future__ import annotations

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SensorTransform, Values


def _transform(accel_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """a(t - d - rho t) by a cubic spline; before the record it equals the first sample."""
    time_s = np.arange(accel_mps2.size) / rate_hz
    true_s = time_s - values["delay_s"] - values["drift"] * time_s
    return np.asarray(scipy.interpolate.CubicSpline(time_s, accel_mps2)(np.clip(true_s, 0.0, time_s[-1])))


EFFECT = SensorTransform(
    name="clock",
    family="sensor",
    equation="a(t - d - rho t)",
    signature="proportional to -a', one channel",
    parameters=(
        EffectParameter("delay_s", "s", -0.02, 0.02, 0.002, "strength"),
        EffectParameter("drift", "s/s", -5e-4, 5e-4, 0.0, "strength", acts_at=5e-05),
    ),
    transform=_transform,
    constant_part=True,
    varies_as="delay",
    separated_by="tap",
)
