"""Counting: what all sensors counted and lost since reset, over resets, restarts, silence and clocks set anew."""

from __future__ import annotations

from collections.abc import Mapping

from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.tilt import Vector, first_axis_rad
from biodyn_core.conditioning.timelines import Timelines
from biodyn_core.exposure.exposure_store import NOTHING_LOST, ExposureCheckpoint, Lost, SensorCheckpoint
from biodyn_core.exposure.sensor_meters import SensorMeters
from biodyn_core.pipeline.earlier_run import EarlierRun
from biodyn_core.pipeline.pipeline_settings import PipelineSettings


class Counting:
    """`count` what a sensor's conditioning brought forth; ask for the meters, and for what was `lost`.

    meters: of this run, by sensor. earlier: the run whose exposure goes on, mostly none.
    """

    def __init__(
        self, conditioners: Mapping[str, Conditioner], timelines: Timelines, settings: PipelineSettings
    ) -> None:
        self._conditioners, self._timelines, self._settings = conditioners, timelines, settings
        self._at_reset = dict.fromkeys(conditioners, NOTHING_LOST)
        self._clipping_at_reset = {name: conditioner.clipping() for name, conditioner in conditioners.items()}
        self.meters: dict[str, SensorMeters] = {}
        self.earlier = EarlierRun.none(conditioners)

    def count(self, sensor: str, blocks: list[Block]) -> None:
        """Count a sensor's blocks, on from an earlier run where there was one."""
        if sensor not in self.meters:
            conditioner = self._conditioners[sensor]
            meters = self._new_meters(sensor, conditioner.rate_hz, conditioner.status().vertical)
            self.meters[sensor] = self.earlier.resumed(sensor, meters)
        for block in blocks:
            self.meters[sensor].push(block)

    def since_reset(self) -> dict[str, SensorMeters]:
        """The meters of all sensors, those of an earlier run that have not come back among them."""
        return self.earlier.held | self.meters

    def rolling(self) -> dict[str, SensorMeters]:
        """The meters of the sensors that sent something within the window."""
        window_s = self._settings.window_s
        return {name: meters for name, meters in self.meters.items() if self._timelines.silent_s(name) <= window_s}

    def lost(self, sensor: str) -> Lost:
        """What a sensor lost since reset.

        Absent is what lies in gaps, or passed before it joined the others, in motion before it had been at rest,
        while its clock was set back, or since it fell silent.
        """
        # A rail that is found later, or turns out to be none, says so of the samples before the reset too.
        clipped = self._conditioners[sensor].clipping().before(self._clipping_at_reset[sensor])
        at_reset = self._at_reset[sensor]._replace(clipped=clipped)
        return self._lost(sensor).since(at_reset).and_before(self.earlier.lost(sensor))

    def _lost(self, sensor: str) -> Lost:
        status, timelines = self._conditioners[sensor].status(), self._timelines
        gap_s = max(0.0, status.gap_s + timelines.gap_s(sensor))
        # Where a sensor goes on from an earlier run, what passed between both is told from there.
        late_s = 0.0 if sensor in self.earlier.sensors else timelines.late_s(sensor)
        absent_s = status.unrested_s + status.set_back_s + gap_s + late_s + timelines.silent_s(sensor)
        return Lost(status.clipped, absent_s, status.filled_s, status.flat_s)

    def reset(self) -> None:
        """Start "since reset" anew: an earlier run is forgotten."""
        for meters in self.meters.values():
            meters.reset()
        self.earlier = EarlierRun.none(self._conditioners)
        self._timelines.reset()
        self._at_reset = {name: self._lost(name) for name in self._conditioners}
        self._clipping_at_reset = {name: conditioner.clipping() for name, conditioner in self._conditioners.items()}

    def resume(self, kept: ExposureCheckpoint) -> None:
        """Go on from an earlier run; raises InputError where its meters do not fit."""
        meters = {name: self._new_meters(name, 1.0 / one.rest.period_s) for name, one in kept.sensors.items()}
        self.earlier = EarlierRun.of(kept, self._conditioners, meters)

    def kept(self) -> dict[str, SensorCheckpoint]:
        """What every sensor counted since reset, as plain data."""
        sensors = dict(self.earlier.sensors)
        for name, meters in self.meters.items():
            conditioner = self._conditioners[name]
            newest_ns = conditioner.newest_ns or conditioner.first_ns
            if conditioner.rest is not None and newest_ns is not None:
                told_ns = newest_ns + round(1e9 * self._timelines.silent_s(name))
                sensors[name] = SensorCheckpoint(newest_ns, told_ns, self.lost(name), conditioner.rest, meters.kept())
        return sensors

    def _new_meters(self, sensor: str, rate_hz: float, vertical: Vector | None = None) -> SensorMeters:
        first_rad = first_axis_rad(vertical) if vertical else 0.0
        return SensorMeters(sensor, rate_hz, self._settings.window_s, self._settings.weightings(), first_rad)
