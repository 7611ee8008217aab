"""People of the study: theta of the population, or from anywhere in Table 1; with backgrounds, noise and sensors.

Bodies, backgrounds and sensors are those of `test/world`, which shares no code with the package.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from world import body
from world.effects import mixture, sitting
from world.effects.effect import Person as Joints
from world.effects.sensor_mechanisms import SensorNoise
from world.effects.sitting import Plan, Planned, Sitting

from biodyn_core.body.parameters import MASS_SCALE, STIFFENING
from biodyn_core.identification.problem import Case
from biodyn_core.population.population import population
from blind.predictions.driven import case_of

Origin = Literal["population", "elsewhere"]

ORIGINS: Final[tuple[Origin, ...]] = ("population", "elsewhere")
SEED: Final = 20261126
PLAN: Final = Plan((3, 2, 2), (10.0, 6.0, 6.0), ("fit", "held"))
WEAK: Final = "road_2"
"""The event for fitting that is a weak one."""

WEAK_LEVEL: Final = 0.25
STIFFENING_RANGE: Final = (0.05, 1.0)
"""Of people of the population, log-uniform; the references say nothing of it."""


@dataclass(frozen=True, eq=False)
class Person:
    """A simulated person: its true theta (15,), events for fitting by name, and events held out."""

    number: int
    origin: Origin
    body_mass_kg: float
    theta: NDArray[np.float64]
    fit: dict[str, Case]
    held: tuple[Case, ...]


def people(numbers: Sequence[int]) -> Iterator[Person]:
    """Simulate the people of these numbers; every other one is of the population."""
    rngs = [np.random.default_rng([SEED, number]) for number in numbers]
    drafts = [_draft(number, rng) for number, rng in zip(numbers, rngs, strict=True)]
    found = [_with_background(one, rng) for one, rng in zip(sitting.travelled(drafts), rngs, strict=True)]
    for number, one in zip(numbers, sitting.together(found), strict=True):
        cases = {
            (planned.use, planned.name): case_of(planned.event, planned.name, one.streams(index, with_effects=False))
            for index, planned in enumerate(one.events)
        }
        yield Person(
            number, _origin(number), one.body_mass_kg, one.theta,
            {name: case for (use, name), case in cases.items() if use == "fit"},
            tuple(case for (use, _), case in cases.items() if use == "held"),
        )  # fmt: skip


def _origin(number: int) -> Origin:
    return ORIGINS[number % 2]


def _draft(number: int, rng: np.random.Generator) -> Sitting:
    """A sitting whose body has segment masses, as those of the population have."""
    one = sitting.draft_of(number, SEED, PLAN, rng)
    theta = body.drawn(1, rng).theta[0]
    if _origin(number) == "population":
        theta = population().without_softening.draw(rng, 1)[0]
        theta[STIFFENING] = np.exp(rng.uniform(*np.log(STIFFENING_RANGE)))
    theta[MASS_SCALE] = 1.0
    joints = Joints.of(body.People(theta[None], np.array([one.body_mass_kg]), np.array([False])), 0)
    events = tuple(_weak(planned) if planned.name == WEAK else planned for planned in one.events)
    return dataclasses.replace(one, theta=theta, mass_matrix="segment", person=joints, events=events)


def _weak(planned: Planned) -> Planned:
    return dataclasses.replace(planned, event=planned.event.at_level(WEAK_LEVEL)) if planned.use == "fit" else planned


def _with_background(draft: Sitting, rng: np.random.Generator) -> Sitting:
    scales = mixture.scales(mixture.KINDS, rng, 0.12)
    behind = sitting.with_background(draft, scales, rng)
    noise = SensorNoise.of(behind.person, 1.0, rng)
    return dataclasses.replace(behind, mechanisms=(*behind.mechanisms, noise), level=scales.get(mixture.PAPER, 0.0))
