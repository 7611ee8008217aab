"""Softening: the resonance over magnitude, without and with thixotropy in some joints or in all.

The stiffness at rest is raised in each case, so that the curves at the magnitude of the comparison stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.parameters import STIFFENING, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.population.beside import BesidePeople, beside_people
from biodyn_core.population.distribution import theta_of
from biodyn_core.population.references import references
from blind.population.deriving import BODY_MASS_KG, FREQUENCY_HZ, Derivation, nearest, stiffened

SOFTENINGS: Final = (0.5, 0.7, 0.8, 0.9)
SITES: Final = {"pelvis alone": SEGMENTS[:1], "torso": SEGMENTS[:4], "all joints": SEGMENTS}


@dataclass(frozen=True, eq=False)
class SofteningRow:
    """The joints that soften, by which share, and the subject beside the groups."""

    sites: str
    softening: float
    found: BesidePeople


def rows(how: Derivation) -> list[SofteningRow]:
    """The chain with the published mean without the effect, and with it at several sites and strengths."""
    target = references().apparent_mass.mean(FREQUENCY_HZ)
    theta = theta_of(nearest(target, np.zeros(STIFFENING), how.centre_spread, how))
    found = [SofteningRow("none", 0.0, _beside(theta, ()))]
    for words, sites in SITES.items():
        for softening in SOFTENINGS:
            values = {"softening": softening, "rate_mps": how.rate_mps, "tau_s": how.tau_s}
            effects = tuple(AppliedEffect(CATALOGUE["thixotropy"], site, values) for site in sites)
            at_rest = stiffened(theta, softening, how.rate_mps, sites)
            found.append(SofteningRow(words, softening, _beside(at_rest, effects)))
    return found


def _beside(theta: np.ndarray, effects: tuple[AppliedEffect, ...]) -> BesidePeople:
    return beside_people(Subject("chain", BODY_MASS_KG, 1.75, "segment", Parameters.from_vector(theta), effects))
