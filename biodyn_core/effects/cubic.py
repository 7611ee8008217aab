"""Cubic stiffening: a joint that stiffens with the square of its stretch."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

BEND_M = 0.001
"""Stretch from which the exponent is visible."""


def force(stretch: float, rate: float, seat: float, k_c: float, exponent: float, per_m: float) -> float:
    """F = k c stretch^3 (1 + |stretch| / L)^q."""
    cube = k_c * stretch * stretch * stretch
    return cube if exponent == 0.0 else cube * (1.0 + abs(stretch) * per_m) ** exponent


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * values["cubic_per_m2"], values["exponent"], 1.0 / BEND_M


EFFECT = JointForce(
    name="cubic",
    family="stiffening",
    variant_of="nonlinear_stiffness",
    equation="F += k c stretch^3",
    general_form="F += k c stretch^3 (1 + |stretch| / L)^q, L = 1 mm",
    signature="shocks only, growing with the cube of the level",
    parameters=(
        EffectParameter("cubic_per_m2", "1/m^2", 0.0, 1e6, 300.0, "strength"),
        EffectParameter("exponent", "", -2.0, 3.0, 0.0, grid=(-1.0, 0.0), neutral=0.0, spread=1.0,
                        source="powers of the stretch from 1 to 6; the size: no source"),
    ),
    constants=_constants,
    law=force,
    separated_by="shocks",
)  # fmt: skip
