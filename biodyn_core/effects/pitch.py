"""Pitch: the seat rotates, and the pelvis is at a distance from the seat's sensor.

x is forward, y left, z up. l is how far the sensor is in front of the pelvis; l' and l_z are how far the pelvis is left
of the sensor and above it.
"""

from __future__ import annotations

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import Channels, EffectParameter, SeatTransform, Values
from biodyn_core.effects.second_order import second_order


def _transform(seat_mps2: Floats, rate_hz: float, channels: Channels, values: Values) -> Floats:
    """Rigid-body acceleration at the pelvis: a_s + G (l q' + l' p' - l_z (p^2 + q^2)), G a soft frame."""
    p, q = channels["seat.rate_x"], channels["seat.rate_y"]
    turned = values["forward_m"] * np.gradient(q, 1.0 / rate_hz) + values["left_m"] * np.gradient(p, 1.0 / rate_hz)
    added = turned - values["up_m"] * (p**2 + q**2)
    if values["softness_s"] > 0.0:
        added = second_order(added, values["softness_s"], values["damping_ratio"], rate_hz)
    return seat_mps2 + added


EFFECT = SeatTransform(
    name="pitch",
    family="horizontal",
    equation="a_s + l q' + l' p' - l_z (p^2 + q^2)",
    general_form="a_s + G (l q' + l' p' - l_z (p^2 + q^2)), G a frame of second order",
    signature="coherent with q', in all segments",
    parameters=(
        EffectParameter("forward_m", "m", -0.5, 0.5, 0.15, "strength"),
        EffectParameter("left_m", "m", -0.5, 0.5, 0.0, "strength", acts_at=0.15),
        EffectParameter("up_m", "m", -0.5, 0.5, 0.0, "strength", acts_at=0.15),
        EffectParameter("softness_s", "s", 0.0, 0.02, 0.0, grid=(0.0, 0.005), neutral=0.0, spread=0.006,
                        source="a seat's frame of 8 Hz and more, 1 / (2 pi f); the size: no source"),
        EffectParameter("damping_ratio", "", 0.02, 1.0, 0.2, neutral=0.2, spread=0.2, source="as softness_s"),
    ),
    transform=_transform,
    channels=("seat.rate_x", "seat.rate_y"),
    separated_by="turns",
)  # fmt: skip
