"""Earlier run: the one before this whose exposure goes on, until each of its sensors has come back."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

import numpy as np

from biodyn_core.arrays import Floats, Integers
from biodyn_core.conditioning import Conditioner
from biodyn_core.errors import InputError
from biodyn_core.keeping import NOTHING_LOST, STILL_AT_REST_S, KeptExposure, KeptSensor, Lost
from biodyn_core.metering import SensorMeters


class EarlierRun:
    """What was kept of an earlier run, or nothing: its sensors, what its meters hold, and what stood beside them."""

    def __init__(
        self,
        conditioners: Mapping[str, Conditioner],
        sensors: Mapping[str, KeptSensor],
        held: Mapping[str, SensorMeters],
        beside: Mapping[str, Floats],
    ) -> None:
        self._conditioners, self.sensors, self.beside = conditioners, dict(sensors), dict(beside)
        self.held = dict(held)

    @classmethod
    def none(cls, conditioners: Mapping[str, Conditioner]) -> EarlierRun:
        """There was none, or it is forgotten."""
        return cls(conditioners, {}, {}, {})

    @classmethod
    def of(
        cls, kept: KeptExposure, conditioners: Mapping[str, Conditioner], meters: Mapping[str, SensorMeters]
    ) -> EarlierRun:
        """What was kept, with new meters of its sensors that count on from it; InputError where they do not fit."""
        for sensor, one in kept.sensors.items():
            meters[sensor].resume(one.meters, 0.0)
        return cls(conditioners, kept.sensors, meters, kept.beside)

    def begin(self, sensor: str, stamps_ns: Integers) -> None:
        """A sensor comes back: if soon, it has the gravity and vertical it had; a body in a vehicle seldom rests."""
        conditioner = self._conditioners[sensor]
        if sensor not in self.sensors or conditioner.first_ns is not None:
            return
        before, (given,) = self.sensors[sensor], np.nonzero(stamps_ns)
        if given.size and 0.0 <= 1e-9 * (int(stamps_ns[given[0]]) - before.newest_ns) <= STILL_AT_REST_S:
            with contextlib.suppress(InputError):  # other settings: rest is looked for as ever
                conditioner.begin_known(before.rest, int(stamps_ns[given[0]]))

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
        """What passed from a sensor's newest stamp in that run to its first, or while it has none, to now."""
        if sensor not in self.sensors:
            return 0.0
        own, newest_ns = self._conditioners[sensor], self.sensors[sensor].newest_ns
        newest = [stamp for c in self._conditioners.values() if (stamp := c.newest_ns) is not None]
        reached_ns = own.first_ns if own.rest is not None else max(newest, default=None)
        return 0.0 if reached_ns is None else max(0.0, 1e-9 * (reached_ns - newest_ns))
