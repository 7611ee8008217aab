"""Asymmetry: a joint that is stiffer in compression than in tension, or the other way round."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

BEND_M = 0.001
"""Stretch from which the exponent is visible."""


def force(stretch: float, rate: float, seat: float, k_a: float, exponent: float, per_m: float) -> float:
    """F = k a stretch^2 (1 + |stretch| / L)^q."""
    square = k_a * stretch * stretch
    return square if exponent == 0.0 else square * (1.0 + abs(stretch) * per_m) ** exponent


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.stiffness_n_per_m * values["asymmetry_per_m"], values["exponent"], 1.0 / BEND_M


EFFECT = JointForce(
    name="asymmetry",
    family="stiffening",
    variant_of="nonlinear_stiffness",
    equation="F += k a stretch^2",
    general_form="F += k a stretch^2 (1 + |stretch| / L)^q, L = 1 mm",
    signature="a shift of the level and a second harmonic, in shocks only",
    parameters=(
        EffectParameter("asymmetry_per_m", "1/m", -200.0, 200.0, 10.0, "strength"),
        EffectParameter("exponent", "", -2.0, 1.0, 0.0, grid=(-1.0, 0.0, 1.0), neutral=0.0, spread=1.0,
                        source="-1: a bilinear joint; above 0: tissue of Fung's kind; the size: no source"),
    ),
    constants=_constants,
    law=force,
    separated_by="shocks",
)  # fmt: skip
