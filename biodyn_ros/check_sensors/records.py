"""Reads the raw samples of named sensors from a bag, and cuts a recording in two."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.base.suggestions import did_you_mean
from biodyn_core.base.wording import counted
from biodyn_core.sensor_pairs.streams import Stream, stream_of
from biodyn_ros.bag import BagReader, LoggedImu, imu_blocks, open_bag
from biodyn_ros.base.progress import OnProgress
from biodyn_ros.base.wording import listed
from biodyn_ros.reading.mapping import imu_messages, imu_topics, map_sensors
from biodyn_ros.reading.stamps import choose_times

LOG_TIME: Final = "by the recorder's time: a delay of the transport looks like a clock fault"


@dataclass(frozen=True, eq=False)
class Record:
    """The streams of a recording by sensor or topic, and the reason for each that cannot be used."""

    bag: str
    seconds: float
    streams: Mapping[str, Stream]
    unusable: Mapping[str, str]
    notes: tuple[str, ...] = ()

    def between(self, begin_s: float, end_s: float) -> Record:
        """The recording from one instant up to another; a sensor without three samples there is unusable."""
        parts = {name: stream.between(begin_s, end_s) for name, stream in self.streams.items()}
        short = {name: "it has fewer than three samples" for name, part in parts.items() if part.stamps_s.size < 3}
        streams = {name: part for name, part in parts.items() if name not in short}
        return Record(self.bag, min(end_s, self.seconds) - begin_s, streams, {**self.unusable, **short}, self.notes)


@dataclass(frozen=True)
class RecordOptions:
    """Options for reading: topic by sensor, clock ("header" or "log"), length read from the start, s."""

    mapping: Mapping[str, str]
    time: str
    read_s: float


def topics_by_name(reader: BagReader, options: RecordOptions) -> dict[str, str]:
    """The topics of sensors by their names, and every Imu topic by its own; raises InputError for a bag without Imu."""
    found = map_sensors(reader, dict(options.mapping))
    imus = imu_topics(reader)
    if not imus:
        raise InputError(str(found.refusal))
    return {sensor: topic for topic, sensor in found.sensors.items()} | {name: name for name in imus}


def present_sensors(bag: str, options: RecordOptions) -> tuple[str, ...]:
    """The sensors that a bag has, in the order of `SENSORS`."""
    with open_bag(bag) as reader:
        names = topics_by_name(reader, options)
    return tuple(sensor for sensor in SENSORS if sensor in names)


def read_record(bag: str, names: Sequence[str], options: RecordOptions, progress: OnProgress) -> Record:
    """Read sensors or topics of a bag; raises InputError for one that the bag does not have."""
    with open_bag(bag) as reader:
        known = topics_by_name(reader, options)
        if missing := [name for name in names if name not in known]:
            near = did_you_mean(missing[0], known)
            raise InputError(f"{bag}: it has no sensor or Imu topic {missing[0]}; it has {listed(known)}{near}")
        topics = {known[name] for name in names}
        times = choose_times(reader, topics, options.time)
        parts, is_cut = _samples(
            reader, topics, {topic: choice.time for topic, choice in times.items()}, options.read_s, progress
        )
        warnings = [f"{bag}: {line}" for line in reader.warnings]
    firsts = [
        int(stamps[0]) for part in parts.values() for one in part if (stamps := one.stamps_ns[one.stamps_ns != 0]).size
    ]
    epoch_ns = min(firsts, default=0)
    streams, unusable = {}, {}
    for name in names:
        try:
            streams[name] = _stream(parts[known[name]], epoch_ns)
        except InputError as error:
            unusable[name] = str(error)
    seconds = max((float(stream.stamps_s[-1]) for stream in streams.values()), default=0.0)
    by_log = [name for name in names if times[known[name]].time == "log"]
    notes = [f"{bag}: {', '.join(by_log)}: {LOG_TIME}"] if by_log else []
    notes += [f"{bag}: only its first {options.read_s:g} s are read; --read-s reads more"] if is_cut else []
    notes += [f"{bag}: {line}" for line in _pauses(streams)]
    return Record(bag, seconds, streams, unusable, (*warnings, *notes))


def _pauses(streams: Mapping[str, Stream]) -> Iterator[str]:
    """A line for each sensor that pauses while another one goes on."""
    for name, stream in streams.items():
        pauses = stream.pauses_beside([other for other in streams.values() if other is not stream])
        if pauses:
            begin_s, end_s = pauses[0]
            more = f" and {counted(len(pauses) - 1, 'more pause')}" if len(pauses) > 1 else ""
            yield (
                f"{name}: no samples from {begin_s:.1f} to {end_s:.1f} s{more}, while another sensor goes on: they are"
                " lost, or its clock was set; nothing is compared there"
            )


def _samples(
    reader: BagReader, topics: set[str], times: Mapping[str, str], read_s: float, progress: OnProgress
) -> tuple[dict[str, list[LoggedImu]], bool]:
    """The blocks of each topic up to a length, and whether the bag is longer."""
    parts: dict[str, list[LoggedImu]] = {topic: [] for topic in topics}
    end_ns = (reader.start_ns or 0) + round(1e9 * read_s)
    done, total = 0, imu_messages(reader)
    for topic, block in imu_blocks(reader, sorted(topics), times, gyro=True):
        if block.log_ns[0] >= end_ns:
            return parts, True
        parts[topic].append(block)
        done += len(block)
        progress(done, total)
    return parts, False


def _stream(blocks: Sequence[LoggedImu], epoch_ns: int) -> Stream:
    """The stream of a topic's blocks."""
    if not blocks:
        raise InputError("it has no samples")
    gyros = [block.gyro_radps for block in blocks if block.gyro_radps is not None]
    return stream_of(
        np.concatenate([block.stamps_ns for block in blocks]),
        np.concatenate([block.accel_mps2 for block in blocks]),
        np.concatenate(gyros) if len(gyros) == len(blocks) else None,
        epoch_ns,
    )
