"""Histories of sensors' stamps alone, at five samples a second: silences, clocks that are set, orders of arrival."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.conditioning.runs import Runs
from biodyn_core.conditioning.timelines import Timelines

PERIOD_S: Final = 0.2
EPOCH_S: Final = 1_767_225_600.0
BREAK_S: Final = 0.5
"""A longer step between stamps ends a run."""


class Sends(NamedTuple):
    """When a sensor sends, and its clock: by how much it is set at which instants, and is ahead from the start."""

    stretches_s: tuple[tuple[float, float], ...]
    sets_s: tuple[tuple[float, float], ...] = ()
    ahead_s: float = 0.0

    def clock_s(self, time_s: float) -> float:
        """What the clock shows."""
        return EPOCH_S + time_s + self.ahead_s + sum(by for at, by in self.sets_s if time_s >= at)


class Stamps:
    """The part of a conditioner that timelines read."""

    def __init__(self) -> None:
        self.runs = Runs()
        self.first_ns: int | None = None
        self.newest_ns: int | None = None

    def push(self, stamp_ns: int) -> None:
        """Push one stamp; one that is just behind the newest is of a delayed sample, and is dropped."""
        if self.first_ns is None or self.newest_ns is None:
            self.first_ns = stamp_ns
        else:
            step_s = 1e-9 * (stamp_ns - self.newest_ns)
            if -1.0 <= step_s <= 0.0:
                return
            if not 0.0 < step_s <= BREAK_S:
                self.runs.end(stamp_ns, PERIOD_S)
        self.runs.add(stamp_ns, stamp_ns, PERIOD_S)
        self.newest_ns = stamp_ns


class Found(NamedTuple):
    """What timelines found of a sensor at the end: its missing time and the offset of its clock, s."""

    missing_s: float
    offset_s: float


def found(sensors: Mapping[str, Sends], seed: int = 0) -> dict[str, Found]:
    """What timelines find behind a history; the seed decides in which order samples arrive, within half a second."""
    stamps = {name: Stamps() for name in sensors}
    timelines = Timelines(stamps, 1.0)  # type: ignore[arg-type]
    for _, name, stamp_ns in sorted(_arrivals(sensors, np.random.default_rng(seed))):
        stamps[name].push(stamp_ns)
        timelines.update(name)
    return {
        name: Found(
            max(0.0, one.runs.gap_s + timelines.gap_s(name)) + timelines.late_s(name) + timelines.silent_s(name),
            timelines.offset_s(name),
        )
        for name, one in stamps.items()
    }


def _arrivals(sensors: Mapping[str, Sends], rng: np.random.Generator) -> Iterator[tuple[float, str, int]]:
    """The instant at which each sample arrives, its sensor and its stamp, ns; samples of a sensor keep their order."""
    for name, one in sensors.items():
        phase_s, lag_s, arrived_s = *rng.uniform(0.0, [0.1, 0.2]), -math.inf
        for begin_s, end_s in one.stretches_s:
            for time_s in np.arange(begin_s + phase_s, end_s, PERIOD_S):
                arrived_s = max(arrived_s, time_s + lag_s + rng.uniform(0.0, 0.3))
                yield arrived_s, name, round(1e9 * one.clock_s(time_s))
