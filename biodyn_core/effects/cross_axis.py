"""Cross-axis coupling: horizontal motion of the seat that shows as vertical force on a segment, or on all (seat)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from biodyn_core.base.segments import SEAT, SEGMENTS
from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(
    x: float,
    v: float,
    seat: float,
    forward: float,
    left: float,
    behind: float,
    felt: float,
    m_forward: float,
    m_left: float,
    corner_per_s: float,
) -> tuple[float, float, float]:
    """F = m (beta_x a_x + beta_y a_y) behind two poles at w: what couples is soft."""
    pushed = m_forward * forward + m_left * left
    return felt, corner_per_s * (pushed - behind), corner_per_s * (behind - felt)


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    mass_kg = joint.segment_mass_kg
    return mass_kg * values["beta_x"], mass_kg * values["beta_y"], 2.0 * math.pi * values["corner_hz"]


def _own_rate_per_s(joint: Joint, values: Mapping[str, float]) -> float:
    return 2.0 * math.pi * values["corner_hz"]


EFFECT = Effect(
    name="cross_axis",
    family="horizontal",
    equation="F += m (beta_x a_x + beta_y a_y) / (1 + s / w)^2",
    signature="coherent with the seat's horizontal motion",
    place="segment",
    sites=(SEAT, *SEGMENTS),
    parameters=(
        EffectParameter("beta_x", "", -0.6, 0.6, 0.15, "strength"),
        EffectParameter("beta_y", "", -0.6, 0.6, 0.0, "strength", acts_at=0.15),
        EffectParameter("corner_hz", "Hz", 1.0, 100.0, 50.0, grid=(5.0, 50.0)),
    ),
    constants=_constants,
    force=force,
    own_rate_per_s=_own_rate_per_s,
    states=2,
    channels=("seat.x", "seat.y"),
)  # fmt: skip
