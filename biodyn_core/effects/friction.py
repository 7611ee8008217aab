"""Friction in a joint: Coulomb's, smooth about rest, behind a bristle that bends before it slips."""

from __future__ import annotations

import math
from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint

FASTEST_PER_S = 1000.0
"""How fast the bristle follows at most: what slips for longer than a millisecond has slipped."""


def force(
    stretch: float,
    rate: float,
    seat: float,
    z: float,
    friction_n: float,
    smooth_mps: float,
    per_m: float,
    fastest: float,
) -> tuple[float, float]:
    """F = F_c z with z' = (|rate| + v_0) / d (rate / sqrt(rate^2 + v_0^2) - z), 1000 / s at most: Coulomb's, or Dahl's.

    A root, since a step takes twice as long with a tanh.
    """
    full = rate / math.sqrt(rate * rate + smooth_mps * smooth_mps)
    follows = min((abs(rate) + smooth_mps) * per_m, fastest)
    return friction_n * z, follows * (full - z)


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return values["friction_n"], values["smooth_mps"], 1.0 / values["presliding_m"], FASTEST_PER_S


def _stiffens(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return values["friction_n"] / values["presliding_m"], 0.0


def _own_rate_per_s(joint: Joint, values: Mapping[str, float]) -> float:
    return FASTEST_PER_S


EFFECT = Effect(
    name="friction",
    family="dry_friction",
    equation="F += F_c z, z' = min((|rate| + v_0) / d, 1000 / s) (rate / sqrt(rate^2 + v_0^2) - z)",
    signature="damping that falls with amplitude",
    place="joint",
    parameters=(
        EffectParameter(
            "friction_n", "N", 0.0, 300.0, 10.0, "strength", "the term: Muksian and Nash 1974; its size: no source"
        ),
        EffectParameter(
            "smooth_mps", "m/s", 0.0002, 0.02, 0.005, "nuisance", "rate over which it builds up: tracing study",
            grid=(0.001, 0.005),
        ),
        EffectParameter("presliding_m", "m", 1e-5, 2e-4, 3e-5, grid=(2e-5, 1e-4)),
    ),
    constants=_constants,
    force=force,
    stiffens=_stiffens,
    own_rate_per_s=_own_rate_per_s,
    states=1,
)  # fmt: skip
