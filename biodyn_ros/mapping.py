"""Which topic of a bag carries which sensor: by its name, or as the user says with `--map sensor=topic`."""

from __future__ import annotations

from collections.abc import Iterable

from biodyn_core.errors import InputError
from biodyn_core.segments import SEAT, SENSORS
from biodyn_ros.bag import BagReader
from biodyn_ros.cdr import IMU_TYPE
from biodyn_ros.topics import INPUT


def parse_map(pairs: Iterable[str]) -> dict[str, str]:
    """Read `sensor=topic` pairs; raises InputError naming the pair."""
    mapping: dict[str, str] = {}
    for pair in pairs:
        sensor, equals, topic = pair.partition("=")
        if not equals or not topic or sensor not in SENSORS:
            raise InputError(f"--map {pair}: expected sensor=topic with a sensor of {', '.join(SENSORS)}")
        if sensor in mapping or topic in mapping.values():
            raise InputError(f"--map {pair}: sensor or topic is given twice")
        mapping[sensor] = topic
    return mapping


def sensors_of(reader: BagReader, given: dict[str, str]) -> dict[str, str]:
    """Return {topic: sensor} for a bag; raises InputError where there is no Imu, no seat, or a topic is unknown."""
    imus = [topic.name for topic in reader.topics if topic.type == IMU_TYPE and topic.messages]
    there = ", ".join(f"{topic.name} ({topic.type})" for topic in reader.topics[:12]) or "no topic at all"
    if not imus:
        raise InputError(f"{reader.path}: no {IMU_TYPE} in the bag; there is {there}")
    found: dict[str, str] = {}
    for sensor in SENSORS:
        if sensor in given:
            if given[sensor] not in imus:
                raise InputError(
                    f"{reader.path}: --map {sensor}={given[sensor]}: no such Imu topic; there is {', '.join(imus)}"
                )
            found[given[sensor]] = sensor
            continue
        matches = [name for name in imus if f"/{name.lstrip('/')}".endswith(f"/{INPUT[sensor]}")]
        if len(matches) > 1:
            raise InputError(
                f"{reader.path}: {', '.join(matches)} may all be the {sensor}: say which with --map {sensor}=TOPIC"
            )
        if matches and matches[0] not in given.values():
            found[matches[0]] = sensor
    if SEAT not in found.values():
        raise InputError(f"{reader.path}: no seat sensor among {', '.join(imus)}: name it with --map seat=TOPIC")
    return found
