"""Bending: the spine bends between two gyros, and a bent column is shorter."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.effects.effect import Effect, EffectParameter, Joint


def force(
    stretch: float,
    rate: float,
    seat: float,
    above: float,
    below: float,
    angle: float,
    k_half_length: float,
    leak: float,
) -> tuple[float, float]:
    """F = k (L / 2) phi^2, phi the leaky integral of the rates' difference: a bent joint is shorter, so in tension."""
    return k_half_length * angle * angle, above - below - leak * angle


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * 0.5 * values["length_m"], LEAK_PER_S


LEAK_PER_S = 0.5
"""A slow lean is posture, and no gyro's bias is known for ever."""

EFFECT = Effect(
    name="bending",
    family="bending",
    equation="F += k (L / 2) phi^2, phi from adjacent gyros",
    signature="at twice the frequency of the bending",
    place="joint",
    parameters=(EffectParameter("length_m", "m", 0.0, 0.8, 0.2, "strength"),),
    sites=("neck",),
    constants=_constants,
    force=force,
    states=1,
    channels=("neck.rate_y", "upper_torso.rate_y"),
)
