"""Cubic stiffening: a joint that stiffens with the square of its stretch."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, k_c: float) -> float:
    """F = k c stretch^3."""
    return k_c * stretch * stretch * stretch


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (joint.stiffness_n_per_m * values["cubic_per_m2"],)


EFFECT = JointForce(
    name="cubic",
    family="stiffening",
    equation="F += k c stretch^3",
    signature="shocks only, growing with the cube of the level",
    parameters=(EffectParameter("cubic_per_m2", "1/m^2", 0.0, 1e5, 300.0, "strength"),),
    constants=_constants,
    law=force,
)
