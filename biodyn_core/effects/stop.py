"""End stop: a joint, or the cushion below the pelvis, reaches its end stop in compression."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

BEND_M = 0.001
"""Depth beyond the gap from which the exponent is visible."""


def force(
    stretch: float, rate: float, seat: float, k_stop: float, gap_m: float, exponent: float, per_m: float, knee_m: float
) -> float:
    """F = -k_s u (1 + u / L)^q, u beyond the gap with a knee of width w: w ln(1 + exp((-stretch - d0) / w))."""
    beyond = -stretch - gap_m
    if knee_m > 0.0:
        share = max(beyond / knee_m, -700.0)
        rounded = knee_m * math.log1p(math.exp(share)) if share < 30.0 else beyond
        beyond = rounded - knee_m * math.log1p(math.exp(-gap_m / knee_m))  # no force at rest
    if beyond <= 0.0:
        return 0.0
    push = -k_stop * beyond
    return push if exponent == 0.0 else push * (1.0 + beyond * per_m) ** exponent


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (
        joint.stiffness_n_per_m * values["stiffness_ratio"],
        values["gap_m"],
        values["exponent"],
        1.0 / BEND_M,
        values["knee_m"],
    )


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    q = values["exponent"]
    return joint.stiffness_n_per_m * values["stiffness_ratio"] * max(1.0, 2.0**q * (1.0 + 0.5 * q)), 0.0


EFFECT = JointForce(
    name="stop",
    family="stiffening",
    variant_of="nonlinear_stiffness",
    equation="F -= k_s max(0, -stretch - d0)",
    general_form="F -= k_s u (1 + u / L)^q, u = max(0, -stretch - d0) with a knee of width w, L = 1 mm",
    signature="spikes of 5 to 20 ms at the deepest compression",
    parameters=(
        EffectParameter("stiffness_ratio", "", 0.0, 10.0, 2.0, "strength"),
        EffectParameter("gap_m", "m", 0.00005, 0.04, 0.012, reach_shares=(0.2, 0.45, 0.7)),
        EffectParameter("exponent", "", -0.9, 3.0, 0.0, grid=(0.0, 1.0), neutral=0.0, spread=1.0,
                        source="tissue at the end of its range hardens; the size: no source"),
        EffectParameter("knee_m", "m", 0.0, 0.005, 0.0, grid=(0.0, 0.0007), neutral=0.0, spread=0.001,
                        source="an end that sets in gradually; the size: no source"),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    separated_by="shocks",
)  # fmt: skip
