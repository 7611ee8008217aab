"""Continued exposure: a pipeline whose exposure since reset continues that of the run before."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT
from biodyn_core.exposure.checkpoint import ExposureCheckpoint, SensorCheckpoint
from biodyn_core.pipeline.exposure_counter import InitialExposure, InitialSensor
from biodyn_core.pipeline.frames import NO_FRAMES, Frames, joined
from biodyn_core.pipeline.pipeline import Pipeline

Samples = tuple[Integers, Floats]

STILL_AT_REST_S: Final = 60.0
"""A sensor that returns so soon has its former gravity and vertical; later it may have been taken off."""

FIRST_SAMPLES: Final = 64
"""The first samples of a sensor that show whether its rate is unchanged."""

SAME_RATE: Final = 0.05
"""A rate within this share of the former one counts as unchanged: the first samples do not show it more exactly."""


class ContinuedExposure:
    """Wrap a pipeline across restarts: `resume` from a checkpoint, `push` samples, make the next `checkpoint`.

    A sensor that returns soon and at its former rate keeps its gravity, vertical and clock, because a body in a
    vehicle is seldom at rest. Other sensors look for rest as in a first run. Without `resume` the pipeline runs
    unchanged.

    pipeline: read figures and statuses there.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self._sensors: Mapping[str, SensorCheckpoint] = {}
        self._first: dict[str, list[Samples]] = {}

    def resume(self, checkpoint: ExposureCheckpoint) -> None:
        """Continue a checkpoint, before the first sample; raises InputError where it does not fit the settings."""
        counter, sensors = self.pipeline.counter, {}
        for name, one in checkpoint.sensors.items():
            meters = counter.new_meters(name, 1.0 / one.rest.period_s)
            meters.resume(one.totals, 0.0)
            sensors[name] = InitialSensor(meters, one.losses, one.covered_ns)
        if SEAT in sensors:  # totals that do not fit are refused now, not at the seat's first sample
            self.pipeline.new_predictor(sensors[SEAT].meters.rate_hz).resume(checkpoint.prediction, 0.0)
        counter.initial = InitialExposure(sensors, checkpoint.prediction, checkpoint.elapsed_s)
        self._sensors, self._first = checkpoint.sensors, {name: [] for name in sensors}

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> Frames:
        """As `Pipeline.push`; the first samples of a sensor in the checkpoint wait until they show its rate."""
        if sensor in self._first:
            first = self._first[sensor]
            first.append((stamps_ns, samples_mps2))
            if sum(stamps.shape[0] for stamps, _ in first) < FIRST_SAMPLES:
                return NO_FRAMES
            stamps_ns, samples_mps2 = self._begin(sensor)
        return self.pipeline.push(sensor, stamps_ns, samples_mps2)

    def finish(self) -> Frames:
        """As `Pipeline.finish`, with the first samples that still wait."""
        waiting = [name for name, first in self._first.items() if first]
        return joined([*(self.pipeline.push(name, *self._begin(name)) for name in waiting), self.pipeline.finish()])

    def reset(self) -> None:
        """As `Pipeline.reset`; the checkpoint is dropped."""
        self._sensors, self._first = {}, {}
        self.pipeline.reset()

    def checkpoint(self, identity: Mapping[str, str]) -> ExposureCheckpoint | None:
        """The exposure since reset; None while nothing is counted. identity: see `ExposureCheckpoint`."""
        pipeline = self.pipeline
        sensors = dict(self._sensors)
        for name, meters in pipeline.counter.meters.items():
            conditioner = pipeline.conditioners[name]
            newest_ns = conditioner.newest_ns or conditioner.first_ns
            # Before its first level a sensor has counted nothing of this run, so its former state is still the newest.
            if conditioner.rest is not None and newest_ns is not None and meters.has_level:
                covered_ns = newest_ns + round(1e9 * pipeline.counter.absence_s(name))
                sensors[name] = SensorCheckpoint(
                    newest_ns, covered_ns, pipeline.losses(name), conditioner.rest, meters.totals()
                )
        prediction = pipeline.predictor.totals() if pipeline.predictor else pipeline.counter.initial.prediction
        return ExposureCheckpoint(identity, sensors, prediction, pipeline.counter.elapsed_s()) if sensors else None

    def _begin(self, sensor: str) -> Samples:
        """Begin a sensor at its former rest where that still holds; returns the samples that waited."""
        stamps_ns, samples_mps2 = (np.concatenate(parts) for parts in zip(*self._first.pop(sensor), strict=True))
        before, given_ns = self._sensors[sensor], stamps_ns[:FIRST_SAMPLES][stamps_ns[:FIRST_SAMPLES] != 0]
        if given_ns.size > 1 and _has_rate(given_ns, before.rest.period_s):
            break_s = 1e-9 * (int(given_ns[0]) - before.newest_ns)
            if 0.0 <= break_s <= STILL_AT_REST_S:
                with contextlib.suppress(InputError):
                    self.pipeline.conditioners[sensor].begin_known(before.rest, int(given_ns[0]))
        return stamps_ns, samples_mps2


def _has_rate(stamps_ns: Integers, period_s: float) -> bool:
    """Whether stamps are a period apart: on average (quantised stamps) or in the median (lost samples)."""
    steps_s = 1e-9 * np.diff(stamps_ns)
    return any(
        abs(step_s / period_s - 1.0) < SAME_RATE for step_s in (float(steps_s.mean()), float(np.median(steps_s)))
    )
