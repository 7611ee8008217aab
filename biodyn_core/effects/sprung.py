"""Sprung mass: the law of what sits on a segment by a spring and a damper of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from biodyn_core.effects.effect import Joint


def force(
    x: float, v: float, seat: float, x_own: float, v_own: float, k: float, c: float, omega_squared: float, decay: float
) -> tuple[float, float, float]:
    """The mass's pull on the segment; its displacement and velocity relative to the seat are the states."""
    apart, drift = x_own - x, v_own - v
    return k * apart + c * drift, v_own, -omega_squared * apart - decay * drift - seat


@dataclass(frozen=True)
class SprungMass:
    """What an effect says of a sprung mass: its mass_kg, its damping_ratio, its own frequency, Hz, by a name it has."""

    frequency: str

    def constants(self, joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
        """Stiffness N/m, damping N s/m, both also by the mass."""
        omega, mass = self._omega(values), values["mass_kg"]
        decay = 2.0 * values["damping_ratio"] * omega
        return mass * omega**2, mass * decay, omega**2, decay

    def stiffens(self, joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
        """All of its spring and its damper."""
        stiffness, damping, *_ = self.constants(joint, values)
        return stiffness, damping

    def own_rate_per_s(self, joint: Joint, values: Mapping[str, float]) -> float:
        """The mass against its segment, both free, which is quicker than its spring by itself."""
        heavier = math.sqrt(1.0 + values["mass_kg"] / joint.segment_mass_kg)
        omega, zeta = self._omega(values) * heavier, values["damping_ratio"] * heavier
        return omega * (zeta + math.sqrt(zeta * zeta - 1.0)) if zeta > 1.0 else omega

    def _omega(self, values: Mapping[str, float]) -> float:
        return 2.0 * math.pi * values[self.frequency]
