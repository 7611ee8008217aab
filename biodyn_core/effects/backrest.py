"""Backrest: a spring and a damper between a torso segment and the seat."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(x: float, v: float, seat: float, k: float, c: float) -> float:
    """F = -(k_b x + c_b v)."""
    return -(k * x + c * v)


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return values["stiffness_n_per_m"], values["stiffness_n_per_m"] * values["damping_s"]


def _stiffens(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return values["stiffness_n_per_m"], values["stiffness_n_per_m"] * values["damping_s"]


EFFECT = Effect(
    name="backrest",
    family="backrest",
    equation="F -= k_b x + c_b v",
    signature="the trunk follows the seat",
    place="segment",
    parameters=(
        EffectParameter("stiffness_n_per_m", "N/m", 0.0, 30000.0, 4000.0, "strength"),
        EffectParameter("damping_s", "s", 0.0, 0.2, 0.02),
    ),
    sites=("lower_torso", "central_torso", "upper_torso"),
    constants=_constants,
    force=force,
    stiffens=_stiffens,
)
