"""Sprung mass: the law of a mass on a segment, by a spring and a damper."""

from __future__ import annotations

import math
from dataclasses import dataclass

from biodyn_core.effects.effect import Joint, Values


def force(
    x: float, v: float, seat: float, x_own: float, v_own: float, k: float, c: float, omega_squared: float, decay: float,
    exponent: float, per_m: float, held: float, held_decay: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Force of the mass on the segment; states: its displacement and velocity relative to the seat."""
    apart, drift = x_own - x, v_own - v
    if exponent != 0.0:
        apart *= (1.0 + abs(apart) * per_m) ** exponent
    own = -omega_squared * apart - decay * drift - held * x_own - held_decay * v_own
    return k * apart + c * drift, v_own, own - seat


BEND_M = 0.01
"""Stretch of the spring from which its exponent is visible."""

HELD_DAMPING_S = 0.01
"""Damping of the spring to the seat over its stiffness."""


@dataclass(frozen=True)
class SprungMass:
    """Constants of a sprung mass from mass_kg, damping_ratio and the parameter, in Hz, that `frequency` names."""

    frequency: str

    def constants(self, joint: Joint, values: Values) -> tuple[float, ...]:
        """Stiffness N/m and damping N s/m, both divided by the mass, the hardening, and the spring to the seat."""
        omega, mass = self._omega(values), values["mass_kg"]
        decay = 2.0 * values["damping_ratio"] * omega
        held = (2.0 * math.pi * values.get("held_hz", 0.0)) ** 2
        bend = values["exponent"], 1.0 / BEND_M
        return mass * omega**2, mass * decay, omega**2, decay, *bend, held, held * HELD_DAMPING_S

    def carried_kg(self, values: Values) -> float:
        """The mass itself: the chain carries its weight."""
        return values["mass_kg"]

    def max_added_stiffness_damping(self, joint: Joint, values: Values) -> tuple[float, float]:
        """Stiffness and damping of the spring and the damper."""
        stiffness, damping, *_ = self.constants(joint, values)
        return stiffness, damping

    def max_own_eigenvalue_per_s(self, joint: Joint, values: Values) -> float:
        """The mass against its segment, both free: a higher eigenvalue than with the segment fixed."""
        coupling = math.sqrt(1.0 + values["mass_kg"] / joint.segment_mass_kg)
        omega, zeta = self._omega(values) * coupling, values["damping_ratio"] * coupling
        own = omega * (zeta + math.sqrt(zeta * zeta - 1.0)) if zeta > 1.0 else omega
        return own + 2.0 * math.pi * values.get("held_hz", 0.0)

    def _omega(self, values: Values) -> float:
        return 2.0 * math.pi * values[self.frequency]
