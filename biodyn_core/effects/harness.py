"""Harness: a belt that holds the upper torso down beyond its slack."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, SegmentForce, Values

HARDENING_M = 0.01
"""Stretch of the belt from which its hardening is visible."""


def force(
    x: float, v: float, seat: float, k: float, slack_m: float, hardening: float, per_m: float, loss_s_per_m: float
) -> float:
    """F = -k_h u (1 + u / L)^q max(0, 1 + c v), u = x - g0 beyond the slack."""
    beyond = x - slack_m
    if beyond <= 0.0:
        return 0.0
    pull = k * beyond
    if hardening != 0.0:
        pull *= (1.0 + beyond * per_m) ** hardening
    return -pull * max(0.0, 1.0 + loss_s_per_m * v)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (
        values["stiffness_n_per_m"], values["slack_m"], values["hardening"], 1.0 / HARDENING_M, values["loss_s_per_m"],
    )  # fmt: skip


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    """At a stretch of L, with half of its force lost."""
    stiffness, q = values["stiffness_n_per_m"], values["hardening"]
    steepest = stiffness * max(1.0, 2.0**q * (1.0 + 0.5 * q))
    return steepest * (1.0 + 0.5 * (values["loss_s_per_m"] > 0.0)), stiffness * HARDENING_M * values["loss_s_per_m"]


EFFECT = SegmentForce(
    name="harness",
    family="harness",
    equation="F -= k_h max(0, x - g0)",
    general_form="F -= k_h u (1 + u / L)^q max(0, 1 + c v), u = max(0, x - g0), L = 10 mm",
    signature="spikes of the upper torso in rebound",
    parameters=(
        EffectParameter("stiffness_n_per_m", "N/m", 0.0, 100000.0, 25000.0, "strength"),
        EffectParameter("slack_m", "m", 0.0, 0.05, 0.01, reach_shares=(0.1, 0.3, 0.6)),
        EffectParameter("hardening", "", -0.9, 8.0, 0.0, grid=(0.0, 1.5), neutral=0.0, spread=1.5,
                        source="webbing hardens with its elongation; the exponent: no source"),
        EffectParameter("loss_s_per_m", "s/m", 0.0, 5.0, 0.0, neutral=0.0, spread=1.0,
                        source="webbing returns less than it takes up; the size: no source"),
    ),
    sites=("upper_torso",),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    separated_by="bare",
)  # fmt: skip
