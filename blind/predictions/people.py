"""People of the study: each is drawn, sits for a fit and is then driven; an effect may begin in mid-drive.

Bodies, backgrounds, effects and sensors are those of `test/world`, which shares no code with the package.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from world.effects import mixture
from world.effects.draw import Split
from world.effects.moving import runs_away
from world.effects.sitting import Planned, Sitting
from world.seats import CASES

from blind.training.draw import TrainingSettings, drawn, sittings

Role = Literal["fit", "held", "drive", "none"]

FIT: Final = 2
HELD: Final = 2
"""Events of each kind that are fitted to, and held out; the others are driven."""

LEVELS: Final = (0.4, 1.0, 2.0, 0.7, 1.4)
"""Of the drive, turn by turn, in multiples of the motion in the fit."""

DRIFT: Final = "drift"
"""The kind of background by which a person changes while sitting."""

OTHER_KIND: Final = 0.4
"""Share of people without events of one kind in fit and held-out events."""


@dataclass(frozen=True)
class Population:
    """People of one distribution: background, forms of effects, share without an effect, turns of the drive."""

    seed: int
    background: tuple[str, ...]
    splits: tuple[Split, ...]
    nothing: float = 0.35
    turns: int = 16

    def settings(self) -> TrainingSettings:
        """As a distribution of bodies."""
        count = FIT + HELD + self.turns
        levels = (1.0,) * (FIT + HELD) + tuple(LEVELS[turn % len(LEVELS)] for turn in range(self.turns))
        return TrainingSettings(
            nothing=self.nothing, two=0.0, outside=0.0, splits=self.splits, ratio=(0.8, 4.0),
            background=self.background, counts=((count, count),) * 3, seconds=((7.0, 7.0), (6.0, 6.0), (6.0, 6.0)),
            noise=(1.0, 1.5), missing=0.0, uses=("fit",), levels=levels,
        )  # fmt: skip


CALIBRATION: Final = Population(20261125, mixture.KINDS, ("development", "earlier"))
TEST: Final = Population(20261126, (*mixture.KINDS, *mixture.UNSEEN), ("development", "second", "earlier"))
"""The people that factors and thresholds are chosen on, and those that they are tested on.

The latter have backgrounds of kinds and effects of forms that the former do not have.
"""


@dataclass(frozen=True, eq=False)
class Person:
    """A simulated person; roles of the events in their order. begins: the first event with the effect."""

    number: int
    sitting: Sitting
    kind: str
    ratio: float | None
    roles: tuple[Role, ...]
    begins: int

    @property
    def drifts(self) -> bool:
        """Whether its stiffness drifts in the background."""
        return self.sitting.scales.get(DRIFT, 0.0) > 0.0

    def has_effect(self, index: int) -> bool:
        """Whether the effect acts in an event."""
        return bool(self.sitting.effects) and index >= self.begins


def people(numbers: Sequence[int], population: Population) -> Iterator[Person]:
    """Simulate the people of these numbers, without those whose effect stays unstable."""
    settings = population.settings()
    for number, one in zip(numbers, sittings(numbers, population.seed, settings), strict=True):
        if runs_away(one.hidden):
            continue
        rng = np.random.default_rng([population.seed, number, 2])
        left_out = str(rng.choice(CASES)) if rng.uniform() < OTHER_KIND else ""
        roles = tuple(_role(planned, left_out) for planned in one.events)
        drive = [index for index, role in enumerate(roles) if role == "drive"]
        effects = drawn(number, population.seed, settings).effects
        yield Person(
            number, dataclasses.replace(one, effects=one.effects), effects[0].kind if effects else "", one.ratio, roles,
            drive[len(drive) // 2],
        )  # fmt: skip


def _role(planned: Planned, left_out: str) -> Role:
    number = int(planned.name.rsplit("_", 1)[1])
    if number > FIT + HELD:
        return "drive"
    if planned.event.case == left_out:
        return "none"
    return "fit" if number <= FIT else "held"
