"""Friction in a joint: Coulomb friction, smooth near rest, with a bristle that bends before it slips."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

FASTEST_PER_S = 1000.0
"""Upper limit of the bristle's rate: its state settles within a millisecond of slip."""


def force(
    stretch: float,
    rate: float,
    seat: float,
    z: float,
    friction_n: float,
    smooth_mps: float,
    per_m: float,
    fastest: float,
    stribeck: float,
    per_mps: float,
) -> tuple[float, float]:
    """F = F_c z (1 + s exp(-|rate| / v_s)), z' = (|rate| + v_0) / d (rate / sqrt(rate^2 + v_0^2) - z) (Dahl).

    The rate of z is at most 1000 / s. tanh would double the time of a step.
    """
    full = rate / math.sqrt(rate * rate + smooth_mps * smooth_mps)
    tracking = min((abs(rate) + smooth_mps) * per_m, fastest)
    sticking = 1.0 + stribeck * math.exp(-abs(rate) * per_mps) if stribeck > 0.0 else 1.0
    return friction_n * z * sticking, tracking * (full - z)


def _stribeck(values: Values) -> tuple[float, float]:
    return values["stribeck"], 1.0 / values["stribeck_mps"]


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return values["friction_n"], values["smooth_mps"], 1.0 / values["presliding_m"], FASTEST_PER_S, *_stribeck(values)


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return values["friction_n"] * (1.0 + values["stribeck"]) / values["presliding_m"], 0.0


def _max_own_eigenvalue_per_s(joint: Joint, values: Values) -> float:
    return FASTEST_PER_S


EFFECT = JointForce(
    name="friction",
    family="dry_friction",
    variant_of="dry_friction",
    equation="F += F_c z, z' = min((|rate| + v_0) / d, 1000 / s) (rate / sqrt(rate^2 + v_0^2) - z)",
    general_form="F += F_c z (1 + s exp(-|rate| / v_s))",
    signature="damping that falls with amplitude",
    parameters=(
        EffectParameter(
            "friction_n", "N", 0.0, 300.0, 10.0, "strength", "the term: Muksian and Nash 1974; its size: no source"
        ),
        EffectParameter(
            "smooth_mps", "m/s", 0.0002, 0.02, 0.005, "nuisance", "rate over which it builds up: tracing study",
            grid=(0.001, 0.005),
        ),
        EffectParameter("presliding_m", "m", 1e-5, 2e-4, 3e-5, grid=(2e-5, 1e-4)),
        EffectParameter("stribeck", "", 0.0, 1.5, 0.0, grid=(0.0, 0.5), neutral=0.0, spread=0.5,
                        source="static above sliding friction: Stribeck; the size: no source"),
        EffectParameter("stribeck_mps", "m/s", 0.002, 0.2, 0.02, neutral=0.02, spread=0.03, source="as stribeck"),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    max_own_eigenvalue_per_s=_max_own_eigenvalue_per_s,
    states=1,
)  # fmt: skip
