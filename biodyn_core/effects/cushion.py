"""Cushion: foam with mass between the measured seat and the pelvis."""

from __future__ import annotations

import math

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(
    stretch: float,
    rate: float,
    seat: float,
    x_foam: float,
    v_foam: float,
    creep: float,
    k: float,
    k_alpha: float,
    b: float,
    k_foam: float,
    hardening: float,
    c_foam: float,
    per_kg: float,
    k_creep: float,
    per_s: float,
) -> tuple[float, float, float, float]:
    """The force of the pelvis joint on the foam's top, less that on the bare seat.

    States: motion of the foam, and of the damper in series with its second spring.
    """
    d = stretch - x_foam
    through = d * (k + k_alpha * abs(d)) + b * (rate - v_foam)
    bare = stretch * (k + k_alpha * abs(stretch)) + b * rate
    own = x_foam * (k_foam + hardening * abs(x_foam)) + c_foam * v_foam + k_creep * (x_foam - creep)
    return through - bare, v_foam, (through - own) * per_kg - seat, (x_foam - creep) * per_s


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    stiffness = 1.0 / values["compliance_m_per_n"]
    foam = (
        stiffness, stiffness * values["stiffening_per_m"], stiffness * values["damping_s"], 1.0 / values["mass_kg"],
        stiffness * values["creep_ratio"], 1.0 / values["creep_s"],
    )  # fmt: skip
    return joint.stiffness_n_per_m, joint.stiffening_n_per_m2, joint.damping_n_s_per_m, *foam


def _max_own_eigenvalue_per_s(joint: Joint, values: Values) -> float:
    """The foam's mass between its own spring and damper and the pelvis joint's."""
    stiffness = joint.stiffness_n_per_m + (1.0 + values["creep_ratio"]) / values["compliance_m_per_n"]
    damping = joint.damping_n_s_per_m + values["damping_s"] / values["compliance_m_per_n"]
    half, square = 0.5 * damping / values["mass_kg"], stiffness / values["mass_kg"]
    return half + math.sqrt(half * half - square) if half * half > square else math.sqrt(square)


EFFECT = JointForce(
    name="cushion",
    family="cushion",
    equation="m_c (x_c'' + a_s) = F_1 - k_c x_c (1 + a |x_c|) - c_c x_c', F_1 from the stretch x_1 - x_c",
    general_form="a further force k_c r (x_c - q) on the foam, q' = (x_c - q) / tau",
    signature="all channels, 5 to 30 Hz",
    parameters=(
        # Foam of 10 MN/m and more is as stiff as the seat: it changes the pelvis joint by 1 % at most.
        EffectParameter("compliance_m_per_n", "m/N", 0.0, 4e-5, 1e-5, "strength", least=1e-7),
        EffectParameter("damping_s", "s", 0.001, 0.05, 0.01),
        # Data hardly determine the mass, and foam without mass is possible; a smaller mass needs shorter steps.
        EffectParameter("mass_kg", "kg", 1.0, 8.0, 3.0, "nuisance"),
        EffectParameter(
            "stiffening_per_m", "1/m", -10.0, 80.0, 0.0,
            source="foam yields, then hardens: Hu et al. 2020 (BioResources 15); the size: no source",
        ),
        EffectParameter("creep_ratio", "", 0.0, 3.0, 0.0, grid=(0.0, 0.7), neutral=0.0, spread=0.7,
                        source="foam relaxes: standard linear solid; the size: no source"),
        EffectParameter("creep_s", "s", 0.003, 1.0, 0.05, neutral=0.05, spread=0.3,
                        source="as creep_ratio"),
    ),
    sites=("pelvis",),
    constants=_constants,
    law=force,
    max_own_eigenvalue_per_s=_max_own_eigenvalue_per_s,
    states=3,
)  # fmt: skip
