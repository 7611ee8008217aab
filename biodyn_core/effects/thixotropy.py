"""Thixotropy: a joint that softens with recent motion and recovers at rest."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

FASTEST_PER_S = 1000.0
"""Upper limit of the rate of softening: the joint is soft within a millisecond of fast motion."""


def force(
    stretch: float,
    rate: float,
    seat: float,
    softened: float,
    k_beta: float,
    b_beta: float,
    rate_mps: float,
    exponent: float,
    tau_s: float,
    fastest: float,
) -> tuple[float, float]:
    """F = -beta s (k stretch + d b rate) with s' = ((|rate| / v_t)^p (1 - s) - s) / tau.

    s approaches 1 at 1000 / s at most: faster, the integration would be unstable.
    """
    moving = abs(rate) / rate_mps
    if exponent != 1.0:
        moving = moving**exponent
    softening = min(moving / tau_s, fastest) * (1.0 - softened)
    return -softened * (k_beta * stretch + b_beta * rate), softening - softened / tau_s


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    k_beta = joint.stiffness_n_per_m * values["softening"]
    b_beta = joint.damping_n_s_per_m * values["softening"] * values["damping_share"]
    return k_beta, b_beta, values["rate_mps"], values["exponent"], values["tau_s"], FASTEST_PER_S


EFFECT = JointForce(
    name="thixotropy",
    family="state_of_the_body",
    equation="k (1 - beta s), s' = (|rate| / v_t (1 - s) - s) / tau",
    general_form="(1 - beta s) k, (1 - d beta s) b, s' = ((|rate| / v_t)^p (1 - s) - s) / tau",
    signature="natural frequency drops after a shock and recovers",
    parameters=(
        EffectParameter(
            "softening", "", 0.0, 0.9, 0.35, "strength",
            "apparent mass resonance from 5.25 to 4.25 Hz between .35 and 1.4 m/s^2: Matsumoto and Griffin 2002",
        ),
        EffectParameter("rate_mps", "m/s", 0.002, 0.5, 0.03),
        EffectParameter("tau_s", "s", 0.5, 20.0, 4.0, grid=(1.0, 4.0, 10.0)),
        EffectParameter("exponent", "", 0.4, 2.5, 1.0, neutral=1.0, spread=0.4,
                        source="softening over magnitude differs between studies; the size: no source"),
        EffectParameter("damping_share", "", 0.0, 1.1, 0.0, grid=(0.0, 1.0), neutral=0.0, spread=0.5,
                        source="whether damping softens too is not known"),
    ),
    constants=_constants,
    law=force,
    states=1,
    separated_by="quiet_loud_quiet",
)  # fmt: skip
