"""Added mass: a helmet on the head, arms on the upper torso."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter


def _mass_kg(values: Mapping[str, float]) -> float:
    return values["mass_kg"]


EFFECT = Effect(
    name="added_mass",
    family="added_mass",
    equation="m_i += dm, stiffness and damping as they are",
    signature="first seen in the channel below",
    place="segment",
    parameters=(EffectParameter("mass_kg", "kg", 0.0, 10.0, 1.5, "strength"),),
    sites=("upper_torso", "head"),
    mass_kg=_mass_kg,
)
