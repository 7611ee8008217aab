"""Earlier run: the one before this whose exposure goes on, until each of its sensors has come back."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.exposure.exposure_store import (
    NOTHING_LOST,
    STILL_AT_REST_S,
    ExposureCheckpoint,
    Lost,
    SensorCheckpoint,
)
from biodyn_core.exposure.sensor_meters import SensorMeters

Samples = tuple[Integers, Floats]

FIRST_SAMPLES: Final = 64
"""So many of a sensor that comes back tell its rate."""

SAME_RATE: Final = 0.05
"""A rate that differs by less is that of before: so few samples do not tell it better."""


class EarlierRun:
    """What was kept of an earlier run, or nothing: its sensors, what its meters hold, and what stood beside them."""

    def __init__(
        self,
        conditioners: Mapping[str, Conditioner],
        sensors: Mapping[str, SensorCheckpoint],
        held: Mapping[str, SensorMeters],
        beside: Mapping[str, Floats],
    ) -> None:
        self._conditioners, self.sensors, self.beside = conditioners, dict(sensors), dict(beside)
        self.held = dict(held)
        self._first: dict[str, list[Samples]] = {name: [] for name in sensors}

    @classmethod
    def none(cls, conditioners: Mapping[str, Conditioner]) -> EarlierRun:
        """There was none, or it is forgotten."""
        return cls(conditioners, {}, {}, {})

    @classmethod
    def of(
        cls, kept: ExposureCheckpoint, conditioners: Mapping[str, Conditioner], meters: Mapping[str, SensorMeters]
    ) -> EarlierRun:
        """What was kept, with new meters of its sensors that count on from it; InputError where they do not fit."""
        for sensor, one in kept.sensors.items():
            meters[sensor].resume(one.meters, 0.0)
        return cls(conditioners, kept.sensors, meters, kept.beside)

    def begun(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> Samples:
        """What of a sensor's samples is to be conditioned now: all, once the first ones have told that it is as before.

        If it comes back soon and at the same rate it has the gravity and vertical it had: a body in a vehicle seldom
        rests. Else, or with other settings, rest is looked for as ever.
        """
        if sensor not in self._first:
            return stamps_ns, samples_mps2
        first = self._first[sensor]
        first.append((stamps_ns, samples_mps2))
        if sum(stamps.shape[0] for stamps, _ in first) < FIRST_SAMPLES:
            return stamps_ns[:0], samples_mps2[:0]
        return self._decided(sensor)

    def waiting(self) -> list[tuple[str, Samples]]:
        """What waits of sensors that sent too little to be known again."""
        return [(name, self._decided(name)) for name, first in list(self._first.items()) if first]

    def _decided(self, sensor: str) -> Samples:
        """Let a sensor go on, or look for rest; returns all that waited."""
        stamps_ns, samples_mps2 = (np.concatenate(parts) for parts in zip(*self._first.pop(sensor), strict=True))
        before, given_ns = self.sensors[sensor], stamps_ns[:FIRST_SAMPLES][stamps_ns[:FIRST_SAMPLES] != 0]
        if given_ns.size > 1 and _is_of_rate(given_ns, before.rest.period_s):
            away_s = 1e-9 * (int(given_ns[0]) - before.newest_ns)
            if 0.0 <= away_s <= STILL_AT_REST_S:
                with contextlib.suppress(InputError):
                    self._conditioners[sensor].begin_known(before.rest, int(given_ns[0]))
        return stamps_ns, samples_mps2

    def resumed(self, sensor: str, meters: SensorMeters) -> SensorMeters:
        """The sensor's meters of this run, gone on from those that were held."""
        if sensor in self.held:
            meters.resume(self.held.pop(sensor).kept(), self.between_s(sensor))
        return meters

    def lost(self, sensor: str) -> Lost:
        """What a sensor lost in that run, and between both."""
        if sensor not in self.sensors:
            return NOTHING_LOST
        before = self.sensors[sensor].lost
        return before._replace(absent_s=before.absent_s + self.between_s(sensor))

    def between_s(self, sensor: str) -> float:
        """What passed from where that run told of a sensor to its first stamp, or while it has none, to now."""
        if sensor not in self.sensors:
            return 0.0
        own, told_ns = self._conditioners[sensor], self.sensors[sensor].told_ns
        newest = [stamp for c in self._conditioners.values() if (stamp := c.newest_ns) is not None]
        reached_ns = own.first_ns if own.rest is not None else max(newest, default=None)
        return 0.0 if reached_ns is None else max(0.0, 1e-9 * (reached_ns - told_ns))


def _is_of_rate(stamps_ns: Integers, period_s: float) -> bool:
    """Whether stamps are a period apart: on average, as quantised ones are, or mostly, where samples were lost."""
    steps_s = 1e-9 * np.diff(stamps_ns)
    return any(
        abs(step_s / period_s - 1.0) < SAME_RATE for step_s in (float(steps_s.mean()), float(np.median(steps_s)))
    )
