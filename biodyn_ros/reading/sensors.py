"""Reads a bag's sensors block by block: topics, choice of stamps, conditioning settings, and warnings about them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.clocks import ClockComparison
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_ros.bag import BagReader, LoggedImu, imu_blocks, open_bag
from biodyn_ros.base.progress import OnProgress
from biodyn_ros.reading.mapping import sensors_of
from biodyn_ros.reading.marks import Mark, marks_of
from biodyn_ros.reading.provenance import is_made_by_model
from biodyn_ros.reading.saturation import limits_of
from biodyn_ros.reading.stamps import SensorClock, choose_times, clock_warnings


@dataclass(frozen=True)
class ReadingOptions:
    """Options for reading the sensors of a bag: topic by sensor, clock ("header" or "log"), and conditioning."""

    mapping: dict[str, str] = field(default_factory=dict)
    time: str = "header"
    conditioning: ConditioningSettings | None = None


class SensorReading:
    """The sensors of an open bag: iterate over `blocks` once; the warnings are complete afterwards.

    conditioning: settings by sensor, with the bag's own limits; times: "header" or "log", by sensor.
    """

    def __init__(self, reader: BagReader, options: ReadingOptions) -> None:
        self._reader = reader
        self._sensors = sensors_of(reader, options.mapping)
        self.conditioning, self._limit_notes = limits_of(reader, self._sensors, options.conditioning)
        self._choices = choose_times(reader, self._sensors, options.time)
        self._clocks = {topic: ClockComparison() for topic in self._sensors}
        self.times = {sensor: self._choices[topic].time for topic, sensor in self._sensors.items()}
        self.made_by_model = is_made_by_model(reader)
        self._begin_ns: int | None = None

    def blocks(self, progress: OnProgress, gyro: bool = False) -> Iterator[tuple[str, LoggedImu]]:
        """Each sensor's next samples, in order of log time; `progress` is called with (samples done, all samples)."""
        total = sum(topic.messages for topic in self._reader.topics if topic.name in self._sensors)
        done = 0
        for topic, block in self._imu_blocks(gyro):
            if self._begin_ns is None:
                self._begin_ns = int(block.log_ns[0])
            yield self._sensors[topic], block
            self._clocks[topic].push(block.header_ns, block.log_ns)
            done += len(block.stamps_ns)
            progress(done, total)

    def samples(self) -> Iterator[tuple[str, LoggedImu]]:
        """The samples of `blocks`, any number of times; without effect on the warnings."""
        return ((self._sensors[topic], block) for topic, block in self._imu_blocks(gyro=False))

    def _imu_blocks(self, gyro: bool) -> Iterator[tuple[str, LoggedImu]]:
        times = {topic: choice.time for topic, choice in self._choices.items()}
        return imu_blocks(self._reader, self._sensors, times, gyro)

    def bag_warnings(self) -> list[str]:
        """Warnings about the bag itself."""
        return [*map(str, self._reader.warnings), *self._limit_notes]

    def marks(self) -> list[Mark]:
        """The marks of the recording; empty before `blocks` has found its start."""
        return [] if self._begin_ns is None else marks_of(self._reader, self._begin_ns)

    def clock_warnings(self, seconds: float) -> list[str]:
        """Warnings about stamps and clocks of a record of this length."""
        clocks = {
            sensor: SensorClock(self._choices[topic], self._clocks[topic].result())
            for topic, sensor in self._sensors.items()
        }
        return clock_warnings(clocks, seconds)


def check_seat(status: SensorStatus, bag: str) -> None:
    """Raise InputError with the reason if a bag's seat gives no prediction."""
    if status.fault:
        raise InputError(f"{bag}: {status.fault}")
    if status.rate_hz is None:
        raise InputError(f"{bag}: seat: {status.waiting}")


@contextmanager
def open_sensors(bag: str | Path, options: ReadingOptions) -> Iterator[SensorReading]:
    """Open a bag to read its sensors; raises InputError for a bag without Imu or seat."""
    with open_bag(bag) as reader:
        yield SensorReading(reader, options)
