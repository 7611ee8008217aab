"""Bouc-Wen hysteresis in a joint: stiff in small motion, yielding in large."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, z: float, yield_n: float, per_m: float) -> tuple[float, float]:
    """F = alpha z with z' = (rate / d_y) (1 - z^2 (1/2 + 1/2 sgn(rate z)))."""
    bend = z * z if rate * z > 0.0 else 0.0  # where either is zero, so is the product below
    return yield_n * z, rate * per_m * (1.0 - bend)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return values["yield_n"], 1.0 / values["yield_m"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return values["yield_n"] / values["yield_m"], 0.0


EFFECT = JointForce(
    name="hysteresis",
    family="dry_friction",
    equation="F += alpha z, z' = (rate / d_y) (1 - z^2 (.5 + .5 sgn(rate z)))",
    signature="stiff at small amplitude",
    parameters=(
        EffectParameter("yield_n", "N", 0.0, 500.0, 20.0, "strength"),
        EffectParameter("yield_m", "m", 1.5e-4, 5e-3, 5e-4, grid=(3e-4, 8e-4, 2e-3)),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    states=1,
)
