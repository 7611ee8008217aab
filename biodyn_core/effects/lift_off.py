"""Lift-off: the seat cannot hold the pelvis down."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.effects.effect import Effect, Joint


def limit(force_n: float, weight_n: float) -> float:
    """F_1 = min(F_1, W)."""
    return min(force_n, weight_n)


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return (STANDARD_GRAVITY_MPS2 * joint.mass_above_kg,)


EFFECT = Effect(
    name="lift_off",
    family="lift_off",
    equation="F_1 = min(F_1, W), W the weight above the seat",
    signature="the pelvis falls at -1 g, then an impact",
    place="joint",
    parameters=(),
    sites=("pelvis",),
    constants=_constants,
    limit=limit,
    known_omission=True,
)
