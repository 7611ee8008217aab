"""Backrest: a spring and a damper between a torso segment and the seat, and friction of the back on it."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, SegmentForce, Values


def force(
    x: float, v: float, seat: float, k: float, c: float, friction_n: float, smooth_squared: float, cubic: float
) -> float:
    """F = -(k_b x (1 + h x^2) + c_b v + F_c v / sqrt(v^2 + v_0^2)): tanh would double the time of a step."""
    return -(k * x + cubic * x * x * x + c * v + friction_n * v / math.sqrt(v * v + smooth_squared))


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    stiffness = values["stiffness_n_per_m"]
    return (
        stiffness,
        stiffness * values["damping_s"],
        values["friction_n"],
        values["smooth_mps"] ** 2,
        stiffness * values["cubic_per_m2"],
    )


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    stiffness, friction = values["stiffness_n_per_m"], values["friction_n"] / values["smooth_mps"]
    return stiffness, stiffness * values["damping_s"] + friction


EFFECT = SegmentForce(
    name="backrest",
    family="backrest",
    equation="F -= k_b x + c_b v + F_c v / sqrt(v^2 + v_0^2)",
    general_form="F -= k_b x (1 + h x^2) + c_b v + F_c v / sqrt(v^2 + v_0^2)",
    signature="the trunk follows the seat",
    parameters=(
        EffectParameter("stiffness_n_per_m", "N/m", 0.0, 30000.0, 4000.0, "strength"),
        EffectParameter("damping_s", "s", 0.002, 0.2, 0.02),
        EffectParameter("friction_n", "N", 0.0, 150.0, 20.0, "strength"),
        EffectParameter(
            "smooth_mps", "m/s", 0.002, 0.05, 0.01, "nuisance", "rate over which it builds up: as in a joint"
        ),
        EffectParameter("cubic_per_m2", "1/m^2", 0.0, 1e5, 0.0, grid=(0.0, 2000.0), neutral=0.0, spread=3000.0,
                        source="padding hardens; the size: no source"),
    ),
    sites=("lower_torso", "central_torso", "upper_torso"),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    separated_by="bare",
)  # fmt: skip
