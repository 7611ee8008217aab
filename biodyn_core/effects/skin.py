"""Skin: soft tissue under a sensor, on which the sensor resonates."""

from __future__ import annotations

import math

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SensorTransform, Values
from biodyn_core.effects.second_order import second_order


def _transform(accel_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """(2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2), w = 1 / softness; input linear between samples."""
    if values["softness_s"] == 0.0:
        return accel_mps2
    return second_order(accel_mps2, values["softness_s"], values["damping_ratio"], rate_hz)


EFFECT = SensorTransform(
    name="skin",
    family="sensor",
    equation="(2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2), w = 1 / softness",
    signature="one channel, about f^2, rings after an impact",
    parameters=(
        EffectParameter(
            "softness_s", "s", 0.0, 1.0 / (2.0 * math.pi * 8.0), 1.0 / (2.0 * math.pi * 35.0), "strength",
            "legs: 10 to 18 Hz, peak 1.5 to 2.2; back and head: no source",
            grid=tuple(1.0 / (2.0 * math.pi * f) for f in (15.0, 35.0, 60.0)),
        ),
        EffectParameter("damping_ratio", "", 0.05, 1.0, 0.3),
    ),
    transform=_transform,
    separated_by="tap",
)  # fmt: skip
