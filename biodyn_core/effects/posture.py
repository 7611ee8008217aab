"""Posture: the stiffness of a joint changes at one instant of a recording."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(
    stretch: float, rate: float, seat: float, time_s: float, k_jump: float, b_jump: float, at_s: float, width_s: float
) -> tuple[float, float]:
    """F = p (k stretch + d b rate) from t0 on, or within a width; the state is the time from the recording's start."""
    share = 1.0 if time_s >= at_s else 0.0
    if width_s > 0.0:
        share = 0.5 * (1.0 + math.tanh((time_s - at_s) / width_s))
    return share * (k_jump * stretch + b_jump * rate), 1.0


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    b_jump = joint.damping_n_s_per_m * values["jump"] * values["damping_share"]
    return joint.stiffness_n_per_m * values["jump"], b_jump, values["at_s"], values["width_s"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return joint.stiffness_n_per_m * max(values["jump"], 0.0), 0.0


EFFECT = JointForce(
    name="posture",
    family="state_of_the_body",
    equation="k (1 + p H(t - t0))",
    general_form="k (1 + p H(t - t0)), b (1 + d p H(t - t0)), H within a width",
    signature="a residual that begins at one instant",
    parameters=(
        EffectParameter("jump", "", -0.6, 1.0, 0.2, "strength"),
        EffectParameter("at_s", "s", 0.0, 86400.0, 10.0, "nuisance", grid=(3.5, 5.0, 6.5, 8.0, 10.0)),
        EffectParameter("width_s", "s", 0.0, 20.0, 0.0, neutral=0.0, spread=2.0,
                        source="a person takes seconds to change posture; the size: no source"),
        EffectParameter("damping_share", "", -1.0, 2.0, 0.0, neutral=0.0, spread=0.5,
                        source="whether damping changes too is not known"),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    states=1,
    sized_by_training=True,
    varies_as="step",
    separated_by="quiet_loud_quiet",
)  # fmt: skip
