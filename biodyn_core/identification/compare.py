"""Comparison of two subjects, parameter by parameter: which values agree and which differ.

Zaman et al., 9.1.1 and 9.1.2, Tables 6 and 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, Effect, active
from biodyn_core.identification.settings import THRESHOLD_PERCENT


@dataclass(frozen=True)
class Deviation:
    """One quantity of two subjects; `segment` names the joint below it, None for a quantity of the whole body."""

    quantity: str
    segment: str | None
    unit: str
    a: float
    b: float

    @property
    def percent(self) -> float:
        """|b - a| / a in percent; infinite where only a is zero."""
        if self.a == self.b:
            return 0.0
        return 100.0 * abs(self.b - self.a) / self.a if self.a > 0.0 else math.inf


@dataclass(frozen=True)
class SubjectComparison:
    """Quantities of two subjects that agree (convergent) and differ (divergent), in the order of theta.

    Stiffness and stiffening follow theta. The share of a deviation that comes from uncertainty of the fits is unknown.
    """

    a: Subject
    b: Subject
    threshold_percent: float
    convergent: tuple[Deviation, ...]
    divergent: tuple[Deviation, ...]

    @property
    def has_same_effects(self) -> bool:
        """Whether both have the same effects on the body: beside another effect a parameter has another meaning."""
        one, other = ({(a.effect.name, a.site): a.values for a in body_effects(of)} for of in (self.a, self.b))
        return one == other


def compare(a: Subject, b: Subject, threshold_percent: float = THRESHOLD_PERCENT) -> SubjectComparison:
    """Classify every quantity by its deviation from a, below the threshold or not (Tables 6 and 7).

    Raises InputError for a threshold that is not positive, and for subjects of different mass matrices.
    """
    if not (math.isfinite(threshold_percent) and threshold_percent > 0.0):
        raise InputError(f"the threshold is {threshold_percent:g} %, expected a positive number")
    if a.mass_matrix != b.mass_matrix:
        raise InputError(
            f"{a.name} has mass_matrix {a.mass_matrix}, {b.name} {b.mass_matrix}: these are parameters of different"
            " models; compare subjects fitted with the same one"
        )
    values_of_b = _values(b)
    rows = [Deviation(*key, value, values_of_b[key]) for key, value in _values(a).items()]
    return SubjectComparison(
        a,
        b,
        threshold_percent,
        convergent=tuple(row for row in rows if row.percent < threshold_percent),
        divergent=tuple(row for row in rows if not row.percent < threshold_percent),
    )


def body_effects(subject: Subject) -> list[AppliedEffect]:
    """The effects of a subject on body and seat; those on sensors change no prediction."""
    return [one for one, effect in active(subject.effects, Effect) if effect.place != "sensor"]


def _values(subject: Subject) -> dict[tuple[str, str | None, str], float]:
    """Values by quantity, segment and unit: theta, then the stiffness and the stiffening of each joint."""
    p, chain = subject.parameters, Chain.of(subject)
    found = {(q.group, q.segment, q.unit): float(v) for q, v in zip(PARAMETERS, p.vector(), strict=True)}
    # Tables 4 to 7 have k without m_scale, which has its own row.
    joints = {("stiffness_n_per_m", "N/m"): chain.stiffness_n_per_m / p.mass_scale}
    joints["stiffening_per_m", "1/m"] = chain.stiffening_per_m
    for (quantity, unit), values in joints.items():
        found |= {(quantity, name, unit): float(v) for name, v in zip(SEGMENTS, values, strict=True)}
    return found
