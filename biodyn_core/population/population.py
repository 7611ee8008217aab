"""Population: a distribution of the parameters of seated people, and a subject for a person who was never recorded.

The distribution is normal in the places of ln theta between the bounds of Table 1. `make blind ARGS=population` derived
it from the references, without a recording of any person; docs/people.md shows how well it agrees with them.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body import parameter_spread
from biodyn_core.body.origin import GROUP
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.population.distribution import NAMES, Distribution, theta_of

FILE: Final = "population.json"
VERSION: Final = 2

SOFTENS: Final = "thixotropy"
"""The effect by which the people of the population soften."""

MASS_KG: Final = (40.0, 120.0)
STATURE_M: Final = (1.4, 2.0)
"""Beyond these a subject is marked as extrapolated."""


@dataclass(frozen=True, eq=False)
class Population:
    """Distributions of the parameters of people, and how they were derived.

    softening: values of thixotropy, the same in every joint, by which the resonance falls with magnitude as published.
    at_rest: of the parameters beside that effect. without_softening: of a model without it, which has the same
    responses at the magnitude of the references.
    """

    at_rest: Distribution
    without_softening: Distribution
    softening: Mapping[str, float]
    provenance: Mapping[str, Any]

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects of everybody in the population."""
        return tuple(AppliedEffect(CATALOGUE[SOFTENS], segment, self.softening) for segment in SEGMENTS)

    def distribution_for(self, effects: Sequence[AppliedEffect]) -> Distribution | None:
        """The distribution of the parameters of a model with these effects; None for a thixotropy of another kind."""
        softens = {one.site: one.values for one in effects if one.effect.name == SOFTENS and not one.absent}
        if not softens:
            return self.without_softening
        return self.at_rest if softens == {one.site: one.values for one in self.effects} else None


_DISTRIBUTIONS: Final = ("at_rest", "without_softening")


@functools.cache
def population() -> Population:
    """The population of the package."""
    return population_from(resources.files("biodyn_core.population").joinpath(FILE).read_text(encoding="utf-8"))


def population_from(text: str) -> Population:
    """A population from the text of its file; raises InputError for one of another version."""
    stored = json.loads(text)
    if stored.get("version") != VERSION:
        raise InputError(f"{FILE}: version {stored.get('version')}, expected {VERSION}: make blind ARGS=population")
    at_rest, without = (
        Distribution(np.array(stored[name]["mean"]), np.array(stored[name]["covariance"])) for name in _DISTRIBUTIONS
    )
    return Population(at_rest, without, stored["softening"], stored["provenance"])


def to_text(of: Population) -> str:
    """The text of the file."""
    stored = {
        "version": VERSION,
        "parameters": list(NAMES),
        **{
            name: {"mean": one.mean.tolist(), "covariance": one.covariance.tolist()}
            for name, one in zip(_DISTRIBUTIONS, (of.at_rest, of.without_softening), strict=True)
        },
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
        parameter_spread.PROVENANCE: people.at_rest.spread.to_dict(),
    }
    rounded = [float(f"{value:.4g}") for value in theta_of(people.at_rest.mean)]
    parameters = Parameters.from_vector(rounded)
    return Subject(name, body_mass_kg, stature_m, "segment", parameters, people.effects, provenance)
