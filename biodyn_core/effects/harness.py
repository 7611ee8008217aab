"""Harness: a belt that holds the upper torso down beyond its slack."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, SegmentForce, Values


def force(x: float, v: float, seat: float, k: float, slack_m: float) -> float:
    """F = -k_h (x - g0) beyond the slack."""
    beyond = x - slack_m
    return -k * beyond if beyond > 0.0 else 0.0


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return values["stiffness_n_per_m"], values["slack_m"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return values["stiffness_n_per_m"], 0.0


EFFECT = SegmentForce(
    name="harness",
    family="harness",
    equation="F -= k_h max(0, x - g0)",
    signature="spikes of the upper torso in rebound",
    parameters=(
        EffectParameter("stiffness_n_per_m", "N/m", 0.0, 100000.0, 25000.0, "strength"),
        EffectParameter("slack_m", "m", 0.0, 0.05, 0.01, grid=(0.002, 0.01, 0.02)),
    ),
    sites=("upper_torso",),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
)
