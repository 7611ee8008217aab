"""Relaxation: a joint with a parallel Maxwell element, the standard linear solid."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, creep: float, k_m: float, tau_s: float) -> tuple[float, float]:
    """F = k_m (stretch - q) with q' = (stretch - q) / tau."""
    return k_m * (stretch - creep), (stretch - creep) / tau_s


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * values["stiffness_ratio"], values["tau_s"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return joint.stiffness_n_per_m * values["stiffness_ratio"], 0.0


EFFECT = JointForce(
    name="relaxation",
    family="memory",
    equation="F += k_m (stretch - q), q' = (stretch - q) / tau",
    signature="linear; a phase error near 1 / (2 pi tau)",
    parameters=(
        EffectParameter("stiffness_ratio", "", 0.0, 2.0, 0.4, "strength"),
        EffectParameter("tau_s", "s", 0.005, 3.0, 0.1, grid=(0.02, 0.1, 0.5)),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    states=1,
)
