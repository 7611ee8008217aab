"""A search as if the catalogue had the true law: the ceiling of what better laws can reach.

The true law answers as the body does: by the measured change of the hidden effect, on top of the body without it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.beside import Answers, answered, beside
from biodyn_core.tracing.fitted_candidates import candidate_fit
from biodyn_core.tracing.local_fit import LocalFit
from biodyn_core.tracing.nuisance_model import N_THETA, EventSet
from biodyn_core.tracing.rounds import Search
from biodyn_core.tracing.rows import Products
from blind.tracing.outcome import Cause


def with_true_law(found: Search, cause: Cause, plain: Subject, without: Sequence[Case]) -> Search | None:
    """The search with a fit of the true law at the true effect and site; None if that is no candidate.

    plain: the subject refitted to the events without the hidden effect, which are without.
    """
    every = (*found.fitted, *found.preliminary, *found.screening.ranking)
    same = [one for one in every if one.start.effect.name == cause.name and cause.site in ("", one.start.site)]
    if not same:
        return None
    own = same[0]
    whole = _answers(found, plain, {case.name: case for case in without})
    local = _fit(found, whole, dataclasses.replace(plain, effects=()), own.start)
    fit = candidate_fit(found.without_effect, [(found.nuisance.prior_scale, local)])
    others = [one for one in found.fitted if one.key != own.key and one.fitted.steady]
    varying = [one for one in found.fitted if not one.fitted.steady]
    of_fits = {one.key: answered(found.nuisance, one.best_fit.local.subject) for one in others}
    return dataclasses.replace(
        found,
        fitted=(dataclasses.replace(own, fit=fit, general=None), *others, *varying),
        beside=beside(found.nuisance, {own.key: whole} | of_fits),
    )


def _answers(found: Search, plain: Subject, without: dict[str, Case]) -> Answers:
    """The answers of the true law in each event for fitting, and in each for choosing."""

    def of_event(case: Case) -> Floats:
        whole, other = answer(found.nuisance.subject, case), without.get(case.name)
        if other is None:
            return whole
        rows = min(len(case.measured_mps2), len(other.measured_mps2))
        there = (case.compared[:rows] & other.compared[:rows]).nonzero()
        change = case.measured_mps2[:rows] - other.measured_mps2[:rows]
        whole[there] = (answer(plain, other)[:rows] + change)[there]
        return whole

    train, choose = (list(map(of_event, events.cases)) for events in (found.nuisance.train, found.nuisance.choose))
    return train, choose


def _fit(found: Search, whole: Answers, plain: Subject, start: AppliedEffect) -> LocalFit:
    """The fit of these answers, theta and nuisance parameters refitted to first order."""
    nuisance = found.nuisance

    def products(events: EventSet, answers: Sequence[Floats]) -> Products:
        return events.products_of([rows.residual(one) for rows, one in zip(events.rows, answers, strict=True)])

    train, choose = products(nuisance.train, whole[0]), products(nuisance.choose, whole[1])
    b = nuisance.solution(train)
    return LocalFit(
        subject=dataclasses.replace(plain, effects=(start,)),
        applied=start,
        coefficients=b,
        objective=float(nuisance.weight @ (train.square - train.cross @ b)),
        nuisance_square=float(nuisance.unit_precision[N_THETA:] @ b[N_THETA:] ** 2),
        prior_scale=nuisance.prior_scale,
        penalty=found.without.penalty,
        residual_square=np.asarray(choose.residual_square(b)),
    )
