"""Thixotropy: a joint that softens with recent motion and recovers at rest."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(
    stretch: float, rate: float, seat: float, softened: float, k_beta: float, rate_mps: float, tau_s: float
) -> tuple[float, float]:
    """F = -k beta s stretch with s' = (|rate| / v_t (1 - s) - s) / tau."""
    return -k_beta * softened * stretch, (abs(rate) / rate_mps * (1.0 - softened) - softened) / tau_s


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * values["softening"], values["rate_mps"], values["tau_s"]


EFFECT = JointForce(
    name="thixotropy",
    family="state_of_the_body",
    equation="k (1 - beta s), s' = (|rate| / v_t (1 - s) - s) / tau",
    signature="natural frequency drops after a shock and recovers",
    parameters=(
        EffectParameter(
            "softening", "", 0.0, 0.9, 0.35, "strength",
            "apparent mass resonance from 5.25 to 4.25 Hz between .35 and 1.4 m/s^2: Matsumoto and Griffin 2002",
        ),
        EffectParameter("rate_mps", "m/s", 0.002, 0.5, 0.03),
        EffectParameter("tau_s", "s", 0.5, 20.0, 4.0, grid=(1.0, 4.0, 10.0)),
    ),
    constants=_constants,
    law=force,
    states=1,
)  # fmt: skip
