"""Identify a subject from its cases: fits per case and their fusion, and joint fits under both mass matrices.

Tasks depend on their arguments alone, so they can run in any order, on any machine, and be resumed.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import MASS_MATRICES, MassMatrix, Subject
from biodyn_core.identification.fit import (
    Fit,
    mean_percent,
    prediction_errors,
    search_group,
    search_groups,
    searches_by_case,
)
from biodyn_core.identification.idealize import FittedCase, Idealized, idealize
from biodyn_core.identification.phase1 import Search
from biodyn_core.identification.phase2 import Refined, refine
from biodyn_core.identification.posterior import maximum_a_posteriori, prior_of
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings, Refiner

DISTINCT_SHARE: Final = 0.05
"""Smallest difference of two mass matrices' mean errors, as a share of the larger, that separates them."""


class Task(NamedTuple):
    """One call, `function(*arguments)`, identified by its name."""

    name: str
    function: Callable[..., Search | Refined]
    arguments: tuple[Any, ...]


Run = Callable[[Sequence[Task]], list[Any]]
"""Runs tasks and returns their results in the same order; tasks of one name are one task."""


def run_locally(tasks: Sequence[Task]) -> list[Any]:
    """Run tasks one after the other in this process."""
    done: dict[str, Search | Refined] = {}
    for task in tasks:
        if task.name not in done:
            done[task.name] = task.function(*task.arguments)
    return [done[task.name] for task in tasks]


@dataclass(frozen=True, eq=False)
class RefinerRun:
    """The result of one refiner on the problem on which both are compared."""

    refiner: Refiner
    refined: Refined


@dataclass(frozen=True, eq=False)
class Identification:
    """All fits of a subject to its cases.

    fits are those of the single cases, in order; joint is one theta for all, without_prior the same without a prior;
    other is the joint fit under the mass matrix that the subject does not declare; refiners are both refiners on
    Eq. 33 as printed, for the case with the strongest seat motion, from one start.
    """

    cases: tuple[Case, ...]
    settings: FitSettings
    fits: tuple[Fit, ...]
    idealized: Idealized
    joint: Fit
    without_prior: Fit
    other: Fit
    compared_on: Case
    refiners: tuple[RefinerRun, ...]
    searches: tuple[Search, ...]

    @property
    def subject(self) -> Subject:
        """The resulting subject."""
        return self.joint.subject if self.settings.result == "joint" else self.idealized.subject

    @property
    def parts(self) -> list[Search | Refined]:
        """All searches and refinements, each once: of a single case, one serves the fit by itself and the joint fit."""
        fits = [fit.refined for fit in (*self.fits, self.without_prior, self.other)]
        found: list[Search | Refined] = [*self.searches, *fits, *(run.refined for run in self.refiners)]
        return list({id(one): one for one in found}.values())

    @property
    def evaluations(self) -> int:
        """Total of surrogate evaluations and simulations of a case."""
        of_prior = self.joint.refined.evaluations - self.without_prior.refined.evaluations
        return sum(part.evaluations for part in self.parts) + of_prior

    def better_mass_matrix(self, held_out: Sequence[Case] = ()) -> tuple[MassMatrix | None, dict[MassMatrix, float]]:
        """The mass matrix whose joint fit predicts better, None where neither does; and both mean errors.

        Errors are in percent, over the held-out events where there are any; infinite where a fit diverges.
        """
        events = held_out or self.cases
        found = {
            fit.subject.mass_matrix: mean_percent(prediction_errors(fit.subject, events))
            for fit in (self.without_prior, self.other)
        }
        better = min(found, key=lambda name: found[name])
        # A difference of the errors would not be a number where both are infinite.
        is_distinct = found[better] < (1.0 - DISTINCT_SHARE) * max(found.values())
        return better if is_distinct else None, found


def identify(
    cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings | None = None, run: Run = run_locally
) -> Identification:
    """Fit a subject to its cases; it provides anthropometry, mass matrix and m_scale.

    The numbers depend on the seed alone, not on how tasks are run. Raises InputError for no case, a case given twice,
    and where the chain diverges from every start.
    """
    s = settings or FitSettings()
    _check(cases)
    prior = prior_of(subject, s)
    (other_matrix,) = (name for name in MASS_MATRICES if name != subject.mass_matrix)
    twin = dataclasses.replace(subject, mass_matrix=other_matrix)
    groups = search_groups(cases, s)
    found = run([_search(group, of, seed, s) for of in (subject, twin) for group in groups])
    own, others = tuple(found[: len(groups)]), tuple(found[len(groups) :])
    alone = searches_by_case(own, len(cases), s)
    loudest = max(range(len(cases)), key=lambda number: float(np.mean(cases[number].seat_mps2 ** 2)))
    refined = run(
        [
            *(_refine([case], subject, starts, s) for case, starts in zip(cases, alone, strict=True)),
            _refine(cases, subject, own, s),
            _refine(cases, twin, others, s),
            *(_refine([cases[loudest]], subject, alone[loudest], on) for on in _same_problem(s)),
        ]
    )
    fits = tuple(Fit.of(end, [case], subject, s) for end, case in zip(refined, cases, strict=False))
    joint, other, *pair = refined[len(cases) :]
    without_prior = Fit.of(joint, cases, subject, s)
    return Identification(
        cases=tuple(cases),
        settings=s,
        fits=fits,
        idealized=idealize([FittedCase(fit.errors[0].case, fit.subject, fit.misfit_percent) for fit in fits]),
        joint=without_prior if prior is None else maximum_a_posteriori(without_prior, cases, prior),
        without_prior=without_prior,
        other=Fit.of(other, cases, twin, s),
        compared_on=cases[loudest],
        refiners=tuple(RefinerRun(on.refine, end) for on, end in zip(_same_problem(s), pair, strict=True)),
        searches=own + others,
    )


def fingerprint(cases: Sequence[Case], subject: Subject, seed: int, settings: object) -> str:
    """A hash of a problem: samples, masks, spectra and channels of its cases, subject, seed and settings."""
    digest = hashlib.sha256(repr((subject.to_dict(), seed, settings)).encode())
    for case in cases:
        digest.update(repr((case.name, case.case, case.rate_hz)).encode())
        for values in (case.seat_mps2, case.measured_mps2, case.compared, case.transmissibility, case.coherence):
            digest.update(np.ascontiguousarray(values).tobytes())
        for name in sorted(case.channels):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(case.channels[name]).tobytes())
    return digest.hexdigest()


def _check(cases: Sequence[Case]) -> None:
    if not cases:
        raise InputError("there is no case to fit to, give at least one recording")
    names = [case.case for case in cases]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name}: the case is given twice; give its representative repetition alone")


def _same_problem(settings: FitSettings) -> list[FitSettings]:
    """Settings under which both refiners minimise the same objective: Nelder-Mead does not estimate clock delays."""
    once = dataclasses.replace(settings, clocks="trusted", refined_starts=1)
    return [dataclasses.replace(once, refine=refiner) for refiner in ("least-squares", "nelder-mead")]


def _search(group: list[Case], subject: Subject, seed: int, settings: FitSettings) -> Task:
    name = f"search {subject.mass_matrix} {_names(group)}"
    return Task(name, search_group, (group, subject, seed, settings))


def _refine(cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings) -> Task:
    how = f"{settings.refine} {settings.clocks} from {settings.refined_starts}"
    name = f"refine {subject.mass_matrix} {how} {_names(cases)}"
    return Task(name, refine, (list(cases), subject, list(searches), settings))


def _names(cases: Sequence[Case]) -> str:
    return "+".join(case.case for case in cases)
