"""Maps the topics of a bag to sensors: by topic name, or as given by `--map sensor=topic`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.base.suggestions import did_you_mean
from biodyn_ros.bag import BagReader
from biodyn_ros.bag.cdr import IMU_TYPE
from biodyn_ros.base.topics import INPUT
from biodyn_ros.base.wording import listed


@dataclass(frozen=True)
class SensorMap:
    """The sensor of each topic, and the reason in one line why these sensors cannot be replayed, None if they can."""

    sensors: dict[str, str]
    refusal: str | None


def parse_map(pairs: Iterable[str], kind: str = "topic") -> dict[str, str]:
    """Read `sensor=topic` pairs, or those of another kind of name; raises InputError naming the pair."""
    mapping: dict[str, str] = {}
    for pair in pairs:
        sensor, equals, topic = pair.partition("=")
        if not equals or not topic or sensor not in SENSORS:
            near = "" if sensor in SENSORS else did_you_mean(sensor, SENSORS)
            raise InputError(f"--map {pair}: expected sensor={kind} with a sensor of {', '.join(SENSORS)}{near}")
        if sensor in mapping or topic in mapping.values():
            raise InputError(f"--map {pair}: sensor or {kind} is given twice")
        mapping[sensor] = topic
    return mapping


def imu_topics(reader: BagReader) -> tuple[str, ...]:
    """The Imu topics of a bag that have messages."""
    return tuple(topic.name for topic in reader.topics if topic.type == IMU_TYPE and topic.messages)


def imu_messages(reader: BagReader) -> int:
    """The total number of messages of these topics."""
    return sum(topic.messages for topic in reader.topics if topic.type == IMU_TYPE)


def sensors_of(reader: BagReader, given: dict[str, str]) -> dict[str, str]:
    """Return {topic: sensor} for a bag; raises InputError for no Imu, no seat, or an unknown topic."""
    found = map_sensors(reader, given)
    if found.refusal:
        raise InputError(found.refusal)
    return found.sensors


def map_sensors(reader: BagReader, given: dict[str, str]) -> SensorMap:
    """Map topics to sensors, with the reason if that is not possible; raises InputError for an unknown given topic."""
    check_given(reader, given)
    imus = imu_topics(reader)
    if not imus:
        there = listed([f"{topic.name} ({topic.type})" for topic in reader.topics])
        return SensorMap({}, f"{reader.path}: no {IMU_TYPE} in the bag; its topics: {there}")
    found = {topic: sensor for sensor, topic in given.items()}
    refusal = None
    for sensor in SENSORS:
        if sensor in given:
            continue
        matches = [name for name in imus if f"/{name.lstrip('/')}".endswith(f"/{INPUT[sensor]}") and name not in found]
        if len(matches) > 1:
            refusal = refusal or (
                f"{reader.path}: {', '.join(matches)} match the {sensor}: choose one with --map {sensor}=TOPIC"
            )
        elif matches:
            found[matches[0]] = sensor
    if refusal is None and SEAT not in found.values():
        refusal = f"{reader.path}: no seat sensor among {listed(imus)}: give it with --map seat=TOPIC"
    return SensorMap(dict(sorted(found.items(), key=lambda item: SENSORS.index(item[1]))), refusal)


def check_given(reader: BagReader, given: dict[str, str]) -> None:
    """Raise InputError for a given topic that is no Imu of the bag."""
    imus = imu_topics(reader)
    for sensor, topic in given.items():
        if topic not in imus:
            there = f"{listed(imus)}{did_you_mean(topic, imus)}"
            raise InputError(f"{reader.path}: --map {sensor}={topic}: no such Imu topic; Imu topics: {there}")
