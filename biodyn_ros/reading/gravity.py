"""Gravity of the sensors of a bag: found at rest in the whole record, or in other records of the same call."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from biodyn_core.base.segments import SEAT
from biodyn_core.conditioning.conditioner import settings_for
from biodyn_core.conditioning.gravity import Gravity, from_other_record, gravity_in_rest, of_session
from biodyn_core.conditioning.gravity_search import GravitySearch
from biodyn_core.conditioning.tilt import Vector
from biodyn_ros.bag import LoggedImu
from biodyn_ros.base.progress import ignore_progress
from biodyn_ros.reading.parts import Bag, BagPart, part_of
from biodyn_ros.reading.sensors import ReadingOptions, SensorReading, open_sensors

Gravities = dict[str, Gravity]
"""By sensor; without sensors that show no gravity or have a too short record."""


def search_gravity(
    searches: Mapping[str, GravitySearch], samples: Iterable[tuple[str, LoggedImu]], within_s: float = math.inf
) -> Gravities:
    """Search samples by name until all searches are decided, usually after the first second, or for a time."""
    begin_ns: int | None = None
    for name, block in samples:
        begin_ns = int(block.log_ns[0]) if begin_ns is None else begin_ns
        if block.log_ns[0] - begin_ns > 1e9 * within_s:
            break
        searches[name].push(block.stamps_ns, block.accel_mps2)
        if all(search.decided for search in searches.values()):
            break
    found = {name: search.result() for name, search in searches.items()}
    return {name: gravity for name, gravity in found.items() if gravity is not None}


def gravity_of(sensors: SensorReading, verticals: Mapping[str, Vector], within_s: float = math.inf) -> Gravities:
    """The gravity of every sensor of an open bag; verticals: the given ones; within_s: the searched part of the bag."""
    searches = {
        sensor: GravitySearch(settings_for(sensor, sensors.conditioning), verticals.get(sensor))
        for sensor in sensors.times
    }
    return search_gravity(searches, sensors.samples(), within_s)


def gravity_of_part(
    part: BagPart, sensors: SensorReading, options: ReadingOptions, verticals: Mapping[str, Vector]
) -> Gravities:
    """The gravity of every sensor of an open part: from its given rest, or from the first rest of the whole bag."""
    if part.is_whole:
        return gravity_of(sensors, verticals)
    found: Gravities = {}
    rest_s = part.rest_s
    if rest_s is None:
        found = _of_whole(part, options, verticals)
        rest_s = _first_rest_s(found.get(SEAT), sensors.conditioning[SEAT].rest_s)
    if rest_s is not None:
        found |= gravity_at_rest(part.beside(part.rest_bag or part.path, *rest_s), options)
    if not found.keys() >= sensors.times.keys():  # a sensor that moved in the rest, or joined later
        found = _of_whole(part, options, verticals) | found
    return found


def gravity_at_rest(rest: BagPart, options: ReadingOptions) -> Gravities:
    """The gravity of every sensor that does not move in a rest, a part of a bag."""
    samples: dict[str, list[LoggedImu]] = {}
    with open_sensors(rest, options) as sensors:
        for sensor, block in sensors.blocks(ignore_progress, gyro=True):
            samples.setdefault(sensor, []).append(block)
    found = {}
    for sensor, blocks in samples.items():
        rates = [np.full((len(b), 3), np.nan) if b.gyro_radps is None else b.gyro_radps for b in blocks]
        gravity = gravity_in_rest(np.concatenate([b.accel_mps2 for b in blocks]), np.concatenate(rates))
        if gravity is not None:
            found[sensor] = gravity
    return found


def _of_whole(part: BagPart, options: ReadingOptions, verticals: Mapping[str, Vector]) -> Gravities:
    with open_sensors(part.beside(part.path), options) as whole:
        return {sensor: of_session(gravity) for sensor, gravity in gravity_of(whole, verticals).items()}


def _first_rest_s(seat: Gravity | None, rest_s: float) -> tuple[float, float] | None:
    """The rest that a search in a whole bag has found; None without any."""
    return None if seat is None or seat.origin == "motion" else (seat.at_s, seat.at_s + rest_s)


def gravity_by_bag(bags: Sequence[Bag], options: ReadingOptions, verticals: Mapping[str, Vector]) -> list[Gravities]:
    """The gravity of every sensor in each bag: its own rest, that of another bag, or its mean over motion."""
    parts, own = [part_of(bag) for bag in bags], []
    for part in parts:
        with open_sensors(part, options) as sensors:
            own.append(gravity_of_part(part, sensors, options, verticals))
    found: dict[str, list[tuple[str, Gravity]]] = {}
    for part, of_bag in zip(parts, own, strict=True):
        for sensor, gravity in of_bag.items():
            found.setdefault(sensor, []).append((part.path.name, gravity))
    return [{sensor: from_other_record(gravity, found[sensor]) for sensor, gravity in of_bag.items()} for of_bag in own]
