"""Cross-axis coupling: horizontal motion of the seat causes a vertical force on one segment, or on all (site seat)."""

from __future__ import annotations

import math

from biodyn_core.base.segments import SEAT, SEGMENTS
from biodyn_core.effects.effect import EffectParameter, Joint, SegmentForce, Values


def force(
    x: float,
    v: float,
    seat: float,
    forward: float,
    left: float,
    lagged: float,
    coupled: float,
    m_forward: float,
    m_left: float,
    corner_per_s: float,
    less_damped: float,
) -> tuple[float, float, float]:
    """F = m (beta_x a_x + beta_y a_y) low-passed by two poles at w and zeta: the coupling tissue is soft."""
    direct = m_forward * forward + m_left * left
    rise = lagged - coupled
    return coupled, corner_per_s * (direct - lagged + less_damped * rise), corner_per_s * rise


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    mass_kg = joint.segment_mass_kg
    return (
        mass_kg * values["beta_x"],
        mass_kg * values["beta_y"],
        2.0 * math.pi * values["corner_hz"],
        2.0 - 2.0 * values["damping_ratio"],
    )


def _max_own_eigenvalue_per_s(joint: Joint, values: Values) -> float:
    zeta = values["damping_ratio"]
    return 2.0 * math.pi * values["corner_hz"] * (zeta + math.sqrt(max(zeta * zeta - 1.0, 0.0)))


EFFECT = SegmentForce(
    name="cross_axis",
    family="horizontal",
    equation="F += m (beta_x a_x + beta_y a_y) / (1 + s / w)^2",
    general_form="1 / (1 + 2 zeta s / w + (s / w)^2)",
    signature="coherent with the seat's horizontal motion",
    sites=(SEAT, *SEGMENTS),
    parameters=(
        EffectParameter("beta_x", "", -0.6, 0.6, 0.15, "strength"),
        EffectParameter("beta_y", "", -0.6, 0.6, 0.0, "strength", acts_at=0.15),
        EffectParameter("corner_hz", "Hz", 1.0, 100.0, 50.0, grid=(5.0, 50.0)),
        EffectParameter("damping_ratio", "", 0.2, 1.5, 1.0, grid=(0.4, 1.0), neutral=1.0, spread=0.4,
                        source="the spine resonates when it bends; the size: no source"),
    ),
    constants=_constants,
    law=force,
    max_own_eigenvalue_per_s=_max_own_eigenvalue_per_s,
    states=2,
    channels=("seat.x", "seat.y"),
    separated_by="turns",
)  # fmt: skip
