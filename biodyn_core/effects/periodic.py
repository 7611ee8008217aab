"""Periodic force: an engine line that acts on the body directly."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, SegmentForce, Values


def force(
    x: float, v: float, seat: float, time_s: float, force_n: float, omega: float, phase: float
) -> tuple[float, float]:
    """F = m (A cos wt + B sin wt), as one cosine; the state is the time from the start of the recording."""
    return force_n * math.cos(omega * time_s - phase), 1.0


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    cosine, sine = values["cosine_mps2"], values["sine_mps2"]
    omega = 2.0 * math.pi * values["frequency_hz"]
    return joint.segment_mass_kg * math.hypot(cosine, sine), omega, math.atan2(sine, cosine)


EFFECT = SegmentForce(
    name="periodic",
    family="periodic",
    equation="F += m (A cos wt + B sin wt)",
    signature="a line in the spectrum, at standstill too",
    parameters=(
        EffectParameter("cosine_mps2", "m/s^2", -2.0, 2.0, 0.2, "strength"),
        EffectParameter("sine_mps2", "m/s^2", -2.0, 2.0, 0.0, "strength", acts_at=0.2),
        EffectParameter("frequency_hz", "Hz", 10.0, 80.0, 30.0),
    ),
    constants=_constants,
    law=force,
    states=1,
    varies_as="line",
    separated_by="standstill",
)
