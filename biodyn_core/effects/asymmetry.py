"""Asymmetry: a joint that is stiffer in compression than in tension, or the other way round."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, k_a: float) -> float:
    """F = k a stretch^2."""
    return k_a * stretch * stretch


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (joint.stiffness_n_per_m * values["asymmetry_per_m"],)


EFFECT = JointForce(
    name="asymmetry",
    family="stiffening",
    equation="F += k a stretch^2",
    signature="a shift of the level and a second harmonic, in shocks only",
    parameters=(EffectParameter("asymmetry_per_m", "1/m", -200.0, 200.0, 10.0, "strength"),),
    constants=_constants,
    law=force,
)
