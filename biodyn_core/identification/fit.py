"""Fits of one theta to one case or several, in both phases, with errors and parameters on bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.objectives import PriorTerm, RegularizationTerm, Surrogate, TimeDomain
from biodyn_core.identification.phase1 import Search, reached, search
from biodyn_core.identification.phase2 import Refined, refine
from biodyn_core.identification.problem import Case, Errors, errors
from biodyn_core.identification.settings import FitSettings

AT_BOUND: Final = 1e-3
"""A parameter closer to a bound than this share of its range is on the bound."""


@dataclass(frozen=True, eq=False)
class Fit:
    """One theta fitted to one case or several: the subject with it, and the result of phase 2 in `refined`.

    clock_delays_s (cases, 5, 2) is empty where clocks are trusted; at_bound names parameters on a bound of Table 1;
    prior: the term of a fit with a prior. misfit_percent: J of Eq. 35 of what was minimised, so without the part of
    estimated clock delays, which `errors` contain.
    """

    subject: Subject
    settings: FitSettings
    refined: Refined
    errors: tuple[Errors, ...]
    at_bound: tuple[str, ...]
    clock_delays_s: Floats
    misfit_percent: float
    prior: PriorTerm | None = None

    @classmethod
    def of(
        cls, refined: Refined, cases: Sequence[Case], subject: Subject, settings: FitSettings,
        prior: PriorTerm | None = None,
    ) -> Fit:  # fmt: skip
        """The fit from the result of phase 2 for these cases."""
        found = dataclasses.replace(subject, parameters=Parameters.from_vector(refined.theta), provenance={})
        problem = TimeDomain(cases, found, RegularizationTerm(refined.theta, 0.0), settings.clocks)
        return cls(
            subject=found,
            settings=settings,
            refined=refined,
            errors=prediction_errors(found, cases),
            at_bound=at_bound(refined.theta, settings.free),
            clock_delays_s=_clock_delays_s(problem, refined.theta, settings),
            misfit_percent=_misfit_percent(problem, refined.theta),
            prior=prior,
        )

    @property
    def reached(self) -> int:
        """How many of the refined starts reached the best optimum."""
        return reached(self.refined.costs)

    @property
    def error_percent(self) -> float:
        """J of Eq. 35: normalised rms in percent, mean over the measured segments and the cases."""
        return mean_percent(self.errors)

    def objective(self, cases: Sequence[Case]) -> TimeDomain:
        """The minimised objective of the same cases, with the prior if there is one, and without regularization."""
        term = self.prior or RegularizationTerm(self.refined.reference, 0.0)
        return TimeDomain(cases, self.subject, term, self.settings.clocks)


def fit_cases(cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings) -> list[Fit]:
    """Fit each case alone, as the paper does; with `phase1: pooled` from one search over all.

    The subject provides anthropometry, mass matrix and m_scale.
    """
    found = search_all(cases, subject, seed, settings)
    return [
        Fit.of(refine([case], subject, starts, settings), [case], subject, settings)
        for case, starts in zip(cases, searches_by_case(found, len(cases), settings), strict=True)
    ]


def fit_joint(
    cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings | None = None,
    parallel: ParallelMap = serial_map,
) -> Fit:  # fmt: skip
    """Fit one theta to all cases, as `fit_cases`; raises InputError where the chain diverges from every start."""
    s = settings or FitSettings()
    searches = search_all(cases, subject, seed, s, parallel)
    return Fit.of(refine(cases, subject, searches, s, parallel), cases, subject, s)


def search_all(
    cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings, parallel: ParallelMap = serial_map
) -> tuple[Search, ...]:
    """Phase 1 of all cases, in order: one search per case, or one for all."""
    return tuple(search_group(group, subject, seed, settings, parallel) for group in search_groups(cases, settings))


def search_groups(cases: Sequence[Case], settings: FitSettings) -> list[list[Case]]:
    """Groups of cases with a common search."""
    return [list(cases)] if settings.phase1 == "pooled" else [[case] for case in cases]


def search_group(
    cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings, parallel: ParallelMap = serial_map
) -> Search:
    """Phase 1 of one group."""
    return search(Surrogate(cases, subject.mass_matrix, settings.surrogate), seed, settings.swarm, parallel)


def searches_by_case(searches: Sequence[Search], cases: int, settings: FitSettings) -> list[Sequence[Search]]:
    """For each case, the searches that its refinement starts from."""
    return [searches] * cases if settings.phase1 == "pooled" else [[one] for one in searches]


def predictions(subject: Subject, cases: Sequence[Case]) -> Iterator[Floats]:
    """Forward predictions of each case by a subject: accelerations (n, 5) of the measured segments."""
    theta = subject.parameters.vector()
    problem = TimeDomain(cases, subject, RegularizationTerm(theta, 0.0))
    return (problem.accelerations(number, theta) for number in range(len(cases)))


def prediction_errors(subject: Subject, cases: Sequence[Case]) -> tuple[Errors, ...]:
    """Errors of a subject's forward predictions of cases."""
    return tuple(errors(case, accel) for case, accel in zip(cases, predictions(subject, cases), strict=True))


def mean_percent(found: Sequence[Errors]) -> float:
    """Mean of the cases' mean normalised rms, in percent."""
    return float(np.mean([error.mean_percent for error in found]))


def at_bound(theta: Floats, free: Flags, within: float = AT_BOUND) -> tuple[str, ...]:
    """The fitted parameters that lie on a bound of Table 1, within this share of the range."""
    share = (theta - LOWER) / (UPPER - LOWER)
    on_bound = free & ((share < within) | (share > 1.0 - within))
    return tuple(p.name for p, flag in zip(PARAMETERS, on_bound, strict=True) if flag)


def _clock_delays_s(problem: TimeDomain, theta: Floats, settings: FitSettings) -> Floats:
    if settings.clocks == "trusted":
        return np.empty((0, len(MEASURED_SEGMENTS), 2))
    return np.array([problem.clock_delays_s(number, theta) for number in range(len(problem.cases))])


def _misfit_percent(problem: TimeDomain, theta: Floats) -> float:
    misses = (problem.residuals(number, theta) for number in range(len(problem.cases)))
    return mean_percent(
        [errors(case, case.measured_mps2 + miss) for case, miss in zip(problem.cases, misses, strict=True)]
    )
