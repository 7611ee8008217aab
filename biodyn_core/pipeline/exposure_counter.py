"""Exposure counter: exposure and losses of every sensor since the last reset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import SEAT
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.tilt import Vector, first_axis_rad
from biodyn_core.conditioning.timelines import JOINED_APART_S, Timelines
from biodyn_core.exposure.losses import NO_LOSSES, Losses
from biodyn_core.exposure.sensor_meters import SensorMeters
from biodyn_core.pipeline.pipeline_settings import PipelineSettings


class InitialSensor(NamedTuple):
    """Exposure of one sensor before this run: meters that hold it, its losses, and the stamp up to which both reach."""

    meters: SensorMeters
    losses: Losses
    end_ns: int


class InitialExposure(NamedTuple):
    """Exposure that counting starts from: by sensor, the totals of the prediction by name, and how long it lasted."""

    sensors: Mapping[str, InitialSensor]
    prediction: Mapping[str, Floats]
    elapsed_s: float


ZERO: Final = InitialExposure({}, {}, 0.0)


class ExposureCounter:
    """`count` conditioned blocks; read the meters `since_reset` or of the `rolling` window, and the `losses`.

    meters: by sensor, from its first block on. initial: exposure before this run, zero for a run of its own.
    lost_before_reset: all losses of a sensor up to the last reset, for figures that reach back beyond it. reset_ns: the
    seat's newest stamp then; None without a reset.
    """

    def __init__(
        self, conditioners: Mapping[str, Conditioner], timelines: Timelines, settings: PipelineSettings
    ) -> None:
        self._conditioners, self._timelines, self._settings = conditioners, timelines, settings
        self.meters: dict[str, SensorMeters] = {}
        self.initial = ZERO
        self.lost_before_reset = dict.fromkeys(conditioners, NO_LOSSES)
        self.reset_ns: int | None = None
        self._at_reset = dict.fromkeys(conditioners, NO_LOSSES)
        self._clipping_at_reset = {name: conditioner.clipping() for name, conditioner in conditioners.items()}

    def count(self, sensor: str, blocks: list[Block]) -> None:
        """Count a sensor's blocks."""
        if sensor not in self.meters:
            self.meters[sensor] = self._first_meters(sensor)
        for block in blocks:
            self.meters[sensor].push(block)

    def _first_meters(self, sensor: str) -> SensorMeters:
        conditioner = self._conditioners[sensor]
        vertical, in_motion = conditioner.status().vertical, not conditioner.begins_at_rest
        meters = self.new_meters(sensor, conditioner.rate_hz, vertical, in_motion)
        if sensor in self.initial.sensors:
            meters.resume(self.initial.sensors[sensor].meters.totals(), self.break_s(sensor))
        return meters

    def finish(self) -> None:
        """Count what waits, at the end of the run."""
        for meters in self.meters.values():
            meters.finish()

    def new_meters(
        self, sensor: str, rate_hz: float, vertical: Vector | None = None, begins_in_motion: bool = False
    ) -> SensorMeters:
        """Meters of a sensor that start at zero."""
        first_rad, s = first_axis_rad(vertical) if vertical else 0.0, self._settings
        return SensorMeters(sensor, rate_hz, s.window_s, s.weightings(), first_rad, begins_in_motion)

    def since_reset(self) -> dict[str, SensorMeters]:
        """The meters by sensor, also of sensors with initial exposure alone."""
        before = {name: one.meters for name, one in self.initial.sensors.items()}
        return before | {name: one for name, one in self.meters.items() if one.has_level or name in before}

    def rolling(self, silent_s: Mapping[str, float] | None = None) -> dict[str, SensorMeters]:
        """The meters of the sensors that sent usable samples within the window, which ends now for all of them.

        silent_s: time since a sensor's last message by another clock: stamps do not show that all sensors are silent.
        """
        found = {}
        for name, meters in self.meters.items():
            absent_s = max(self.absence_s(name), (silent_s or {}).get(name, 0.0))
            if meters.has_level and absent_s <= self._settings.window_s:
                meters.end_window(absent_s)
                found[name] = meters
        return found

    def losses(self, sensor: str) -> Losses:
        """The losses of a sensor since reset, initial ones included.

        Absent: gaps, the time before it joined the others, motion before its first rest, time while its clock was set
        back, and its present absence.
        """
        # A rail that is found or withdrawn later changes the samples before the reset too.
        clipped = self._conditioners[sensor].clipping().before(self._clipping_at_reset[sensor])
        at_reset = self._at_reset[sensor]._replace(clipped=clipped)
        losses = self._losses(sensor).since(at_reset).plus(self._initial_losses(sensor))
        meters = self.since_reset().get(sensor)
        return losses._replace(suspect_s=meters.suspect_s() if meters else 0.0)

    def _losses(self, sensor: str) -> Losses:
        """The losses of a sensor in this run."""
        status, timelines = self._conditioners[sensor].status(), self._timelines
        gap_s = max(0.0, status.gap_s + timelines.gap_s(sensor))
        late_s = self._late_s(sensor)
        absent_s = status.unrested_s + status.set_back_s + gap_s + late_s + self.absence_s(sensor)
        return Losses(status.clipped, absent_s, status.filled_s, status.flat_s, status.dead_s)

    def rolling_losses(self, sensor: str) -> Losses:
        """The losses since reset, and those before it as long as the rolling window reaches back beyond the reset."""
        losses = self.losses(sensor)
        reaches = self._timelines.elapsed_s() < self._settings.window_s
        return losses.plus(self.lost_before_reset[sensor]) if reaches else losses

    def absence_s(self, sensor: str) -> float:
        """Time since a sensor's last accepted sample: the others went on, or its own samples were rejected."""
        return max(self._timelines.silent_s(sensor), self._conditioners[sensor].status().unusable_s)

    def _certain_losses(self, sensor: str) -> Losses:
        """The losses that stay: what is withdrawn after a reset would hide later losses by as much.

        A real silence during an undecided leap counts once more after the reset, which is on the safe side.
        """
        losses, timelines = self._losses(sensor), self._timelines
        withdrawn_s = timelines.undecided_s(sensor) + self.absence_s(sensor) - timelines.silent_s(sensor)
        return losses._replace(absent_s=max(0.0, losses.absent_s - withdrawn_s))

    def _late_s(self, sensor: str) -> float:
        """Seconds of the exposure, initial one included, before a sensor without initial exposure joined."""
        # With initial exposure, the time before the first sample is the break after it.
        if sensor in self.initial.sensors or self._conditioners[sensor].rest is None:
            return 0.0
        return self._timelines.late_s(sensor, self._before_run_s())

    def elapsed_s(self) -> float:
        """Seconds since exposure began or was reset, runs before this one and the breaks between them included."""
        return self._before_run_s() + self._timelines.elapsed_s()

    def _before_run_s(self) -> float:
        """Seconds of the initial exposure, and of the break up to the first sensor of this run."""
        began = {name: ns for name, c in self._conditioners.items() if c.rest and (ns := c.first_ns) is not None}
        if not began:
            return self.initial.elapsed_s
        ends_ns = {name: one.end_ns for name, one in self.initial.sensors.items()}
        returned = [name for name in ends_ns if name in began]
        breaks_s = [1e-9 * (began[name] - ends_ns[name]) - self._timelines.joined_s(name) for name in returned]
        if not returned:
            breaks_s = [1e-9 * (min(began.values()) - end_ns) for end_ns in ends_ns.values()]
        # The shortest: other sensors were absent from the run before too. Below zero, a clock was set in between.
        return self.initial.elapsed_s + min((s for s in breaks_s if s > 0.0), default=0.0)

    def _initial_losses(self, sensor: str) -> Losses:
        if sensor not in self.initial.sensors:
            return NO_LOSSES
        losses = self.initial.sensors[sensor].losses
        return losses._replace(absent_s=losses.absent_s + self.break_s(sensor))

    def break_s(self, sensor: str) -> float:
        """Seconds from a sensor's initial exposure to its first sample, or to the newest of all before it has one.

        A clock that was set back in the break shows a time that is too short; then the time of the others counts.
        Known limit: one that was set back by less than the break is not found, because the shortest break is shared.
        """
        if sensor not in self.initial.sensors:
            return 0.0
        own = self._conditioners[sensor]
        newest = [stamp for c in self._conditioners.values() if (stamp := c.newest_ns) is not None]
        reached_ns = own.first_ns if own.rest is not None else max(newest, default=None)
        end_ns = self.initial.sensors[sensor].end_ns
        if reached_ns is None:
            return 0.0
        own_s, timelines = 1e-9 * (reached_ns - end_ns), self._timelines
        shared_s = self._before_run_s() - self.initial.elapsed_s
        shared_s += timelines.joined_s(sensor) if own.rest is not None else timelines.elapsed_s()
        # A longer one of its own is right: the sensor was absent from the run before too.
        return shared_s if own_s < max(0.0, shared_s - JOINED_APART_S) else own_s

    def reset(self) -> None:
        """Set everything "since reset" to zero, initial exposure included."""
        for name, before in self.lost_before_reset.items():
            self.lost_before_reset[name] = before.plus(self.losses(name))
        self.reset_ns = self._conditioners[SEAT].newest_ns
        for meters in self.meters.values():
            meters.reset()
        self.initial = ZERO
        self._timelines.reset()
        self._at_reset = {name: self._certain_losses(name) for name in self._conditioners}
        self._clipping_at_reset = {name: conditioner.clipping() for name, conditioner in self._conditioners.items()}
