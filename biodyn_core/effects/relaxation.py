"""Relaxation: a joint with a parallel Maxwell element, the standard linear solid."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(
    stretch: float,
    rate: float,
    seat: float,
    creep: float,
    other: float,
    k_m: float,
    tau_s: float,
    k_2: float,
    tau_2: float,
) -> tuple[float, float, float]:
    """F = k_m (stretch - q) + k_2 (stretch - q_2) with q' = (stretch - q) / tau, q_2 likewise."""
    own, more = stretch - creep, stretch - other
    return k_m * own + k_2 * more, own / tau_s, more / tau_2


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    k_m = joint.stiffness_n_per_m * values["stiffness_ratio"]
    return k_m, values["tau_s"], k_m * values["second_share"], values["second_tau_s"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return joint.stiffness_n_per_m * values["stiffness_ratio"] * (1.0 + values["second_share"]), 0.0


EFFECT = JointForce(
    name="relaxation",
    family="memory",
    equation="F += k_m (stretch - q), q' = (stretch - q) / tau",
    general_form="F += k_m (stretch - q), q' = (stretch - q) / tau, and a second element of k_m r and tau_2",
    signature="linear; a phase error near 1 / (2 pi tau)",
    parameters=(
        EffectParameter("stiffness_ratio", "", 0.0, 2.0, 0.4, "strength"),
        EffectParameter("tau_s", "s", 0.005, 3.0, 0.1, grid=(0.02, 0.1, 0.5)),
        EffectParameter("second_share", "", 0.0, 3.0, 0.0, grid=(0.7,), neutral=0.0, spread=0.7,
                        source="tissue relaxes over decades of time; the size: no source"),
        EffectParameter("second_tau_s", "s", 0.005, 3.0, 0.02, grid=(0.01, 0.3), neutral=0.02, spread=1.0,
                        source="as second_share"),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    states=2,
)  # fmt: skip
