"""Reflex: muscles respond to the stretch of a joint after a delay."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

LEAST_LAG_S = 0.002
"""The lag of a law with a lead is at least this: the rate of the delayed stretch is that of its lag."""


def force(
    stretch: float,
    rate: float,
    seat: float,
    stretched: float,
    half_lagged: float,
    lagged: float,
    k_gain: float,
    per_lag: float,
    lead_s: float,
    saturation_per_m: float,
) -> tuple[float, float, float]:
    """F = k g y / sqrt(1 + (y / y0)^2), y = stretch(t - tau) (1 + h s) / (1 + T s)^2; states: the two lags."""
    response = stretched
    fall = rise = 0.0
    if per_lag > 0.0:
        rise, fall = per_lag * (stretched - half_lagged), per_lag * (half_lagged - lagged)
        response = lagged + lead_s * fall
    if saturation_per_m > 0.0:
        response /= math.sqrt(1.0 + (saturation_per_m * response) ** 2)
    return k_gain * response, rise, fall


def _per_lag(values: Values) -> float:
    return 1.0 / (values["lag_s"] + LEAST_LAG_S) if values["lag_s"] > 0.0 or values["lead_s"] != 0.0 else 0.0


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    k_gain = joint.stiffness_n_per_m * values["gain"]
    return k_gain, _per_lag(values), values["lead_s"], values["saturation_per_m"]


def _max_own_eigenvalue_per_s(joint: Joint, values: Values) -> float:
    return _per_lag(values)


EFFECT = JointForce(
    name="reflex",
    family="memory",
    equation="F += k g stretch(t - tau)",
    general_form="F += k g y / sqrt(1 + (y / y0)^2), y = stretch(t - tau) (1 + h s) / (1 + T s)^2, T = lag + 2 ms",
    signature="a ripple of the phase at 3 to 8 Hz",
    parameters=(
        EffectParameter("gain", "", 0.0, 1.5, 0.2, "strength"),
        EffectParameter(
            "delay_s", "s", 0.03, 0.15, 0.08, source="97 to 104 ms in standing balance; the rest: no source",
            grid=(0.05, 0.08, 0.11),
        ),
        EffectParameter("lag_s", "s", 0.0, 0.08, 0.0, grid=(0.0, 0.03), neutral=0.0, spread=0.03,
                        source="a muscle lags its activation; the size: no source"),
        EffectParameter("lead_s", "s", 0.0, 0.5, 0.0, grid=(0.0, 0.05), neutral=0.0, spread=0.06,
                        source="spindles respond to the rate too; the size: no source"),
        EffectParameter("saturation_per_m", "1/m", 0.0, 1000.0, 0.0, neutral=0.0, spread=200.0,
                        source="muscle force is limited; the size: no source"),
    ),
    constants=_constants,
    law=force,
    states=2,
    max_own_eigenvalue_per_s=_max_own_eigenvalue_per_s,
    delay="delay_s",
)  # fmt: skip
