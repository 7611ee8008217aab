"""Population: a distribution of the parameters of seated people, and a subject for a person who was never recorded.

The distribution is normal in the places of ln theta between the bounds of Table 1. `make blind ARGS=population` derived
it from the references, without a recording of any person; docs/people.md shows how well it agrees with them.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body import parameter_spread
from biodyn_core.body.origin import GROUP
from biodyn_core.body.parameter_spread import ParameterSpread
from biodyn_core.body.parameters import LOWER, N_PARAMETERS, PARAMETERS, STIFFENING, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect

FILE: Final = "population.json"
VERSION: Final = 1

SPREAD: Final = slice(0, STIFFENING)
"""The parameters that the population spreads: frequencies, damping ratios and Rayleigh damping.

No reference says anything of the others. Stiffening has its lower bound, because the references soften.
"""

MASS_KG: Final = (40.0, 120.0)
STATURE_M: Final = (1.4, 2.0)
"""Beyond these a subject is marked as extrapolated."""

AT_BOUND: Final = 0.005
"""Least distance of a parameter from its bounds, as a share of the range of its logarithm: places are finite."""


@dataclass(frozen=True, eq=False)
class Population:
    """Mean (13,) and covariance (13, 13) of the places of ln theta; provenance: how they were derived.

    The mean has the mean response of the group. softening: values of thixotropy, the same in every joint, by which the
    resonance falls with magnitude as published. The parameters are those at rest.
    """

    mean: Floats
    covariance: Floats
    softening: Mapping[str, float]
    provenance: Mapping[str, Any]

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects of everybody in the population."""
        return tuple(AppliedEffect(CATALOGUE["thixotropy"], segment, self.softening) for segment in SEGMENTS)

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Theta (count, 15) of people of the population."""
        return theta_of(rng.multivariate_normal(self.mean, self.covariance, count))

    @property
    def spread(self) -> ParameterSpread:
        """The covariance of ln theta around the mean, to first order."""
        inside = 1.0 / (1.0 + np.exp(-self.mean))
        slope = np.log(UPPER / LOWER)[SPREAD] * inside * (1.0 - inside)
        return ParameterSpread(_NAMES, self.covariance * np.outer(slope, slope))


_NAMES: Final = tuple(parameter.name for parameter in PARAMETERS[SPREAD])


def places_of(theta: Floats) -> Floats:
    """The places (..., 13) of theta (..., 15), the inverse of `theta_of`; at a bound `AT_BOUND` away from it."""
    share = np.log(theta[..., SPREAD] / LOWER[SPREAD]) / np.log(UPPER / LOWER)[SPREAD]
    inside = np.clip(share, AT_BOUND, 1.0 - AT_BOUND)
    return np.asarray(np.log(inside / (1.0 - inside)))


def theta_of(places: Floats) -> Floats:
    """Theta (..., 15) of places (..., 13): ln theta lies between its bounds as logistic(place) does between 0 and 1."""
    theta = np.broadcast_to(LOWER, (*places.shape[:-1], N_PARAMETERS)).copy()
    theta[..., SPREAD] = LOWER[SPREAD] * (UPPER / LOWER)[SPREAD] ** (1.0 / (1.0 + np.exp(-places)))
    theta[..., STIFFENING + 1] = 1.0
    return theta


@functools.cache
def population() -> Population:
    """The population of the package."""
    return population_from(resources.files("biodyn_core.population").joinpath(FILE).read_text(encoding="utf-8"))


def population_from(text: str) -> Population:
    """A population from the text of its file; raises InputError for one of another version."""
    stored = json.loads(text)
    if stored.get("version") != VERSION:
        raise InputError(f"{FILE}: version {stored.get('version')}, expected {VERSION}: make blind ARGS=population")
    mean, covariance = np.array(stored["mean"]), np.array(stored["covariance"])
    return Population(mean, covariance, stored["softening"], stored["provenance"])


def to_text(of: Population) -> str:
    """The text of the file."""
    stored = {
        "version": VERSION,
        "parameters": list(_NAMES),
        "mean": of.mean.tolist(),
        "covariance": of.covariance.tolist(),
        "softening": dict(of.softening),
        "provenance": dict(of.provenance),
    }
    return json.dumps(stored, indent=1) + "\n"


def beyond(body_mass_kg: float, stature_m: float) -> str:
    """Why a subject of the population is extrapolated, empty if it is not."""
    for value, (lower, upper), unit in ((body_mass_kg, MASS_KG, "kg"), (stature_m, STATURE_M, "m")):
        if not lower <= value <= upper:
            return f"{value:g} {unit} is beyond {lower:g} to {upper:g} {unit}: the subject is extrapolated"
    return ""


def new_subject(name: str, body_mass_kg: float, stature_m: float) -> Subject:
    """A subject with the mean parameters and the effects of the population, and masses in proportion to the body's.

    Its provenance has the covariance, by which predictions have the spread of the population as their band. Raises
    InputError for a mass or stature that no subject may have.
    """
    people = population()
    reason = beyond(body_mass_kg, stature_m)
    provenance = {
        "source": "published groups of people, no recording of this person",
        GROUP: dict(people.provenance) | ({"extrapolated": reason} if reason else {}),
        parameter_spread.PROVENANCE: people.spread.to_dict(),
    }
    rounded = [float(f"{value:.4g}") for value in theta_of(people.mean)]
    parameters = Parameters.from_vector(rounded)
    return Subject(name, body_mass_kg, stature_m, "segment", parameters, people.effects, provenance)
