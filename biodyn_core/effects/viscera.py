"""Viscera: a mass on a torso segment, by a spring and a damper."""

from __future__ import annotations

from typing import Final

from biodyn_core.effects.effect import EffectParameter, SegmentForce
from biodyn_core.effects.sprung import SprungMass, force

MASS: Final = SprungMass("natural_frequency_hz")

EFFECT = SegmentForce(
    name="viscera",
    family="memory",
    variant_of="sprung_mass",
    equation="m_v (x_v'' + a_s) = -k_v (x_v - x_i) - c_v (x_v' - x_i'), reaction on the segment",
    general_form="k_v (1 + |x_v - x_i| / L)^q, L = 10 mm",
    signature="a dip and a peak at 4 to 6 Hz",
    parameters=(
        EffectParameter("mass_kg", "kg", 0.0, 12.0, 5.0, "strength"),
        EffectParameter("natural_frequency_hz", "Hz", 2.5, 10.0, 4.5, grid=(3.5, 4.5, 6.0)),
        EffectParameter("damping_ratio", "", 0.05, 0.6, 0.25),
        EffectParameter("exponent", "", -2.0, 3.0, 0.0, neutral=0.0, spread=1.0,
                        source="organs are held by tissue that hardens; the size: no source"),
    ),
    sites=("lower_torso", "central_torso", "upper_torso"),
    constants=MASS.constants,
    law=force,
    carried_kg=MASS.carried_kg,
    max_added_stiffness_damping=MASS.max_added_stiffness_damping,
    max_own_eigenvalue_per_s=MASS.max_own_eigenvalue_per_s,
    states=2,
)  # fmt: skip
