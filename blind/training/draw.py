"""Draw randomised bodies: an effect, a background of several kinds, a plan of events, noise and sensors for each."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from world import ride
from world.effects import absorbing, mixture, sitting
from world.effects.draw import Split, forms
from world.effects.effect import WORN, Effect
from world.effects.sensor_mechanisms import SensorNoise
from world.effects.sitting import Plan, Sitting

from biodyn_core.base.segments import SEAT
from blind.tracing.rows import KINDS

OUTSIDE: Final = "outside"
TOGETHER: Final = 24
"""Bodies that are simulated at once: the cost of a step hardly grows with their number."""

Range = tuple[float, float]


@dataclass(frozen=True)
class TrainingSettings:
    """The distribution of bodies.

    nothing, two, outside: shares of bodies without an effect, with two effects of the catalogue's classes, and with one
    of no class; the others have one of the catalogue's classes. Classes are drawn evenly from kinds, forms evenly from
    those of a class in all splits. ratio: log-uniform range of the intended ratio. background: kinds of a background,
    see `mixture.scales`; bare: share of bodies without one. counts, seconds: least and most events for each use, and
    seconds of motion in each, by case; levels: see `Plan`. noise: log-uniform multiple of the sensors' noise. missing:
    share of bodies without one of the body's sensors.
    """

    nothing: float = 0.25
    two: float = 0.15
    outside: float = 0.15
    kinds: tuple[str, ...] = KINDS
    splits: tuple[Split, ...] = ("development", "second", "earlier")
    ratio: Range = (0.1, 10.0)
    background: tuple[str, ...] = mixture.KINDS
    bare: float = 0.12
    counts: tuple[tuple[int, int], ...] = ((3, 6), (2, 4), (2, 4))
    seconds: tuple[Range, ...] = ((4.0, 7.0), (4.0, 6.0), (4.0, 6.0))
    noise: Range = (1.0, 2.5)
    missing: float = 0.08
    uses: tuple[sitting.Use, ...] = ("fit", "held")
    recorded: bool = True
    levels: tuple[float, ...] = ()


@dataclass(frozen=True)
class TrainingBody:
    """The drawn facts of one body; ratio is intended, None without effects. missing: a sensor's name, or empty."""

    number: int
    effects: tuple[Effect, ...]
    ratio: float | None
    scales: Mapping[str, float]
    plan: Plan
    noise: float
    missing: str


def drawn(number: int, seed: int, settings: TrainingSettings | None = None) -> TrainingBody:
    """The facts of a body by (seed, number) alone; each of them has a generator of its own."""
    s = settings or TrainingSettings()
    effects = _effects(s, _generator(seed, number, "effects"))
    ratio = _log_uniform(s.ratio, _generator(seed, number, "ratio"))
    return TrainingBody(
        number,
        effects,
        ratio if effects else None,
        mixture.scales(s.background, _generator(seed, number, "background"), s.bare),
        _plan(s, _generator(seed, number, "plan")),
        _log_uniform(s.noise, _generator(seed, number, "noise")),
        _missing(s, effects, _generator(seed, number, "missing")),
    )


def sittings(numbers: Sequence[int], seed: int, settings: TrainingSettings | None = None) -> Iterator[Sitting]:
    """Simulate the bodies of these numbers in their order, `TOGETHER` at once."""
    for begin in range(0, len(numbers), TOGETHER):
        yield from _simulated([drawn(n, seed, settings) for n in numbers[begin : begin + TOGETHER]], seed)


def _generator(seed: int, number: int, fact: str) -> np.random.Generator:
    return np.random.default_rng([seed, number, zlib.crc32(fact.encode())])


def _log_uniform(between: Range, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(between))))


def _effects(s: TrainingSettings, rng: np.random.Generator) -> tuple[Effect, ...]:
    u = rng.uniform()
    if u < s.nothing:
        return ()
    if u < s.nothing + s.outside:
        return (_form(OUTSIDE, s, rng),)
    count = 2 if u < s.nothing + s.outside + s.two else 1
    return tuple(_form(str(kind), s, rng) for kind in rng.choice(s.kinds, count, replace=False))


def _form(kind: str, s: TrainingSettings, rng: np.random.Generator) -> Effect:
    """An effect of a class, with its site, shape and first strength."""
    of_kind = [form for split in s.splits for form in forms(split) if form.kind == kind]
    return of_kind[rng.integers(len(of_kind))].drawn(rng)


def _plan(s: TrainingSettings, rng: np.random.Generator) -> Plan:
    road, pothole, rail = (int(rng.integers(least, most, endpoint=True)) for least, most in s.counts)
    road_s, pothole_s, rail_s = (float(rng.uniform(*between)) for between in s.seconds)
    return Plan((road, pothole, rail), (road_s, pothole_s, rail_s), s.uses, s.recorded, levels=s.levels)


def _missing(s: TrainingSettings, effects: Sequence[Effect], rng: np.random.Generator) -> str:
    """A sensor on the body, never one that an effect changes, or empty."""
    taken = {ride.SENSORS[one.site] for one in effects if one.sites == WORN}
    free = [name for name in ride.WORN if name != SEAT and name not in taken]
    name = str(rng.choice(free))
    return name if rng.uniform() < s.missing else ""


def _simulated(bodies: Sequence[TrainingBody], seed: int) -> list[Sitting]:
    """Their sittings with effects of about the intended ratio where a strength gives it (`Sitting.ratio`).

    Held-out events are those for choosing; no error is reported of these bodies.
    """
    rngs = [_generator(seed, body.number, "person") for body in bodies]
    whole = [sitting.draft_of(body.number, seed, body.plan, rng) for body, rng in zip(bodies, rngs, strict=True)]
    drafts = [dataclasses.replace(one, events=tuple(filter(is_used, one.events))) for one in whole]
    found = [_with(body, draft, rng) for body, draft, rng in zip(bodies, sitting.travelled(drafts), rngs, strict=True)]
    busy = {i: body.ratio for i, body in enumerate(bodies) if body.ratio is not None}
    if busy:
        scaled = absorbing.scaled_once([found[i] for i in busy], list(busy.values()))
        for i, one in zip(busy, scaled, strict=True):
            found[i] = one
    return sitting.steady(sitting.together(found))


def is_used(one: sitting.Planned) -> bool:
    """Whether it is for fitting or, as every second one that is held out, for choosing."""
    return one.use == "fit" or int(one.name.rsplit("_", 1)[1]) % 2 == 1


def _with(body: TrainingBody, draft: Sitting, rng: np.random.Generator) -> Sitting:
    """A draft with the background, noise, sensors and effects of its body."""
    behind = sitting.with_background(draft, body.scales, rng)
    noise = SensorNoise.of(behind.person, body.noise, rng)
    return dataclasses.replace(
        behind,
        mechanisms=(*behind.mechanisms, noise),
        level=body.scales.get(mixture.PAPER, 0.0),
        worn={name: imu for name, imu in behind.worn.items() if name != body.missing},
        effects=body.effects,
    )
