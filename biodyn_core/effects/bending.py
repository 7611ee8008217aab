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
    across: float,
    k_half_length: float,
    c_length: float,
    cosine: float,
    sine: float,
    leak: float,
    rest: float,
    share: float,
) -> tuple[float, float, float]:
    """F = L (k (phi^2 / 2 + phi phi0 + e psi^2 / 2) + c ((phi + phi0) phi' + e psi psi')); both angles leak.

    Bending by phi shortens the joint by L phi^2 / 2; psi is about the horizontal axis across that of phi.
    """
    turning = cosine * about_x + sine * about_y - leak * angle
    turning_across = cosine * about_y - sine * about_x - leak * across
    spring = k_half_length * (angle * (angle + 2.0 * rest) + share * across * across)
    damper = c_length * ((angle + rest) * turning + share * across * turning_across)
    return spring + damper, turning, turning_across


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    length_m, axis_rad = values["length_m"], values["axis_rad"]
    half_n, damping_n_s = 0.5 * joint.stiffness_n_per_m * length_m, joint.damping_n_s_per_m * length_m
    axis = math.cos(axis_rad), math.sin(axis_rad)
    return half_n, damping_n_s, *axis, LEAK_PER_S, values["rest_rad"], values["across"]


LEAK_PER_S = 0.5
"""Rate of the leak: a slow bend is posture, and a gyro's bias drifts."""

EFFECT = JointForce(
    name="bending",
    family="bending",
    equation="F += L (k phi^2 / 2 + c phi phi'), phi about one axis, from adjacent gyros",
    general_form="F += L (k (phi^2 / 2 + phi phi0 + e psi^2 / 2) + c ((phi + phi0) phi' + e psi psi'))",
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
        EffectParameter("across", "", 0.0, 1.0, 0.0, grid=(0.0, 1.0), neutral=0.0, spread=0.5,
                        source="the neck bends about both horizontal axes; the size: no source"),
    ),
    sites=("neck", "head"),
    constants=_constants,
    law=force,
    states=2,
    channels=("own.bend_rate_x", "own.bend_rate_y"),
    separated_by="turns",
)  # fmt: skip
