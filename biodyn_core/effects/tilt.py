"""Tilt: a sensor that leans as it moves reads its own fore-aft motion, and gravity, as vertical."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects.effect import Effect, EffectParameter


def _measured(
    accel_mps2: Floats, rate_hz: float, channels: Mapping[str, Floats], values: Mapping[str, float]
) -> Floats:
    """A + s_x a_x + s_y a_y: gravity's share of the lean is in the sensor's own horizontal readings."""
    return accel_mps2 + values["lean_x"] * channels["own.x"] + values["lean_y"] * channels["own.y"]


EFFECT = Effect(
    name="tilt",
    family="horizontal",
    equation="a + s_x a_x + s_y a_y, with the readings of the sensor itself",
    signature="coherent with that sensor's own horizontal motion",
    place="sensor",
    parameters=(
        EffectParameter("lean_x", "", -0.4, 0.4, 0.1, "strength"),
        EffectParameter("lean_y", "", -0.4, 0.4, 0.0, "strength", acts_at=0.1),
    ),
    sites=MEASURED_SEGMENTS,
    measured=_measured,
    channels=("own.x", "own.y"),
)
