"""Harness: a belt that holds the upper torso down once its slack is used up."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(x: float, v: float, seat: float, k: float, slack_m: float) -> float:
    """F = -k_h (x - g0) beyond the slack."""
    beyond = x - slack_m
    return -k * beyond if beyond > 0.0 else 0.0


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return values["stiffness_n_per_m"], values["slack_m"]


def _stiffens(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return values["stiffness_n_per_m"], 0.0


EFFECT = Effect(
    name="harness",
    family="harness",
    equation="F -= k_h max(0, x - g0)",
    signature="spikes of the upper torso in rebound",
    place="segment",
    parameters=(
        EffectParameter("stiffness_n_per_m", "N/m", 0.0, 100000.0, 25000.0, "strength"),
        EffectParameter("slack_m", "m", 0.0, 0.05, 0.01, grid=(0.002, 0.01, 0.02)),
    ),
    sites=("upper_torso",),
    constants=_constants,
    force=force,
    stiffens=_stiffens,
)
