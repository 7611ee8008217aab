"""Constants of joints and segments from theta, of one body or of many at once (Zaman et al., Eq. 5-16)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MASS_FRACTION, STIFFENING_SHAPE_PER_M
from biodyn_core.body.parameters import DAMPINGS, FREQUENCIES, MASS_SCALE, RAYLEIGH, STIFFENING
from biodyn_core.body.subject import MassMatrix


@dataclass(frozen=True)
class Constants:
    """Physical constants, each (..., 6), joints and segments inferior to superior; rayleigh_rad_per_s is (...).

    mass_kg are the segments' masses; inertia_kg is the diagonal of M, equal to them unless M is the `cascade`.
    """

    mass_kg: Floats
    inertia_kg: Floats
    stiffness_n_per_m: Floats
    damping_n_s_per_m: Floats
    stiffening_per_m: Floats
    rayleigh_rad_per_s: Floats

    @classmethod
    def of(cls, theta: Floats, body_mass_kg: float, mass_matrix: MassMatrix) -> Constants:
        """The constants of theta (..., 15), which may lie outside Table 1 (Eq. 5-8, 10-12, 16)."""
        mass = theta[..., MASS_SCALE, None] * MASS_FRACTION * body_mass_kg
        cascade = np.ascontiguousarray(np.cumsum(mass[..., ::-1], axis=-1)[..., ::-1])
        # Stiffness and damping come from the cascade masses under both conventions of M (Eq. 8, 11).
        stiffness = (2.0 * np.pi * theta[..., FREQUENCIES]) ** 2 * cascade
        return cls(
            mass_kg=mass,
            inertia_kg=mass if mass_matrix == "segment" else cascade,
            stiffness_n_per_m=stiffness,
            damping_n_s_per_m=2.0 * theta[..., DAMPINGS] * np.sqrt(stiffness * cascade),
            stiffening_per_m=theta[..., STIFFENING, None] * STIFFENING_SHAPE_PER_M,
            rayleigh_rad_per_s=theta[..., RAYLEIGH],
        )
