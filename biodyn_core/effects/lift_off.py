"""Lift-off: the seat carries no tension."""

from __future__ import annotations

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.effects.effect import Joint, JointLimit, Values


def limit(force_n: float, weight_n: float) -> float:
    """F_1 = min(F_1, W)."""
    return min(force_n, weight_n)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (STANDARD_GRAVITY_MPS2 * joint.mass_above_kg,)


EFFECT = JointLimit(
    name="lift_off",
    family="lift_off",
    equation="F_1 = min(F_1, W), W the weight above the seat",
    signature="the pelvis falls at -1 g, then an impact",
    parameters=(),
    sites=("pelvis",),
    constants=_constants,
    law=limit,
    known_omission=True,
)
