"""Cross-axis coupling: fore-aft and lateral motion of the seat that shows as vertical force on a segment."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(x: float, v: float, seat: float, forward: float, left: float, m_forward: float, m_left: float) -> float:
    """F = m (beta_x a_x + beta_y a_y)."""
    return m_forward * forward + m_left * left


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return joint.segment_mass_kg * values["beta_x"], joint.segment_mass_kg * values["beta_y"]


EFFECT = Effect(
    name="cross_axis",
    family="horizontal",
    equation="F += m (beta_x a_x + beta_y a_y)",
    signature="coherent with the seat's horizontal motion",
    place="segment",
    parameters=(
        EffectParameter("beta_x", "", -0.6, 0.6, 0.15, "strength"),
        EffectParameter("beta_y", "", -0.6, 0.6, 0.0, "strength", acts_at=0.15),
    ),
    constants=_constants,
    force=force,
    channels=("seat.x", "seat.y"),
)
