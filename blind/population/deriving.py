"""Derive the population from the references: people with the apparent mass of people drawn around the published mean.

Nobody was recorded. The references say nothing of most directions in the space of parameters. So each person begins at
a random place, and moves as little as its apparent mass needs ("randomize then optimize", Bardsley et al. 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.base.segments import HEAD, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import DAMPINGS, FREQUENCIES, LOWER, STIFFENING, UPPER
from biodyn_core.population.beside import MAGNITUDE_MPS2
from biodyn_core.population.curves import BAND_HZ
from biodyn_core.population.distribution import AT_BOUND, Distribution, places_of, theta_of
from biodyn_core.population.population import Population
from biodyn_core.population.references import references

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

FREQUENCY_HZ: Final = np.arange(0.5, 20.01, 0.5)
LINES: Final = 500
BODY_MASS_KG: Final = 75.0
"""Any mass gives the same normalised curves."""


@dataclass(frozen=True)
class Derivation:
    """How a population is derived.

    tolerance: of the normalised apparent mass at a line, independent at every fourth. centre_spread: standard deviation
    of the mean's places around the middle of Table 1. spread: that of a person's places around the mean's, where the
    references leave them free; it is assumed, and the least of any parameter. softening, rate_mps, tau_s: of
    thixotropy in every joint, which makes the resonance fall with magnitude.
    """

    people: int = 400
    seed: int = 20261126
    tolerance: float = 0.02
    centre_spread: float = 3.0
    spread: float = 0.4
    softening: float = 0.8
    rate_mps: float = 0.01
    tau_s: float = 4.0


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
    softening = {"softening": how.softening, "rate_mps": how.rate_mps, "tau_s": how.tau_s}
    at_rest = places_off_bounds(np.array([stiffened(theta, how.softening, how.rate_mps) for theta in theta_of(places)]))
    provenance: dict[str, Any] = {
        "references": [reference.source],
        "assumed": reference.assumed_spread.reason,
        "derivation": asdict(how),
    }
    # The chain with the published mean, not the mean of the places: that of parameters has another response.
    middle = places_off_bounds(stiffened(theta_of(centre), how.softening, how.rate_mps))
    return Population(
        Distribution(middle, _at_least(how.spread, np.cov(at_rest.T))),
        Distribution(places_off_bounds(theta_of(centre)), _at_least(how.spread, np.cov(places.T))),
        softening,
        provenance,
    )


def places_off_bounds(theta: Floats) -> Floats:
    """The places of theta where they are not linear: near a bound they would add spread that nobody has."""
    most = np.log((1.0 - AT_BOUND) / AT_BOUND)
    return np.clip(places_of(theta), -most, most)


def _at_least(spread: float, covariance: Floats) -> Floats:
    """The covariance with variances of at least spread^2, also of parameters that everybody has at a bound."""
    lacking = np.maximum(spread**2 - np.diag(covariance), 0.0)
    return np.asarray(covariance + np.diag(lacking))


def stiffened(theta: Floats, softening: float, rate_mps: float, sites: Sequence[str] = SEGMENTS) -> Floats:
    """Theta (15,) at rest of a chain whose joints, softened by `MAGNITUDE_MPS2`, are those of theta; within Table 1.

    Thixotropy leaves 1 - softening s of a joint's stiffness, with s = m / (1 + m) in the mean and m the mean of |rate|
    over rate_mps: of a normal distribution sqrt(2 / pi) times the rms. Damping does not soften.
    """
    chain = Chain.of_theta(theta, BODY_MASS_KG, "segment")
    frequency_hz = np.linspace(*BAND_HZ, LINES)
    relative = chain.frequency_response(frequency_hz)
    rates = 2.0 * np.pi * frequency_hz[:, None] * np.abs(np.diff(relative, axis=1, prepend=0.0))
    moving = MAGNITUDE_MPS2 * np.sqrt(2.0 / np.pi * np.mean(rates**2, axis=0)) / rate_mps
    left = 1.0 - softening * moving / (1.0 + moving)
    left[[segment not in sites for segment in SEGMENTS]] = 1.0
    at_rest = theta.copy()
    at_rest[FREQUENCIES] /= np.sqrt(left)
    at_rest[DAMPINGS] *= np.sqrt(left)
    return np.clip(at_rest, LOWER, UPPER)


def nearest(target: Complexes, start: Floats, spread: float, how: Derivation) -> Floats:
    """The places (13,) whose apparent mass agrees with the target, as near to the start as that allows."""
    weight = np.sqrt(0.25) / how.tolerance

    def away(places: Floats) -> Floats:
        missed = weight * (responses(theta_of(places))[0] - target)
        return np.concatenate([missed.real, missed.imag, (places - start) / spread])

    return np.asarray(optimize.least_squares(away, start, max_nfev=60).x)
