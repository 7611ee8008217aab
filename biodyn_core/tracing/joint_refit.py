"""Joint refit: theta and all effects of a subject fitted together to all events, without nuisance parameters.

Local fits have nuisance parameters. The resulting subject and the reported errors have none.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, EffectParameter, Ranges, logistic
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.phase2 import interior, mapped, slope_by_phi, trust_region
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.nuisance_model import FREE

STEP: Final = 1e-4
"""Step of an effect's parameter for its derivative, as a share of its range."""

INSIDE: Final = 0.02
"""A start keeps this share of each range from both ends, as that of theta does."""

EVALUATIONS: Final = 400
"""Largest number of evaluations of all cases."""


def jointly_refitted(subject: Subject, cases: Sequence[Case]) -> Subject:
    """The subject with theta and effect parameters of the least sum of squares over all cases (Eq. 33)."""
    problem = _Problem(subject, cases)
    theta, phi = mapped(interior(subject.parameters.vector()), FREE)
    start = np.concatenate([phi, problem.start()])

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        at, share = theta(point[: phi.size]), logistic(point[phi.size :])
        residuals, slopes = problem.linearised(at, share)
        slopes[:, : phi.size] *= slope_by_phi(at)[FREE]
        slopes[:, phi.size :] *= share * (1.0 - share)
        return residuals, slopes

    end, _ = trust_region(linearised, start, EVALUATIONS)
    return problem.subject(logistic(end[phi.size :]), theta(end[: phi.size]))


class _Problem:
    """The objective of the cases without a prior; effect parameters are shares of their ranges (m,)."""

    def __init__(self, subject: Subject, cases: Sequence[Case]) -> None:
        self._subject, self._cases = subject, cases
        # Nuisances of an effect stay fixed: a small step of an instant does not change the answer.
        parameters = [(applied, p) for applied in subject.effects for p in _fitted(applied)]
        self._ranges = Ranges([p for _, p in parameters])
        self._values = np.array([applied.values[p.name] for applied, p in parameters])
        # Chosen once, so that the objective is smooth.
        self._substeps: tuple[int, ...] | None = None
        self._substeps = self._domain(self._shares()).substeps

    def start(self) -> Floats:
        """The start of the effect parameters, on the real line (m,)."""
        return self._ranges.unbounded(self._values, INSIDE)

    def subject(self, share: Floats, theta: Floats) -> Subject:
        """The subject with these shares and theta (15,)."""
        values = iter(self._ranges.values(share).tolist())
        effects = tuple(
            dataclasses.replace(applied, values=dict(applied.values) | {p.name: next(values) for p in _fitted(applied)})
            for applied in self._subject.effects
        )
        return dataclasses.replace(self._subject, parameters=Parameters.from_vector(theta), effects=effects)

    def linearised(self, theta: Floats, share: Floats) -> tuple[Floats, Floats]:
        """Residuals and their derivatives by ln theta and by the shares, as `TimeDomain.linearised`."""
        if not share.size:
            return self._domain(share).linearised(theta, FREE)
        steps = np.where(share < 0.5, STEP, -STEP)  # inwards
        stepped = [self._domain(share + step) for step in np.diag(steps)]
        others = [
            np.stack([domain.accelerations(number, theta) for domain in stepped], axis=2)
            for number in range(len(self._cases))
        ]
        residuals, slopes = self._domain(share).linearised(theta, FREE, others)
        slopes[:, -share.size :] /= steps
        return residuals, slopes

    def _shares(self) -> Floats:
        return self._ranges.shares(self._values)

    def _domain(self, share: Floats) -> TimeDomain:
        theta = self._subject.parameters.vector()
        return TimeDomain(
            self._cases, self.subject(share, theta), RegularizationTerm(theta, 0.0), "trusted", self._substeps
        )


def _fitted(applied: AppliedEffect) -> list[EffectParameter]:
    return [p for p in applied.effect.parameters if p.kind != "nuisance"]
