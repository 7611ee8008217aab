"""Periodic force: an engine line that acts on the body past the seat."""

from __future__ import annotations

import math
from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(
    x: float, v: float, seat: float, time_s: float, force_n: float, omega: float, phase: float
) -> tuple[float, float]:
    """F = m (A cos wt + B sin wt), as one cosine; its state is the time since the recording's begin."""
    return force_n * math.cos(omega * time_s - phase), 1.0


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    cosine, sine = values["cosine_mps2"], values["sine_mps2"]
    omega = 2.0 * math.pi * values["frequency_hz"]
    return joint.segment_mass_kg * math.hypot(cosine, sine), omega, math.atan2(sine, cosine)


EFFECT = Effect(
    name="periodic",
    family="periodic",
    equation="F += m (A cos wt + B sin wt)",
    signature="a line in the spectrum, at standstill too",
    place="segment",
    parameters=(
        EffectParameter("cosine_mps2", "m/s^2", -2.0, 2.0, 0.2, "strength"),
        EffectParameter("sine_mps2", "m/s^2", -2.0, 2.0, 0.0, "strength", acts_at=0.2),
        EffectParameter("frequency_hz", "Hz", 10.0, 80.0, 30.0),
    ),
    constants=_constants,
    force=force,
    states=1,
)
