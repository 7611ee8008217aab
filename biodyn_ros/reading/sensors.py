"""Reads a bag's sensors block by block: topics, choice of stamps, conditioning settings, and warnings about them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT
from biodyn_core.conditioning.clocks import ClockComparison
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_ros.bag import BagReader, LoggedImu, LogTimes, imu_blocks, open_bag
from biodyn_ros.base.progress import OnProgress
from biodyn_ros.reading.mapping import imu_topics, sensors_of
from biodyn_ros.reading.marks import Mark, marks_of
from biodyn_ros.reading.parts import CLOCK_SHARE, Bag, BagPart, Extent, latest_end_s, part_of
from biodyn_ros.reading.provenance import is_made_by_model
from biodyn_ros.reading.saturation import limits_of
from biodyn_ros.reading.stamps import SensorClock, choose_times, clock_warnings

FIRST_SAMPLES: Final = 21
"""The first samples of the seat, of which a stray stamp is not the begin of the bag."""

STRAY_FROM_S: Final = 1.0
STRAY_SPREADS: Final = 4.0
"""A stamp is stray if it is so far from the median of these, and farther than so many median distances: even
ones are within 2."""

AT_THE_END_S: Final = 10.0
"""The last sample of the seat is searched in so much log time first."""


@dataclass(frozen=True)
class ReadingOptions:
    """Options for reading the sensors of a bag: topic by sensor, clock ("header" or "log"), and conditioning."""

    mapping: dict[str, str] = field(default_factory=dict)
    time: str = "header"
    conditioning: ConditioningSettings | None = None


class SensorReading:
    """The sensors of an open bag, or of a part: iterate over `blocks` once; the warnings are complete afterwards.

    conditioning: settings by sensor, with the bag's own limits; times: "header" or "log", by sensor. InputError for a
    part outside the bag.
    """

    def __init__(
        self, reader: BagReader, options: ReadingOptions, part: BagPart | None = None, beside_s: float = 0.0
    ) -> None:
        self._reader = reader
        options, self._notes = _as_found(reader, part, options)
        self._sensors = sensors_of(reader, options.mapping)
        self.conditioning, limit_notes = limits_of(reader, self._sensors, options.conditioning)
        self._notes += limit_notes
        self._choices = choose_times(reader, self._sensors, options.time)
        self._clocks = {topic: ClockComparison() for topic in self._sensors}
        self.times = {sensor: self._choices[topic].time for topic, sensor in self._sensors.items()}
        self.made_by_model = is_made_by_model(reader)
        self._begin_ns: int | None = None
        self._extent = None if part is None or part.is_whole else self._extent_of(part, beside_s)

    def blocks(self, progress: OnProgress, gyro: bool = False) -> Iterator[tuple[str, LoggedImu]]:
        """Each sensor's next samples, in order of log time; `progress` is called with (samples done, all samples)."""
        total = sum(topic.messages for topic in self._reader.topics if topic.name in self._sensors)
        if self._extent is not None:
            total = round(total * self._extent.share)
        done = 0
        for topic, block in self._imu_blocks(gyro):
            if self._begin_ns is None and self._sensors[topic] == SEAT:
                self._begin_ns = next(iter(block.log_ns[block.stamps_ns != 0].tolist()), None)
            yield self._sensors[topic], block
            self._clocks[topic].push(block.header_ns, block.log_ns)
            done += len(block.stamps_ns)
            progress(min(done, total), total)

    def samples(self) -> Iterator[tuple[str, LoggedImu]]:
        """The samples of `blocks`, any number of times; without effect on the warnings."""
        return ((self._sensors[topic], block) for topic, block in self._imu_blocks(gyro=False))

    def _imu_blocks(self, gyro: bool) -> Iterator[tuple[str, LoggedImu]]:
        times = {topic: choice.time for topic, choice in self._choices.items()}
        if self._extent is None:
            return imu_blocks(self._reader, self._sensors, times, gyro)
        blocks = imu_blocks(self._reader, self._sensors, times, gyro, self._extent.within_ns)
        return self._extent.of(blocks)

    def first_of_seat(self) -> tuple[int, int]:
        """Stamp and log time, ns, of the seat's first sample, not of a stray one; raises InputError without any."""
        stamps_ns, logs_ns = np.zeros(0, np.int64), np.zeros(0, np.int64)
        for block in self._seat_blocks():
            is_set = block.stamps_ns != 0
            stamps_ns = np.append(stamps_ns, block.stamps_ns[is_set])[:FIRST_SAMPLES]
            logs_ns = np.append(logs_ns, block.log_ns[is_set])[:FIRST_SAMPLES]
            if stamps_ns.size == FIRST_SAMPLES:
                break
        if not stamps_ns.size:
            raise InputError(f"{self._reader.path}: the seat has no sample with a stamp")
        apart_ns = np.abs(stamps_ns - np.median(stamps_ns))
        at = int(np.argmax(apart_ns <= max(1e9 * STRAY_FROM_S, STRAY_SPREADS * float(np.median(apart_ns)))))
        return int(stamps_ns[at]), int(logs_ns[at])

    def _last_of_seat(self, log_ns: int) -> tuple[int, int]:
        """Stamp and log time, ns, of the seat's last sample; log_ns: the log time of its first one."""
        end_ns = self._reader.end_ns or log_ns
        for begin_ns in (max(log_ns, end_ns - round(1e9 * AT_THE_END_S)), log_ns):
            blocks = [block for block in self._seat_blocks((begin_ns, end_ns)) if block.stamps_ns.any()]
            if blocks:
                at = np.flatnonzero(blocks[-1].stamps_ns)[-1]
                return int(blocks[-1].stamps_ns[at]), int(blocks[-1].log_ns[at])
        return self.first_of_seat()

    def _seat_blocks(self, within_ns: LogTimes | None = None) -> Iterator[LoggedImu]:
        (topic,) = (topic for topic, sensor in self._sensors.items() if sensor == SEAT)
        return (block for _, block in imu_blocks(self._reader, [topic], self._choices[topic].time, within=within_ns))

    def _extent_of(self, part: BagPart, beside_s: float) -> Extent:
        stamp_ns, log_ns = self.first_of_seat()
        last_stamp_ns, last_log_ns = self._last_of_seat(log_ns)
        self._begin_ns = log_ns + round(1e9 * part.begin_s)
        stamped_s, logged_s = 1e-9 * (last_stamp_ns - stamp_ns), 1e-9 * (last_log_ns - log_ns)
        length_s = max(stamped_s, 1e-9 * ((self._reader.end_ns or log_ns) - log_ns))
        begins_after = part.begin_s >= (1.0 + CLOCK_SHARE) * length_s
        if begins_after or latest_end_s(length_s) < part.end_s < math.inf:
            raise InputError(f"{part}: outside the bag, which has {length_s:.2f} s")
        header_ns = log_ns - stamp_ns if self.times[SEAT] == "header" else 0
        begins = {
            topic: stamp_ns + (header_ns if choice.time == "log" else 0) for topic, choice in self._choices.items()
        }
        beside = {topic: 0.0 if sensor == SEAT else beside_s for topic, sensor in self._sensors.items()}
        drifts = {
            topic: (begins[topic], 1e-6 * part.clock_ppm[sensor])
            for topic, sensor in self._sensors.items()
            if sensor in part.clock_ppm and (part.time or self._choices[topic].time == "header")
        }
        extent = Extent.of_part(part, length_s, begins, beside, log_ns, abs(stamped_s - logged_s))
        return replace(extent, drifts=drifts)

    def bag_warnings(self) -> list[str]:
        """Warnings about the bag itself."""
        return [*map(str, self._reader.warnings), *self._notes]

    def marks(self) -> list[Mark]:
        """The marks of the recording or the part; empty before `blocks` has found the first sample of the seat."""
        found = [] if self._begin_ns is None else marks_of(self._reader, self._begin_ns)
        return found if self._extent is None else [mark for mark in found if 0.0 <= mark.time_s <= self._extent.seconds]

    def clock_warnings(self, seconds: float) -> list[str]:
        """Warnings about stamps and clocks of a record of this length."""
        clocks = {
            sensor: SensorClock(self._choices[topic], self._clocks[topic].result())
            for topic, sensor in self._sensors.items()
        }
        return clock_warnings(clocks, seconds)


def _as_found(reader: BagReader, part: BagPart | None, options: ReadingOptions) -> tuple[ReadingOptions, list[str]]:
    """Options with the topics and the clock of a part's events, and notes of what has no effect.

    Raises InputError if other ones are given. Given topics that the bag does not have may be of other bags of the same
    command.
    """
    if part is None or part.mapping is None:
        return options, []
    mapping = dict(part.mapping)
    of_topic, topics = sensors_of(reader, mapping), imu_topics(reader)
    found, notes = {sensor: topic for topic, sensor in of_topic.items()}, []
    for sensor, topic in options.mapping.items():
        known = f"{sensor}={found[sensor]}" if sensor in found else f"no {sensor}"
        if topic not in topics:
            notes.append(f"--map {sensor}={topic} has no effect: no such Imu topic, its events were found with {known}")
        elif of_topic.get(topic) != sensor:
            raise InputError(f"{part.label}: its events were found with {known}: omit --map, or find them again")
    if part.time == "header" and options.time == "log":
        raise InputError(f"{part.label}: its events were found by header stamps: run biodyn events with --time log")
    return replace(options, mapping=mapping, time=part.time or options.time), notes


def check_seat(status: SensorStatus, bag: str) -> None:
    """Raise InputError with the reason if a bag's seat gives no prediction."""
    if status.fault:
        raise InputError(f"{bag}: {status.fault}")
    if status.rate_hz is None:
        raise InputError(f"{bag}: seat: {status.waiting}")


@contextmanager
def open_sensors(bag: Bag, options: ReadingOptions, beside_s: float = 0.0) -> Iterator[SensorReading]:
    """Open a bag, or a part, to read its sensors; raises InputError for a bag without Imu or seat.

    beside_s: further time of the other sensors of a part, on both sides of the seat's.
    """
    part = part_of(bag)
    with open_bag(part.path) as reader:
        yield SensorReading(reader, options, part, beside_s)
