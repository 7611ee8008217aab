"""Posture: the stiffness of a joint changes at one instant of a recording."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, time_s: float, k_jump: float, at_s: float) -> tuple[float, float]:
    """F = k p stretch from t0 on; the state is the time from the start of the recording."""
    return k_jump * stretch if time_s >= at_s else 0.0, 1.0


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * values["jump"], values["at_s"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return joint.stiffness_n_per_m * max(values["jump"], 0.0), 0.0


EFFECT = JointForce(
    name="posture",
    family="state_of_the_body",
    equation="k (1 + p H(t - t0))",
    signature="a residual that begins at one instant",
    parameters=(
        EffectParameter("jump", "", -0.6, 1.0, 0.2, "strength"),
        EffectParameter("at_s", "s", 0.0, 86400.0, 10.0, "nuisance", grid=(3.5, 5.0, 6.5, 8.0, 10.0)),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    states=1,
    sized_by_training=True,
)
