"""Tilt: a tilted sensor reads part of its horizontal motion, and of gravity, as vertical."""

from __future__ import annotations

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SensorTransform, Values


def _transform(accel_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """A + s_x a_x + s_y a_y: the sensor's own horizontal readings include gravity's part."""
    return accel_mps2 + values["lean_x"] * channels["own.x"] + values["lean_y"] * channels["own.y"]


EFFECT = SensorTransform(
    name="tilt",
    family="horizontal",
    equation="a + s_x a_x + s_y a_y, with the readings of the sensor itself",
    signature="coherent with that sensor's own horizontal motion",
    parameters=(
        EffectParameter("lean_x", "", -0.4, 0.4, 0.1, "strength"),
        EffectParameter("lean_y", "", -0.4, 0.4, 0.0, "strength", acts_at=0.1),
    ),
    transform=_transform,
    channels=("own.x", "own.y"),
    seen_by_gyro=True,
    separated_by="turns",
)
