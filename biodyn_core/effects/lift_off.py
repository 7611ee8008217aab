"""Lift-off: the seat carries no tension.

Known limits. Under `cascade` the joint carries the inertia of a body three times as heavy, and W is the weight of the
body: it lifts off from a third of 1 g on. With a `cushion` the foam is pulled by the force before the limit, so it
rises too far while the body is in the air.
"""

from __future__ import annotations

import math

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.effects.effect import EffectParameter, Joint, JointLimit, Values


def limit(
    force_n: float, rate: float, weight_n: float, width_n: float, damping_n_s_per_m: float, fading_n_s_per_m: float
) -> float:
    """F_1 = W - max(N, 0), rounded within a width of force: N = W - F_1 with a damper that fades where N < W."""
    contact = weight_n - force_n
    if fading_n_s_per_m > 0.0:
        elastic = contact + damping_n_s_per_m * rate
        contact += fading_n_s_per_m * rate * (1.0 - min(max(elastic / weight_n, 0.0), 1.0))
    if width_n > 0.0 and abs(contact) < 30.0 * width_n:
        return weight_n - width_n * math.log1p(math.exp(contact / width_n))
    return weight_n - max(contact, 0.0)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    fading_n_s_per_m = values["fading"] * joint.damping_n_s_per_m
    weight_n = STANDARD_GRAVITY_MPS2 * joint.mass_above_kg
    return weight_n, values["width_n"], joint.damping_n_s_per_m, fading_n_s_per_m


EFFECT = JointLimit(
    name="lift_off",
    family="lift_off",
    equation="F_1 = min(F_1, W), W the weight above the seat",
    general_form="F_1 = W - w ln(1 + exp(N / w)), N = E - b_1 rate (1 - f + f min(max(E, 0) / W, 1))",
    signature="the pelvis falls at -1 g, then an impact",
    parameters=(
        EffectParameter("width_n", "N", 0.0, 100.0, 0.0, neutral=0.0, spread=20.0,
                        source="the buttocks part from the seat gradually; the size: no source"),
        EffectParameter("fading", "", 0.0, 1.0, 0.0, grid=(0.0, 1.0), neutral=0.0, spread=0.5,
                        source="the damper of a contact fades with its elastic force: Hunt and Crossley 1975"),
    ),
    sites=("pelvis",),
    constants=_constants,
    law=limit,
    known_omission=True,
    separated_by="shocks",
)  # fmt: skip
