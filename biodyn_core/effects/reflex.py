"""Reflex: muscles respond to the stretch of a joint after a delay."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(stretch: float, rate: float, seat: float, stretched: float, k_gain: float) -> float:
    """F = k g stretch(t - tau)."""
    return k_gain * stretched


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return (joint.stiffness_n_per_m * values["gain"],)


EFFECT = JointForce(
    name="reflex",
    family="memory",
    equation="F += k g stretch(t - tau)",
    signature="a ripple of the phase at 3 to 8 Hz",
    parameters=(
        EffectParameter("gain", "", 0.0, 0.5, 0.2, "strength"),
        EffectParameter(
            "delay_s", "s", 0.03, 0.15, 0.08, source="97 to 104 ms in standing balance; the rest: no source",
            grid=(0.05, 0.08, 0.11),
        ),
    ),
    constants=_constants,
    law=force,
    delay="delay_s",
)  # fmt: skip
