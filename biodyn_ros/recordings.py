"""Recordings from a bag: what identification and validation fit to, read as replay reads it, without ROS."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from biodyn_core.clocks import ClockComparison
from biodyn_core.conditioning import ConditioningSettings
from biodyn_core.pipeline_settings import PipelineSettings
from biodyn_core.recording import Recorder, Recording, RecordingSettings
from biodyn_core.synthesis import CASES
from biodyn_ros.bag import imu_blocks, open_bag
from biodyn_ros.mapping import sensors_of
from biodyn_ros.provenance import MADE_BY_MODEL, is_made_by_model
from biodyn_ros.saturation import limits_of
from biodyn_ros.stamps import SensorClock, choose_times, clock_warnings


@dataclass(frozen=True)
class RecordingOptions:
    """How a bag is read: which topic is which sensor, whose clock, and how it is conditioned and masked.

    vertical: where sensors' axes see up if not by gravity, as `PipelineSettings.vertical`. channels: whether what they
    measure beside their vertical is read too, `Recording.channels`.
    """

    mapping: dict[str, str] = field(default_factory=dict)
    time: str = "header"
    vertical: str = ""
    conditioning: ConditioningSettings | None = None
    recording: RecordingSettings | None = None
    channels: bool = False


def read_recordings(
    bag: str | Path,
    case: str | None = None,
    options: RecordingOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Recording]:
    """Read a bag's recordings, one for each run of its seat; the case by the file's name where it is not given.

    `progress` hears (samples done, samples in all). Raises InputError for a bag without Imu or seat, and as
    `Recorder.finish`.
    """
    options = options or RecordingOptions()
    verticals = PipelineSettings(vertical=options.vertical).verticals()
    with_rates = options.channels or not (options.recording or RecordingSettings()).keep_lean
    with open_bag(bag) as reader:
        sensors = sensors_of(reader, options.mapping)
        conditioning, told = limits_of(reader, sensors, options.conditioning)
        recorder = Recorder(
            case or case_of(bag), str(bag), conditioning, options.recording, verticals, options.channels
        )
        times = choose_times(reader, sensors, options.time)
        clocks = {topic: ClockComparison() for topic in sensors}
        total = sum(topic.messages for topic in reader.topics if topic.name in sensors)
        done = 0
        by_topic = {name: choice.time for name, choice in times.items()}
        for topic, block in imu_blocks(reader, sensors, by_topic, with_rates):
            recorder.push(sensors[topic], block.stamps_ns, block.accel_mps2, block.gyro_radps)
            clocks[topic].push(block.header_ns, block.log_ns)
            done += len(block.stamps_ns)
            progress(done, total)
        warnings = [*map(str, reader.warnings), *told]
        if is_made_by_model(reader):
            warnings.insert(0, MADE_BY_MODEL)
    recordings = recorder.finish()
    seconds = 1e-9 * float(recordings[-1].stamps_ns[-1] - recordings[0].stamps_ns[0])
    compared = {sensors[topic]: SensorClock(times[topic], clocks[topic].result()) for topic in sensors}
    warnings += clock_warnings(compared, seconds)
    return [dataclasses.replace(each, warnings=(*warnings, *each.warnings)) for each in recordings]


def case_of(bag: str | Path) -> str:
    """The loading condition by a bag's name: the one case it names, or its name without a trailing number.

    `rail_crossing_2.mcap` is a rail, `gravel_03` is gravel; a name with two cases is a case of its own.
    """
    path = Path(bag)
    stem = path.stem if path.suffix in (".mcap", ".db3") else path.name
    named = [case for case in CASES if case in re.split(r"[^a-z]+", stem.lower())]
    return named[0] if len(named) == 1 else re.sub(r"[-_. ]*\d*$", "", stem) or stem
