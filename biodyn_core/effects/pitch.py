"""Pitch: the seat rotates, and the pelvis is at a distance from the seat's sensor."""

from __future__ import annotations

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SeatTransform, Values


def _transform(seat_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """Rigid-body acceleration at the pelvis: a_s + l q' + l' p' - l_z (p^2 + q^2)."""
    p, q = channels["seat.rate_x"], channels["seat.rate_y"]
    turned = values["forward_m"] * np.gradient(q, 1.0 / rate_hz) + values["left_m"] * np.gradient(p, 1.0 / rate_hz)
    return seat_mps2 + turned - values["up_m"] * (p**2 + q**2)


EFFECT = SeatTransform(
    name="pitch",
    family="horizontal",
    equation="a_s + l q' + l' p' - l_z (p^2 + q^2)",
    signature="coherent with q', in all segments",
    parameters=(
        EffectParameter("forward_m", "m", -0.5, 0.5, 0.15, "strength"),
        EffectParameter("left_m", "m", -0.5, 0.5, 0.0, "strength", acts_at=0.15),
        EffectParameter("up_m", "m", -0.5, 0.5, 0.0, "strength", acts_at=0.15),
    ),
    transform=_transform,
    channels=("seat.rate_x", "seat.rate_y"),
)
