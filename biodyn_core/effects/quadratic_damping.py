"""Quadratic damping: a damper that grows with its rate."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(stretch: float, rate: float, seat: float, c_2: float) -> float:
    """F = c_2 rate |rate|."""
    return c_2 * rate * abs(rate)


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return (joint.damping_n_s_per_m * values["growth_s_per_m"],)


EFFECT = Effect(
    name="quadratic_damping",
    family="quadratic_damping",
    equation="F += b g rate |rate|",
    signature="peaks of shocks over-predicted, the road well",
    place="joint",
    parameters=(EffectParameter("growth_s_per_m", "s/m", 0.0, 200.0, 2.0, "strength"),),
    constants=_constants,
    force=force,
)
