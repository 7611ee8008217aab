"""Quadratic damping: damping that grows with the rate."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, c_2: float) -> float:
    """F = c_2 rate |rate|."""
    return c_2 * rate * abs(rate)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (joint.damping_n_s_per_m * values["growth_s_per_m"],)


EFFECT = JointForce(
    name="quadratic_damping",
    family="quadratic_damping",
    equation="F += b g rate |rate|",
    signature="peaks of shocks over-predicted, the road well",
    parameters=(EffectParameter("growth_s_per_m", "s/m", 0.0, 200.0, 2.0, "strength"),),
    constants=_constants,
    law=force,
)
