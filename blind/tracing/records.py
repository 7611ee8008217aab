"""One record of a row: a simulated sitting of a person as cases for the tracer, and its truth."""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from world import sensors
from world.effects.draw import Split, forms
from world.effects.effect import Effect
from world.effects.event import Event
from world.effects.sitting import START_NS, Plan, Sitting
from world.effects.sitting import drawn as sittings_drawn
from world.effects.wearing import Stream

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.problem import Case
from biodyn_core.recording.recording import Recorder
from biodyn_core.tracing.settings import FloorSettings
from blind.tracing.outcome import Cause
from blind.tracing.rows import Drawing

Floats = NDArray[np.float64]

COLOURED_MPS2: Final = 0.3
COLOURED_HZ: Final = 20.0
"""Rms and corner frequency of the coloured noise, on every axis of every body sensor."""

STATURE_M: Final = 1.75
"""No result depends on it."""


@dataclass(frozen=True, eq=False)
class Record:
    """The known part: the person without parameters, events for fitting, and held-out events."""

    subject: Subject
    train: tuple[Case, ...]
    held_out: tuple[Case, ...]
    left_out: tuple[str, ...] = ()
    """The error messages of events that cannot be read."""

    @property
    def cases(self) -> tuple[Case, ...]:
        """All events."""
        return (*self.train, *self.held_out)


HARDEST_MPS2: Final = 1.02 * FloorSettings().hard_shock_g * STANDARD_GRAVITY_MPS2
"""The noise and the clock of a sensor move its peaks by up to 1.2 %, as measured in 22 recordings of rails."""

PLAN: Final = Plan(uses=("fit", "held"), hardest_mps2=HARDEST_MPS2)
"""The least data for a verdict: 30 s of road, three potholes and three rails for fitting, and again held out."""


def sittings(drawing: Drawing, numbers: Sequence[int], seed: int, split: Split, plan: Plan = PLAN) -> list[Sitting]:
    """Records of a drawing by their numbers; each is independent of the others."""
    own_seed = int(np.random.SeedSequence([seed, zlib.crc32(drawing.name.encode())]).generate_state(1)[0])
    first, last = min(numbers), max(numbers)
    found = sittings_drawn(
        last - first + 1,
        own_seed,
        split,
        drawing.kinds,
        drawing.effects,
        drawing.level,
        plan,
        drawing.ratio,
        first=first,
        kinds_behind=drawing.background,
    )
    return [found[number - first] for number in numbers]


def record(one: Sitting, coloured: bool = False, with_effects: bool = True) -> Record:
    """The known part of a sitting, without events that cannot be read.

    Events of use `fit` are for fitting, the others are held out.
    """
    train: list[Case] = []
    held_out: list[Case] = []
    left_out: list[str] = []
    for index, planned in enumerate(one.events):
        name = f"{planned.use}/{planned.name}"
        streams = one.streams(index, with_effects)
        if coloured:
            streams = {
                name: _coloured(stream, name, planned.event, [one.seed, index]) for name, stream in streams.items()
            }
        try:
            found = _cases(planned.event, name, streams)
            (train if planned.use == "fit" else held_out).extend(found)
        except InputError as error:
            left_out.append(str(error))
    middle = Parameters.from_vector(0.5 * (LOWER + UPPER))
    subject = Subject("blind", one.body_mass_kg, STATURE_M, one.mass_matrix, middle)
    return Record(subject, tuple(train), tuple(held_out), tuple(left_out))


def causes(effects: Sequence[Effect]) -> tuple[Cause, ...]:
    """The true causes by the names of the catalogue."""
    return tuple(Cause(one.kind, _site(one), _family(one)) for one in effects)


def _site(effect: Effect) -> str:
    """The simulation numbers segments from 0, and sensors from the seat."""
    if effect.site < 0 or effect.kind not in CATALOGUE:
        return ""
    return SEGMENTS[effect.site - 1 if CATALOGUE[effect.kind].place == "sensor" else effect.site]


def _family(effect: Effect) -> str:
    """The catalogue's family of a simulated effect, by the simulation's forms of known classes."""
    if effect.kind in CATALOGUE:
        return CATALOGUE[effect.kind].family
    return _families().get(effect.family, effect.family)


@cache
def _families() -> dict[str, str]:
    return {form.family: CATALOGUE[form.kind].family for form in forms("development") if form.kind in CATALOGUE}


def _cases(event: Event, name: str, streams: dict[str, Stream]) -> list[Case]:
    recorder = Recorder(event.case, name, channels=True)
    for sensor, (stamps_ns, *stream) in streams.items():
        recorder.push(sensor, stamps_ns + START_NS + round(event.begin_s * 1e9), *stream)
    found = [Case.of(recording) for recording in recorder.finish()]
    # Runs of one event, separated by a gap of the seat, need different names.
    return [dataclasses.replace(one, name=f"{name}.{i}" if i else name) for i, one in enumerate(found)]


def _coloured(stream: Stream, sensor: str, event: Event, seed: Sequence[int]) -> Stream:
    """A stream with coloured noise on its forces during motion, because sensors are levelled at rest.

    The noise is drawn from the sitting's seed; the seat's stream does not change.
    """
    if sensor == SEAT:
        return stream
    stamps_ns, force_mps2, rates_radps = stream
    rng = np.random.default_rng([*seed, zlib.crc32(sensor.encode())])
    sos = signal.butter(2, COLOURED_HZ, fs=sensors.RATE_HZ, output="sos")
    noise = signal.sosfilt(sos, rng.standard_normal(force_mps2.shape), axis=0)
    moving = np.interp(1e-9 * stamps_ns, event.time_s, event.moving)
    return stamps_ns, force_mps2 + COLOURED_MPS2 * moving[:, None] * noise / noise.std(axis=0), rates_radps
