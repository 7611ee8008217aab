"""Sittings: events of one person for fitting, holding out and reporting, with and without hidden effects."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from world import body, ride, seats, sensors
from world.effects import absorbing, background, bags, event, mixture
from world.effects.background import Background
from world.effects.draw import KINDS, Split, effect
from world.effects.effect import Effect, Person
from world.effects.event import Event
from world.effects.mechanism import Mechanism
from world.effects.mixture import PAPER
from world.effects.moving import Party, moved, runs_away
from world.effects.wearing import Stream, stream

Floats = NDArray[np.float64]
Use = Literal["fit", "held", "report"]

USES: Final[tuple[Use, ...]] = ("fit", "held", "report")
START_NS: Final = 1_800_000_000_000_000_000


@dataclass(frozen=True)
class Plan:
    """How many events of a case there are for each use, and seconds of motion in one: 30 s of road, 3 and 3 shocks.

    levels: of the first events of each case and use, in multiples of a drawn motion; the others have 1. hardest_mps2:
    the least `Event.peak_mps2` of the hardest event of each use; it must be within reach of the cases.
    """

    counts: tuple[int, int, int] = (3, 3, 3)
    seconds: tuple[float, float, float] = (10.0, 6.0, 6.0)
    uses: tuple[Use, ...] = USES
    recorded: bool = True
    pause_s: tuple[float, float] = (3.0, 20.0)
    levels: tuple[float, ...] = ()
    hardest_mps2: float = 0.0

    def is_met(self, events: Sequence[Planned]) -> bool:
        """Whether each use has an event that is hard enough."""
        hard = {planned.use for planned in events if planned.event.peak_mps2 >= self.hardest_mps2}
        return hard >= set(self.uses)


PLAN: Final = Plan()
TOGETHER: Final = 6
"""Sittings that are moved at once: the accelerations of so many, with and without, are about 0.5 GB."""

FACTORS: Final = (*(0.5**n for n in range(1, 9)), 2.0, 4.0, 8.0)
"""Of a strength that makes a body run away, tried in turn."""

OF_SCALES: Final = 1
"""Marks the generator of the scales of a background."""

GLANCE_S: Final = 6.0
"""Of an event is enough to tell how far a person goes, and how much of an effect stays visible."""


@dataclass(frozen=True, eq=False)
class Planned:
    """One event in a sitting, its use, and the name of its file from case and number alone."""

    use: Use
    name: str
    event: Event


@dataclass(frozen=True, eq=False)
class Sitting:
    """One person's sitting. plain and hidden are accelerations by event, (n, 6) at `HELD_HZ`, without and with effects.

    Both have the same person, background, seats, mountings and noise. background is of the paper's kind, mechanisms are
    of the other kinds, scales has the scale of each. Every sensor in worn has a stream.
    """

    body_mass_kg: float
    theta: Floats
    mass_matrix: Literal["segment", "cascade"]
    person: Person
    background: Background
    level: float
    effects: tuple[Effect, ...]
    events: tuple[Planned, ...]
    worn: dict[str, sensors.Imu]
    plain: tuple[Floats, ...]
    hidden: tuple[Floats, ...]
    seed: int
    ratio: float | None = None
    mechanisms: tuple[Mechanism, ...] = ()
    scales: Mapping[str, float] = field(default_factory=dict)

    def party(self, effects: tuple[Effect, ...]) -> Party:
        """The person in all events."""
        events = [planned.event for planned in self.events]
        return Party(self.person, events, effects, self.background, self.mechanisms)

    def streams(self, index: int, with_effects: bool = True) -> dict[str, Stream]:
        """Output of the sensors in one event."""
        accel = (self.hidden if with_effects else self.plain)[index]
        changes = (*self.mechanisms, *(self.effects if with_effects else ()))
        happens = self.events[index].event
        up = np.column_stack([happens.accel_mps2[::2, 2], accel])
        return {
            name: stream(
                at, self.worn[name], happens, up[:, at], changes, self.background,
                np.random.default_rng([self.seed, index, at]),
            )
            for at, name in enumerate(ride.SENSORS)
            if name in self.worn
        }  # fmt: skip

    def write(self, directory: Path, with_effects: bool = True) -> list[Path]:
        """Bags `<use>/<case>_<number>.mcap`, and nothing of the truth."""
        paths = []
        for index, planned in enumerate(self.events):
            paths.append(directory / planned.use / f"{planned.name}.mcap")
            begin_ns = START_NS + round(planned.event.begin_s * 1e9)
            bags.write(paths[-1], self.streams(index, with_effects), begin_ns)
        return paths

    def truth(self) -> dict[str, Any]:
        """The truth for a scorer, as plain data."""
        return {
            "effects": [one.truth() for one in self.effects],
            "level": self.level,
            "background": dict(self.scales),
            "ratio": self.ratio,
            "theta": self.theta.tolist(),
            "mass_matrix": self.mass_matrix,
            "body_mass_kg": self.body_mass_kg,
            "origins": [planned.event.origin for planned in self.events],
        }


def drawn(
    count: int,
    seed: int,
    split: Split = "development",
    kinds: Sequence[str] = KINDS,
    effects: int = 1,
    level: float = 1.0,
    plan: Plan = PLAN,
    ratio: tuple[float, float] | None = None,
    chosen: Callable[[int], Effect] | None = None,
    first: int = 0,
    kinds_behind: Sequence[str] = (PAPER,),
) -> list[Sitting]:
    """Sittings that hide so many effects each (0: none), of different kinds, on a background of a level.

    kinds_behind: kinds of the background; level multiplies their scales, which `mixture.scales` draws. ratio: each
    sitting's effects are made stronger or weaker together until their own residual over the background's, as
    `absorbing.ratios` sees it, is about one drawn from this range; where that cannot be, it is what it is, and `truth`
    says it. chosen: the effect of a sitting by its number, instead of drawing. Sittings do not depend on count; first
    is the number of the first.
    """
    found: list[Sitting] = []
    end = first + count
    for begin in range(first, end, TOGETHER):
        rngs = [np.random.default_rng([seed, i]) for i in range(begin, min(begin + TOGETHER, end))]
        drafts = travelled([draft_of(begin + i, seed, plan, rng) for i, rng in enumerate(rngs)])
        settled = []
        for i, (draft, rng) in enumerate(zip(drafts, rngs, strict=True)):
            # A generator of their own: the draws of the paper's kind alone must not change.
            scales = mixture.scales(kinds_behind, np.random.default_rng([seed, begin + i, OF_SCALES]))
            behind = with_background(draft, {kind: level * scale for kind, scale in scales.items()}, rng)
            hiding = (chosen(begin + i),) if chosen else _hiding(split, kinds, effects, rng)
            settled.append(dataclasses.replace(behind, effects=hiding, level=level))
        if ratio and any(one.effects for one in settled):
            settled = absorbing.scaled(settled, [float(np.exp(rng.uniform(*np.log(ratio)))) for rng in rngs])
        found += steady(together(settled))
    return found


def with_background(draft: Sitting, scales: Mapping[str, float], rng: np.random.Generator) -> Sitting:
    """A sitting with a background of these scales by kind; rng draws the paper's kind."""
    return dataclasses.replace(
        draft,
        background=background.drawn(draft.person, scales.get(PAPER, 0.0), rng),
        mechanisms=mixture.mechanisms(draft.person, scales, [draft.seed]),
        scales=scales,
    )


def steady(sittings: Sequence[Sitting]) -> list[Sitting]:
    """The same with other strengths of effects that make a body unstable: by the first stable factor, or the last.

    Weaker by halves first; then stronger, because a law may be stiffer at a lower strength. All are simulated at once.
    """
    found = list(sittings)
    wild = [i for i, one in enumerate(found) if runs_away(one.hidden)]
    tried = with_effects([_scaled(found[i], factor) for i in wild for factor in FACTORS]) if wild else []
    for turn, i in enumerate(wild):
        mine = tried[turn * len(FACTORS) : (turn + 1) * len(FACTORS)]
        found[i] = next((one for one in mine if not runs_away(one.hidden)), mine[-1])
    return found


def _scaled(one: Sitting, factor: float) -> Sitting:
    return dataclasses.replace(one, effects=tuple(effect.scaled(factor) for effect in one.effects))


def together(sittings: Sequence[Sitting]) -> list[Sitting]:
    """Simulate all events of sittings, without and with hidden effects."""
    busy = [i for i, one in enumerate(sittings) if one.effects]
    went = moved([*(one.party(()) for one in sittings), *(sittings[i].party(sittings[i].effects) for i in busy)])
    hidden = dict(zip(busy, went[len(sittings) :], strict=True))
    return [
        dataclasses.replace(one, plain=went[i].accel_mps2, hidden=hidden.get(i, went[i]).accel_mps2)
        for i, one in enumerate(sittings)
    ]


def with_effects(sittings: Sequence[Sitting]) -> list[Sitting]:
    """Simulate all events of sittings with their effects; plain stays as it is."""
    went = moved([one.party(one.effects) for one in sittings])
    return [dataclasses.replace(one, hidden=each.accel_mps2) for one, each in zip(sittings, went, strict=True)]


def draft_of(number: int, seed: int, plan: Plan, rng: np.random.Generator) -> Sitting:
    """A person, the events to come and the sensors worn; every other person's M holds cascade masses."""
    people, row = body.drawn(2, rng), number % 2
    return Sitting(
        body_mass_kg=float(people.body_mass_kg[row]),
        theta=people.theta[row],
        mass_matrix="cascade" if people.cascade[row] else "segment",
        person=Person.of(people, row),
        background=background.NOTHING,
        level=0.0,
        effects=(),
        events=_planned(plan, rng),
        worn=ride.wear(rng),
        plain=(),
        hidden=(),
        seed=seed * 1_000_003 + number,
    )


def _planned(plan: Plan, rng: np.random.Generator) -> tuple[Planned, ...]:
    """All events, drawn again until one of each use is hard enough."""
    while not plan.is_met(found := _once_planned(plan, rng)):
        pass
    return found


def _once_planned(plan: Plan, rng: np.random.Generator) -> tuple[Planned, ...]:
    """All events; uses alternate, so that a change within the sitting affects each use."""
    sway, begin_s, found = rng.uniform(0.8, 1.25), 0.0, []
    numbers = dict.fromkeys([(use, case) for use in plan.uses for case in seats.CASES], 0)
    for turn in range(max(plan.counts)):
        for use, (case, count, seconds) in itertools.product(
            plan.uses, zip(seats.CASES, plan.counts, plan.seconds, strict=True)
        ):
            if turn >= count:
                continue
            origin = seats.ORIGINS[int(rng.integers(2))] if plan.recorded else "synthetic"
            numbers[use, case] += 1
            happens = event.drawn(case, origin, seconds, begin_s, sway, rng)
            if turn < len(plan.levels):
                happens = happens.at_level(plan.levels[turn])
            found.append(Planned(use, f"{case}_{numbers[use, case]}", happens))
            begin_s += happens.time_s[-1] + rng.uniform(*plan.pause_s)
    return tuple(dataclasses.replace(one, event=dataclasses.replace(one.event, whole_s=begin_s)) for one in found)


def _hiding(split: Split, kinds: Sequence[str], count: int, rng: np.random.Generator) -> tuple[Effect, ...]:
    chosen = rng.choice(sorted(kinds), count, replace=False)
    return tuple(effect(split, rng, (str(kind),)) for kind in chosen)


def travelled(sittings: Sequence[Sitting]) -> list[Sitting]:
    """Persons who know how far they go, from one event of each case that is for fitting."""
    few = [dataclasses.replace(one, events=first_of_each(one.events)) for one in sittings]
    travels = moved([one.party(()) for one in few])
    return [
        dataclasses.replace(
            one,
            person=dataclasses.replace(
                one.person,
                reach_m=np.median(went.reach_m, axis=0),
                rise_m=np.median(went.rise_m, axis=0),
                rate_mps=np.median(went.rate_mps, axis=0),
            ),
        )
        for one, went in zip(sittings, travels, strict=True)
    ]


def first_of_each(events: Sequence[Planned]) -> tuple[Planned, ...]:
    """The first event of each case, cut after `GLANCE_S` of motion."""
    first: dict[str, Planned] = {}
    for planned in events:
        first.setdefault(planned.event.case, planned)
    return tuple(dataclasses.replace(one, event=one.event.cut(GLANCE_S)) for one in first.values())
