"""Identifies people from what may be known of them, our way and the paper's: no truth is at hand here."""

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
"""Of the swarms."""


@dataclass(frozen=True, eq=False)
class Found:
    """One way's answer: the subject, and the seconds it took."""

    subject: Subject
    seconds: float


@dataclass(frozen=True, eq=False)
class Answer:
    """Both ways' answers, and our estimates with intervals and calls."""

    ours: Found
    estimates: tuple[Estimate, ...]
    papers: Found


def identify(person: Person) -> Answer:
    """Identify one person both ways."""
    ours, estimates = jointly(person)
    return Answer(ours, estimates, by_the_paper(person))


def jointly(person: Person) -> tuple[Found, tuple[Estimate, ...]]:
    """The default: one theta for all cases, with its uncertainty."""
    begin = time.perf_counter()
    fit = fit_joint(person.training, somebody(person), SEED)
    estimates = uncertainty(fit, person.training).estimates
    return Found(fit.subject, time.perf_counter() - begin), estimates


def by_the_paper(person: Person) -> Found:
    """Each case by itself, then fused (Zaman et al., 6 and 7)."""
    begin = time.perf_counter()
    fits = fit_cases(person.training, somebody(person), SEED, PAPER)
    fitted = [FittedCase(c.case, f.subject, f.error_percent) for c, f in zip(person.training, fits, strict=True)]
    subject = idealize(fitted).subject
    return Found(subject, time.perf_counter() - begin)


def somebody(person: Person) -> Subject:
    """The person's anthropometry; parameters are the middle of Table 1, of which fits take m_scale alone."""
    return Subject(
        "blind", person.body_mass_kg, 1.75, person.mass_matrix, Parameters.from_vector(0.5 * (LOWER + UPPER))
    )
