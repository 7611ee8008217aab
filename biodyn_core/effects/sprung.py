"""Sprung mass: the law of a mass on a segment, by a spring and a damper."""

from __future__ import annotations

import math
from dataclasses import dataclass

from biodyn_core.effects.effect import Joint, Values


def force(
    x: float, v: float, seat: float, x_own: float, v_own: float, k: float, c: float, omega_squared: float, decay: float
) -> tuple[float, float, float]:
    """Force of the mass on the segment; states: its displacement and velocity relative to the seat."""
    apart, drift = x_own - x, v_own - v
    return k * apart + c * drift, v_own, -omega_squared * apart - decay * drift - seat


@dataclass(frozen=True)
class SprungMass:
    """Constants of a sprung mass from mass_kg, damping_ratio and the parameter, in Hz, that `frequency` names."""

    frequency: str

    def constants(self, joint: Joint, values: Values) -> tuple[float, ...]:
        """Stiffness N/m and damping N s/m, then both divided by the mass."""
        omega, mass = self._omega(values), values["mass_kg"]
        decay = 2.0 * values["damping_ratio"] * omega
        return mass * omega**2, mass * decay, omega**2, decay

    def max_added_stiffness_damping(self, joint: Joint, values: Values) -> tuple[float, float]:
        """Stiffness and damping of the spring and the damper."""
        stiffness, damping, *_ = self.constants(joint, values)
        return stiffness, damping

    def max_own_eigenvalue_per_s(self, joint: Joint, values: Values) -> float:
        """The mass against its segment, both free: a higher eigenvalue than with the segment fixed."""
        coupling = math.sqrt(1.0 + values["mass_kg"] / joint.segment_mass_kg)
        omega, zeta = self._omega(values) * coupling, values["damping_ratio"] * coupling
        return omega * (zeta + math.sqrt(zeta * zeta - 1.0)) if zeta > 1.0 else omega

    def _omega(self, values: Values) -> float:
        return 2.0 * math.pi * values[self.frequency]
