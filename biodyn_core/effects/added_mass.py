"""Added mass: a helmet on the head, arms on the upper torso, each on a liner or tissue of its own."""

from __future__ import annotations

from typing import Final

from biodyn_core.effects.effect import EffectParameter, SegmentForce
from biodyn_core.effects.sprung import SprungMass, force

MASS: Final = SprungMass("liner_hz")

EFFECT = SegmentForce(
    name="added_mass",
    family="added_mass",
    variant_of="sprung_mass",
    equation="m (x_m'' + a_s) = -k (x_m - x_i) - c (x_m' - x_i'), k = m (2 pi f)^2, reaction on the segment",
    general_form=(
        "k (1 + |x_m - x_i| / L)^q, L = 10 mm, and from the mass to the seat a spring m (2 pi f_h)^2 with a damper of"
        " 0.01 s times it"
    ),
    signature="first visible in the channel below",
    parameters=(
        EffectParameter("mass_kg", "kg", 0.0, 10.0, 1.5, "strength"),
        # The upper end is a rigid mass: data do not separate 60 Hz from 80 Hz there, nor determine the damping.
        EffectParameter("liner_hz", "Hz", 12.0, 80.0, 60.0, "nuisance", grid=(20.0, 30.0, 60.0)),
        EffectParameter("damping_ratio", "", 0.05, 0.8, 0.3, "nuisance"),
        EffectParameter("exponent", "", -2.0, 3.0, 0.0, neutral=0.0, spread=1.0,
                        source="a liner hardens; the size: no source"),
        EffectParameter("held_hz", "Hz", 0.0, 12.0, 0.0, grid=(0.0, 4.0), neutral=0.0, spread=3.0,
                        source="hands on a wheel hold the arms; the size: no source"),
    ),
    sites=("upper_torso", "head"),
    constants=MASS.constants,
    law=force,
    carried_kg=MASS.carried_kg,
    max_added_stiffness_damping=MASS.max_added_stiffness_damping,
    max_own_eigenvalue_per_s=MASS.max_own_eigenvalue_per_s,
    states=2,
    separated_by="bare",
)  # fmt: skip
