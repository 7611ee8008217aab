"""Bending: a spine that bends between two gyros becomes shorter."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(
    stretch: float,
    rate: float,
    seat: float,
    about_x: float,
    about_y: float,
    angle: float,
    k_half_length: float,
    c_length: float,
    cosine: float,
    sine: float,
    leak: float,
    rest: float,
) -> tuple[float, float]:
    """F = L (k (phi^2 / 2 + phi phi0) + c (phi + phi0) phi'): bending shortens the joint by L phi^2 / 2; phi leaks."""
    turning = cosine * about_x + sine * about_y - leak * angle
    return (k_half_length * (angle + 2.0 * rest) + c_length * turning) * angle + c_length * turning * rest, turning


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    length_m, axis_rad = values["length_m"], values["axis_rad"]
    half_n, damping_n_s = 0.5 * joint.stiffness_n_per_m * length_m, joint.damping_n_s_per_m * length_m
    return half_n, damping_n_s, math.cos(axis_rad), math.sin(axis_rad), LEAK_PER_S, values["rest_rad"]


LEAK_PER_S = 0.5
"""Rate of the leak: a slow bend is posture, and a gyro's bias drifts."""

EFFECT = JointForce(
    name="bending",
    family="bending",
    equation="F += L (k phi^2 / 2 + c phi phi'), phi about one axis, from adjacent gyros",
    general_form="F += L (k (phi^2 / 2 + phi phi0) + c (phi + phi0) phi')",
    signature="at twice the frequency of the bending",
    parameters=(
        EffectParameter("length_m", "m", 0.0, 0.8, 0.2, "strength"),
        # Half a turn covers every axis; the range is twice that, so that no axis lies on an end.
        EffectParameter(
            "axis_rad", "rad", -0.5 * math.pi, 1.5 * math.pi, 0.5 * math.pi, "nuisance",
            grid=(0.0, 0.25 * math.pi, 0.5 * math.pi, 0.75 * math.pi),
        ),
        EffectParameter("rest_rad", "rad", -0.6, 0.6, 0.0, grid=(-0.15, 0.0, 0.15), neutral=0.0, spread=0.2,
                        source="the neck leans forward at rest; the size: no source"),
    ),
    sites=("neck", "head"),
    constants=_constants,
    law=force,
    states=1,
    channels=("own.bend_rate_x", "own.bend_rate_y"),
    separated_by="turns",
)  # fmt: skip
