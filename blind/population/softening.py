"""Softening: the resonance over magnitude of the population's mean, without and with thixotropy in its joints."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.population.beside import BesidePeople, beside_people

SOFTENINGS: Final = (0.5, 0.7, 0.9)
RATE_MPS: Final = 0.01
TAU_S: Final = 4.0
SITES: Final = {"pelvis alone": SEGMENTS[:1], "torso": SEGMENTS[:4], "all joints": SEGMENTS}


@dataclass(frozen=True, eq=False)
class SofteningRow:
    """The joints that soften, by which share, and the subject beside the groups."""

    sites: str
    softening: float
    found: BesidePeople


def rows(subject: Subject) -> list[SofteningRow]:
    """The subject without the effect, and with it at several sites and strengths."""
    found = [SofteningRow("none", 0.0, beside_people(subject))]
    for words, sites in SITES.items():
        for softening in SOFTENINGS:
            values = {"softening": softening, "rate_mps": RATE_MPS, "tau_s": TAU_S}
            effects = tuple(AppliedEffect(CATALOGUE["thixotropy"], site, values) for site in sites)
            found.append(SofteningRow(words, softening, beside_people(dataclasses.replace(subject, effects=effects))))
    return found
