"""Identify a subject from its cases: both phases case by case and fused, one theta for all, under both mass matrices.

The work is cut into tasks that depend on nothing but their arguments, so that they may run in any order, anywhere, and
be taken up again.
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
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings, Refiner

TOLD_APART: Final = 0.05
"""Mean errors of two mass matrices that differ by less than this share of the larger tell nothing."""


class Task(NamedTuple):
    """One piece of work, known by its name: `function(*arguments)`."""

    name: str
    function: Callable[..., Search | Refined]
    arguments: tuple[Any, ...]


Run = Callable[[Sequence[Task]], list[Any]]
"""Does tasks and returns their results in the same order; tasks of one name are the same task."""


def run_here(tasks: Sequence[Task]) -> list[Any]:
    """Do tasks one after the other."""
    done: dict[str, Search | Refined] = {}
    for task in tasks:
        if task.name not in done:
            done[task.name] = task.function(*task.arguments)
    return [done[task.name] for task in tasks]


@dataclass(frozen=True, eq=False)
class RefinerRun:
    """What one refiner made of the problem on which both are compared."""

    refiner: Refiner
    refined: Refined


@dataclass(frozen=True, eq=False)
class Identification:
    """All that is known of a subject after its cases.

    fits are those of the cases, in their order; joint is one theta for all; other is the joint fit under the mass
    matrix that the subject does not have; refiners are both refiners on Eq. 33 as printed of the case that moves most,
    from one start.
    """

    cases: tuple[Case, ...]
    settings: FitSettings
    fits: tuple[Fit, ...]
    idealized: Idealized
    joint: Fit
    other: Fit
    compared_on: Case
    refiners: tuple[RefinerRun, ...]
    searches: tuple[Search, ...]

    @property
    def subject(self) -> Subject:
        """The subject that comes out."""
        return self.joint.subject if self.settings.result == "joint" else self.idealized.subject

    @property
    def evaluations(self) -> int:
        """Points of the surrogate and simulations of a case, in all."""
        fits = [fit.refined.evaluations for fit in (*self.fits, self.joint, self.other)]
        return sum(search.evaluations for search in self.searches) + sum(
            fits + [run.refined.evaluations for run in self.refiners]
        )

    def better_mass_matrix(self, held_out: Sequence[Case] = ()) -> tuple[MassMatrix | None, dict[MassMatrix, float]]:
        """The mass matrix whose joint fit predicts better, None where they cannot be told apart; and both mean errors.

        Judged, in percent, by events that were not fitted to where there are any.
        """
        judges = held_out or self.cases
        found = {
            fit.subject.mass_matrix: mean_percent(prediction_errors(fit.subject, judges))
            for fit in (self.joint, self.other)
        }
        better = min(found, key=lambda name: found[name])
        apart = max(found.values()) - min(found.values()) > TOLD_APART * max(found.values())
        return better if apart else None, found


def identify(
    cases: Sequence[Case], subject: Subject, seed: int, settings: FitSettings | None = None, run: Run = run_here
) -> Identification:
    """Fit a subject to its cases; it gives anthropometry, mass matrix and m_scale.

    The same seed gives the same numbers however the tasks are run. Raises InputError for no case, a case given twice,
    and where the chain diverges from every start.
    """
    s = settings or FitSettings()
    _check(cases)
    twin = dataclasses.replace(subject, mass_matrix=_other(subject.mass_matrix))
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
    return Identification(
        cases=tuple(cases),
        settings=s,
        fits=fits,
        idealized=idealize([FittedCase(fit.errors[0].case, fit.subject, fit.error_percent) for fit in fits]),
        joint=Fit.of(joint, cases, subject, s),
        other=Fit.of(other, cases, twin, s),
        compared_on=cases[loudest],
        refiners=tuple(RefinerRun(on.refine, end) for on, end in zip(_same_problem(s), pair, strict=True)),
        searches=own + others,
    )


def fingerprint(cases: Sequence[Case], subject: Subject, seed: int, settings: object) -> str:
    """What tells one problem from another: its samples, masks, spectra and channels, subject, seed and settings."""
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


def _other(mass_matrix: MassMatrix) -> MassMatrix:
    first, second = MASS_MATRICES
    return second if mass_matrix == first else first


def _same_problem(settings: FitSettings) -> list[FitSettings]:
    """The settings under which both refiners minimise the same: Nelder and Mead's see no delays of sensors."""
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
