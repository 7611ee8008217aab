"""Added mass: a helmet on the head, arms on the upper torso, each on a liner or tissue of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(
    x: float, v: float, seat: float, x_own: float, v_own: float, k: float, c: float, omega_squared: float, decay: float
) -> tuple[float, float, float]:
    """The mass's pull on the segment through its liner, with its displacement and velocity relative to the seat."""
    apart, drift = x_own - x, v_own - v
    return k * apart + c * drift, v_own, -omega_squared * apart - decay * drift - seat


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    omega, mass = 2.0 * math.pi * values["liner_hz"], values["mass_kg"]
    decay = 2.0 * values["damping_ratio"] * omega
    return mass * omega**2, mass * decay, omega**2, decay


def _stiffens(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return _constants(joint, values)[0], _constants(joint, values)[1]


def _own_rate_per_s(joint: Joint, values: Mapping[str, float]) -> float:
    """The mass against its segment, both free, which is quicker than the liner by itself."""
    heavier = math.sqrt(1.0 + values["mass_kg"] / joint.segment_mass_kg)
    omega, zeta = 2.0 * math.pi * values["liner_hz"] * heavier, values["damping_ratio"] * heavier
    return omega * (zeta + math.sqrt(zeta * zeta - 1.0)) if zeta > 1.0 else omega


EFFECT = Effect(
    name="added_mass",
    family="added_mass",
    equation="m (x_m'' + a_s) = -k (x_m - x_i) - c (x_m' - x_i'), k = m (2 pi f)^2, reaction on the segment",
    signature="first seen in the channel below",
    place="segment",
    parameters=(
        EffectParameter("mass_kg", "kg", 0.0, 10.0, 1.5, "strength"),
        # A rigid mass is the upper end, where nothing tells 60 Hz from 80, nor how the liner is damped.
        EffectParameter("liner_hz", "Hz", 12.0, 80.0, 60.0, "nuisance", grid=(20.0, 30.0, 60.0)),
        EffectParameter("damping_ratio", "", 0.05, 0.8, 0.3, "nuisance"),
    ),
    sites=("upper_torso", "head"),
    constants=_constants,
    force=force,
    stiffens=_stiffens,
    own_rate_per_s=_own_rate_per_s,
    states=2,
)
