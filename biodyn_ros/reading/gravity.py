"""Gravity of the sensors of a bag: found at rest in the whole record, or in other records of the same call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from biodyn_core.conditioning.conditioner import gravity_search, settings_for
from biodyn_core.conditioning.gravity import Gravity, GravitySearch, from_other_record
from biodyn_core.conditioning.tilt import Vector
from biodyn_ros.bag import LoggedImu
from biodyn_ros.reading.sensors import ReadingOptions, SensorReading, open_sensors

Gravities = dict[str, Gravity]
"""By sensor; without sensors that show no gravity or have a too short record."""


def search_gravity(searches: Mapping[str, GravitySearch], samples: Iterable[tuple[str, LoggedImu]]) -> Gravities:
    """Search samples by name until all searches are decided, usually after the first second."""
    for name, block in samples:
        searches[name].push(block.stamps_ns, block.accel_mps2)
        if all(search.decided for search in searches.values()):
            break
    found = {name: search.result() for name, search in searches.items()}
    return {name: gravity for name, gravity in found.items() if gravity is not None}


def gravity_of(sensors: SensorReading, verticals: Mapping[str, Vector]) -> Gravities:
    """The gravity of every sensor of an open bag; verticals: the given ones."""
    searches = {
        sensor: gravity_search(settings_for(sensor, sensors.conditioning), verticals.get(sensor))
        for sensor in sensors.times
    }
    return search_gravity(searches, sensors.samples())


def gravity_by_bag(
    bags: Sequence[str | Path], options: ReadingOptions, verticals: Mapping[str, Vector]
) -> list[Gravities]:
    """The gravity of every sensor in each bag: its own rest, that of another bag, or its mean over motion."""
    own = []
    for bag in bags:
        with open_sensors(bag, options) as sensors:
            own.append(gravity_of(sensors, verticals))
    found: dict[str, list[tuple[str, Gravity]]] = {}
    for bag, of_bag in zip(bags, own, strict=True):
        for sensor, gravity in of_bag.items():
            found.setdefault(sensor, []).append((Path(bag).name, gravity))
    return [{sensor: from_other_record(gravity, found[sensor]) for sensor, gravity in of_bag.items()} for of_bag in own]
