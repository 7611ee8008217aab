"""End stop: a joint, or the cushion below the pelvis, reaches its end stop in compression."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, k_stop: float, gap_m: float) -> float:
    """F = -k_s (-stretch - d0) beyond the gap."""
    beyond = -stretch - gap_m
    return -k_stop * beyond if beyond > 0.0 else 0.0


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * values["stiffness_ratio"], values["gap_m"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return joint.stiffness_n_per_m * values["stiffness_ratio"], 0.0


EFFECT = JointForce(
    name="stop",
    family="stiffening",
    equation="F -= k_s max(0, -stretch - d0)",
    signature="spikes of 5 to 20 ms at the deepest compression",
    parameters=(
        EffectParameter("stiffness_ratio", "", 0.0, 10.0, 2.0, "strength"),
        EffectParameter("gap_m", "m", 0.0005, 0.04, 0.012, grid=(0.002, 0.005, 0.012, 0.02)),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
)
