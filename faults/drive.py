"""Pushes a ride through the pipeline in order of arrival, with a health check every half second, as the live node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.segments import SENSORS
from biodyn_core.pipeline.frames import Frames, joined
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.node.health import HealthMonitor, SensorHealth, Status
from faults.ride import SECONDS, START_NS, Arriving, subject

SLOT_S: Final = 0.02
CHECK_S: Final = 0.5


@dataclass(frozen=True, eq=False)
class HealthCheck:
    """The diagnostics at an instant of the ride, by sensor and for `prediction`."""

    time_s: float
    statuses: Mapping[str, Status]


@dataclass(frozen=True, eq=False)
class Driven:
    """The result of a ride: the pipeline, its frames and the health checks."""

    pipeline: Pipeline
    frames: Frames
    checks: tuple[HealthCheck, ...]


def drive(ride: Mapping[str, Arriving]) -> Driven:
    """Push the arrived samples, slot by slot."""
    pipeline, clock = Pipeline(subject()), [0.0]
    health = {name: SensorHealth(publishers=1, now=lambda: clock[0]) for name in SENSORS}
    monitor = HealthMonitor(pipeline, health)
    done, frames, checks = dict.fromkeys(SENSORS, 0), [], []
    for slot in range(1, round(SECONDS / SLOT_S) + 1):
        clock[0] = slot * SLOT_S
        for name, one in ride.items():
            end = int(np.searchsorted(one.arrival_s, clock[0]))
            part = slice(done[name], end)
            done[name] = end
            if part.start < part.stop:
                frames.append(pipeline.push(name, one.stamps_ns[part], one.accel_mps2[part]))
                health[name].arrived(part.stop - part.start)
        if slot % round(CHECK_S / SLOT_S) == 0:
            checks.append(HealthCheck(clock[0], {status.of: status for status in monitor.check()}))
    return Driven(pipeline, joined(frames), tuple(checks))


def seconds_of(stamps_ns: np.ndarray) -> np.ndarray:
    """Seconds of the ride by stamps."""
    return np.asarray(1e-9 * (stamps_ns - START_NS))
