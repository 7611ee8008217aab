"""Gain: a sensor whose scale factor is off."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects.effect import Effect, EffectParameter


def _measured(
    accel_mps2: Floats, rate_hz: float, channels: Mapping[str, Floats], values: Mapping[str, float]
) -> Floats:
    """(1 + g) a."""
    return (1.0 + values["gain"]) * accel_mps2


EFFECT = Effect(
    name="gain",
    family="sensor",
    equation="(1 + g) a",
    signature="proportional to a, flat over frequency, one channel",
    place="sensor",
    parameters=(EffectParameter("gain", "", -0.3, 0.3, 0.05, "strength"),),
    sites=MEASURED_SEGMENTS,
    measured=_measured,
)
