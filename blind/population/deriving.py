"""Derive the population from the references: people with the apparent mass of people drawn around the published mean.

Nobody was recorded. The references say nothing of most directions in the space of parameters. So each person begins at
a random place, and moves as little as its apparent mass needs ("randomize then optimize", Bardsley et al. 2014).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.base.segments import HEAD, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import STIFFENING
from biodyn_core.population.population import Population, theta_of
from biodyn_core.population.references import references

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

FREQUENCY_HZ: Final = np.arange(0.5, 20.01, 0.5)
BODY_MASS_KG: Final = 75.0
"""Any mass gives the same normalised curves."""


@dataclass(frozen=True)
class Derivation:
    """How a population is derived.

    tolerance: of the normalised apparent mass at a line, independent at every fourth. centre_spread: standard deviation
    of the mean's places around the middle of Table 1. spread: that of a person's places around the mean's, where the
    references leave them free; it is assumed.
    """

    people: int = 400
    seed: int = 20261126
    tolerance: float = 0.02
    centre_spread: float = 3.0
    spread: float = 0.4


def responses(theta: Floats) -> tuple[Complexes, Complexes]:
    """Normalised apparent mass and seat-to-head transmissibility, (f,), of the linear chain of theta."""
    chain = Chain.of_theta(theta, BODY_MASS_KG, "segment")
    transmitted = chain.transmissibility(FREQUENCY_HZ)
    apparent_mass = transmitted @ chain.mass_kg
    return apparent_mass / np.abs(apparent_mass[0]), transmitted[:, SEGMENTS.index(HEAD)]


def derive(how: Derivation) -> Population:
    """Derive the population."""
    reference, rng = references().apparent_mass, np.random.default_rng(how.seed)
    centre = nearest(reference.mean(FREQUENCY_HZ), np.zeros(STIFFENING), how.centre_spread, how)
    targets = reference.of(*reference.people_drawn(rng, how.people), FREQUENCY_HZ)
    starts = centre + how.spread * rng.normal(size=(how.people, centre.size))
    places = np.array([nearest(target, start, how.spread, how) for target, start in zip(targets, starts, strict=True)])
    provenance: dict[str, Any] = {
        "references": [reference.source],
        "assumed": reference.assumed_spread.reason,
        "derivation": asdict(how),
    }
    return Population(places.mean(axis=0), np.cov(places.T), provenance)


def nearest(target: Complexes, start: Floats, spread: float, how: Derivation) -> Floats:
    """The places (13,) whose apparent mass agrees with the target, as near to the start as that allows."""
    weight = np.sqrt(0.25) / how.tolerance

    def away(places: Floats) -> Floats:
        missed = weight * (responses(theta_of(places))[0] - target)
        return np.concatenate([missed.real, missed.imag, (places - start) / spread])

    return np.asarray(optimize.least_squares(away, start, max_nfev=60).x)
