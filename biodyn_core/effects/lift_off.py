"""Lift-off: the seat carries no tension."""

from __future__ import annotations

import math

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.effects.effect import EffectParameter, Joint, JointLimit, Values


def limit(force_n: float, weight_n: float, width_n: float) -> float:
    """F_1 = min(F_1, W), rounded within a width of force."""
    if width_n > 0.0 and abs(force_n - weight_n) < 30.0 * width_n:
        return weight_n - width_n * math.log1p(math.exp((weight_n - force_n) / width_n))
    return min(force_n, weight_n)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return STANDARD_GRAVITY_MPS2 * joint.mass_above_kg, values["width_n"]


EFFECT = JointLimit(
    name="lift_off",
    family="lift_off",
    equation="F_1 = min(F_1, W), W the weight above the seat",
    general_form="F_1 = W - w ln(1 + exp((W - F_1) / w))",
    signature="the pelvis falls at -1 g, then an impact",
    parameters=(
        EffectParameter("width_n", "N", 0.0, 100.0, 0.0, neutral=0.0, spread=20.0,
                        source="the buttocks part from the seat gradually; the size: no source"),
    ),
    sites=("pelvis",),
    constants=_constants,
    law=limit,
    known_omission=True,
    separated_by="shocks",
)  # fmt: skip
