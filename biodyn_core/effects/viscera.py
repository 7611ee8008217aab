"""Viscera: a mass that hangs on a torso segment by a spring and a damper of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(
    x: float, v: float, seat: float, x_own: float, v_own: float, k: float, c: float, omega_squared: float, decay: float
) -> tuple[float, float, float]:
    """The resonator's pull on the segment, with its own displacement and velocity relative to the seat as states."""
    pull = k * (x_own - x) + c * (v_own - v)
    return pull, v_own, -omega_squared * (x_own - x) - decay * (v_own - v) - seat


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    omega, mass = 2.0 * math.pi * values["natural_frequency_hz"], values["mass_kg"]
    decay = 2.0 * values["damping_ratio"] * omega
    return mass * omega**2, mass * decay, omega**2, decay


def _stiffens(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return _constants(joint, values)[0], _constants(joint, values)[1]


EFFECT = Effect(
    name="viscera",
    family="memory",
    equation="m_v (x_v'' + a_s) = -k_v (x_v - x_i) - c_v (x_v' - x_i'), reaction on the segment",
    signature="a dip and a peak at 4 to 6 Hz",
    place="segment",
    parameters=(
        EffectParameter("mass_kg", "kg", 0.0, 12.0, 5.0, "strength"),
        EffectParameter("natural_frequency_hz", "Hz", 2.5, 10.0, 4.5, grid=(3.5, 4.5, 6.0)),
        EffectParameter("damping_ratio", "", 0.05, 0.6, 0.25),
    ),
    sites=("lower_torso", "central_torso", "upper_torso"),
    constants=_constants,
    force=force,
    stiffens=_stiffens,
    states=2,
)
