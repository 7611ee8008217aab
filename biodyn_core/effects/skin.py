"""Skin: soft tissue under a sensor, on which the sensor resonates."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy  # submodules load at first use: their import takes longer than a first result

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SensorTransform, Values


def _transform(accel_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """(2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2), w = 1 / softness; input linear between samples."""
    if values["softness_s"] == 0.0:
        return accel_mps2
    over, under = _filter(values["softness_s"], values["damping_ratio"], rate_hz)
    return np.asarray(scipy.signal.lfilter(over, under, accel_mps2))


@lru_cache(maxsize=64)  # every event needs the same filter, whose design takes longer than its application
def _filter(softness_s: float, damping_ratio: float, rate_hz: float) -> tuple[Floats, Floats]:
    """Numerator and denominator of the discrete filter."""
    omega, zeta = 1.0 / softness_s, damping_ratio
    system = scipy.signal.cont2discrete(
        ([2.0 * zeta * omega, omega**2], [1.0, 2.0 * zeta * omega, omega**2]), 1.0 / rate_hz, "foh"
    )
    return np.ravel(system[0]), np.asarray(system[1])


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
)  # fmt: skip
