"""Gain: a sensor with a wrong scale factor."""

from __future__ import annotations

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SensorTransform, Values


def _transform(accel_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """(1 + g) a."""
    return (1.0 + values["gain"]) * accel_mps2


EFFECT = SensorTransform(
    name="gain",
    family="sensor",
    equation="(1 + g) a",
    signature="proportional to a, flat over frequency, one channel",
    parameters=(EffectParameter("gain", "", -0.3, 0.3, 0.05, "strength"),),
    transform=_transform,
    separated_by="tap",
)
