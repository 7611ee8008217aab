"""Pitch: the seat turns, and the pelvis sits away from the sensor under it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Effect, EffectParameter


def _seat(seat_mps2: Floats, rate_hz: float, channels: Mapping[str, Floats], values: Mapping[str, float]) -> Floats:
    """Rigid-body acceleration at the pelvis: a_s + l q' + l' p' - l_z (p^2 + q^2)."""
    p, q = channels["seat.rate_x"], channels["seat.rate_y"]
    turned = values["forward_m"] * np.gradient(q, 1.0 / rate_hz) + values["left_m"] * np.gradient(p, 1.0 / rate_hz)
    return seat_mps2 + turned - values["up_m"] * (p**2 + q**2)


EFFECT = Effect(
    name="pitch",
    family="horizontal",
    equation="a_s + l q' + l' p' - l_z (p^2 + q^2)",
    signature="coherent with q', in all segments",
    place="seat",
    parameters=(
        EffectParameter("forward_m", "m", -0.5, 0.5, 0.15, "strength"),
        EffectParameter("left_m", "m", -0.5, 0.5, 0.0, "strength", acts_at=0.15),
        EffectParameter("up_m", "m", -0.5, 0.5, 0.0, "strength", acts_at=0.15),
    ),
    sites=("seat",),
    seat=_seat,
    channels=("seat.rate_x", "seat.rate_y"),
)
