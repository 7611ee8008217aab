"""Identify people from their known data, by our method and by that of the paper; the truth is not available here."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import fit_cases, fit_joint
from biodyn_core.identification.idealize import FittedCase, idealize
from biodyn_core.identification.settings import PAPER
from biodyn_core.identification.uncertainty import Estimate, uncertainty
from blind.recovery.draw import Person

SEED: Final = 0
"""Seed of the swarms."""


@dataclass(frozen=True, eq=False)
class Found:
    """The answer of one method: the subject, and the seconds of computation."""

    subject: Subject
    seconds: float


@dataclass(frozen=True, eq=False)
class Answer:
    """The answers of both methods, and our estimates with intervals and identifiability."""

    ours: Found
    estimates: tuple[Estimate, ...]
    papers: Found


def identify(person: Person) -> Answer:
    """Identify one person by both methods."""
    ours, estimates = jointly(person)
    return Answer(ours, estimates, by_the_paper(person))


def jointly(person: Person) -> tuple[Found, tuple[Estimate, ...]]:
    """The default: one theta for all cases, with its uncertainty."""
    begin = time.perf_counter()
    fit = fit_joint(person.training, initial_subject(person), SEED)
    estimates = uncertainty(fit, person.training).estimates
    return Found(fit.subject, time.perf_counter() - begin), estimates


def by_the_paper(person: Person) -> Found:
    """Each case by itself, then fused (Zaman et al., 6 and 7)."""
    begin = time.perf_counter()
    fits = fit_cases(person.training, initial_subject(person), SEED, PAPER)
    fitted = [FittedCase(c.case, f.subject, f.misfit_percent) for c, f in zip(person.training, fits, strict=True)]
    subject = idealize(fitted).subject
    return Found(subject, time.perf_counter() - begin)


def initial_subject(person: Person) -> Subject:
    """Return the anthropometry with parameters in the middle of Table 1; fits use only m_scale of them."""
    return Subject(
        "blind", person.body_mass_kg, 1.75, person.mass_matrix, Parameters.from_vector(0.5 * (LOWER + UPPER))
    )
