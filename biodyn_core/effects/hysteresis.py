"""Bouc-Wen hysteresis in a joint: stiff in small motion, yielding in large."""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values


def force(
    stretch: float, rate: float, seat: float, z: float, yield_n: float, per_m: float, exponent: float, unloading: float
) -> tuple[float, float]:
    """F = alpha z with z' = (rate / d_y) (1 - |z|^n s), s = 1 while it loads and u while it unloads."""
    power = z * z if exponent == 2.0 else abs(z) ** exponent
    bend = power if rate * z > 0.0 else unloading * power
    return yield_n * z, rate * per_m * (1.0 - bend)


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return values["yield_n"], 1.0 / values["yield_m"], values["exponent"], values["unloading"]


def _max_added_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return values["yield_n"] / values["yield_m"], 0.0


EFFECT = JointForce(
    name="hysteresis",
    family="dry_friction",
    variant_of="dry_friction",
    equation="F += alpha z, z' = (rate / d_y) (1 - z^2 (.5 + .5 sgn(rate z)))",
    general_form="F += alpha z, z' = (rate / d_y) (1 - |z|^n s), s = 1 if rate z > 0, else u",
    signature="stiff at small amplitude",
    parameters=(
        EffectParameter("yield_n", "N", 0.0, 500.0, 20.0, "strength"),
        EffectParameter("yield_m", "m", 1.5e-4, 5e-3, 5e-4, reach_shares=(0.06, 0.2, 0.5)),
        EffectParameter("exponent", "", 1.0, 6.0, 2.0, neutral=2.0, spread=1.5,
                        source="1 to 6: Ismail, Ikhouane and Rodellar 2009 (Arch. Comput. Methods Eng. 16)"),
        EffectParameter("unloading", "", -0.9, 0.9, 0.0, neutral=0.0, spread=0.4,
                        source="beta - gamma over beta + gamma of Bouc and Wen; the size: no source"),
    ),
    constants=_constants,
    law=force,
    max_added_stiffness_damping=_max_added_stiffness_damping,
    states=1,
)  # fmt: skip
