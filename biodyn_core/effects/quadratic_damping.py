"""Quadratic damping: damping that grows with the rate.

Known limit: the integration step does not account for it. With a growth above about 50 s/m, a shock of 8 g can make the
simulation wrong or unstable; with 200 s/m, one of 3 g.
"""

from __future__ import annotations

from biodyn_core.effects.effect import EffectParameter, Joint, JointForce, Values

BEND_MPS = 0.02
"""Rate from which the exponent is visible."""


def force(stretch: float, rate: float, seat: float, c_2: float, exponent: float, per_mps: float) -> float:
    """F = c_2 rate |rate| (1 + |rate| / V)^q."""
    square = c_2 * rate * abs(rate)
    return square if exponent == 0.0 else square * (1.0 + abs(rate) * per_mps) ** exponent


def _constants(joint: Joint, values: Values) -> tuple[float, ...]:
    return joint.damping_n_s_per_m * values["growth_s_per_m"], values["exponent"], 1.0 / BEND_MPS


EFFECT = JointForce(
    name="quadratic_damping",
    family="quadratic_damping",
    equation="F += b g rate |rate|",
    general_form="F += b g rate |rate| (1 + |rate| / V)^q, V = 20 mm/s",
    signature="peaks of shocks over-predicted, the road well",
    parameters=(
        EffectParameter("growth_s_per_m", "s/m", 0.0, 200.0, 2.0, "strength"),
        EffectParameter("exponent", "", -1.5, 1.0, 0.0, grid=(-0.7, 0.0), neutral=0.0, spread=0.8,
                        source="powers of the rate from 0.5 to 4; the size: no source"),
    ),
    constants=_constants,
    law=force,
)  # fmt: skip
