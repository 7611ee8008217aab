"""Reads recordings from a bag for identification and validation, by the same path as replay, without ROS."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass

from biodyn_core.body.synthesis_settings import CASES
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.tilt import Vector
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_core.recording.recording import Recorder, Recording
from biodyn_core.recording.recording_settings import RecordingSettings
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.reading.gravity import gravity_of_part
from biodyn_ros.reading.parts import BESIDE_S, Bag, part_of
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.reading.sensors import ReadingOptions, open_sensors


@dataclass(frozen=True)
class RecordingOptions(ReadingOptions):
    """Options for reading a bag and masking its recordings.

    vertical: the vertical in the axes of sensors, if not found from gravity, as `PipelineSettings.vertical`. channels:
    whether the non-vertical channels are read too, `Recording.channels`.
    """

    vertical: str = ""
    recording: RecordingSettings | None = None
    channels: bool = False

    def verticals(self) -> dict[str, Vector]:
        """The given verticals by sensor; raises InputError for an invalid one."""
        return PipelineSettings(vertical=self.vertical).verticals()


def read_recordings(
    bag: Bag,
    case: str | None = None,
    options: RecordingOptions | None = None,
    progress: OnProgress = ignore_progress,
    gravity: Mapping[str, Gravity] | None = None,
) -> list[Recording]:
    """Read a bag's recordings, one for each run of its seat; case None: by the name of the file.

    `progress` is called with (samples done, all samples). gravity: of its sensors, as from `gravity_by_bag`; None to
    search this bag only. Raises InputError for a bag without Imu or seat, and as `Recorder.finish`.
    """
    options, part = options or RecordingOptions(), part_of(bag)
    verticals = options.verticals()
    with_rates = options.channels or not (options.recording or RecordingSettings()).keep_lean
    with open_sensors(part, options, BESIDE_S) as sensors:
        settings, named = sensors.conditioning, case or case_of(part)
        known = gravity_of_part(part, sensors, options, verticals) if gravity is None else gravity
        recorder = Recorder(named, part.label, settings, options.recording, verticals, options.channels, known)
        for sensor, block in sensors.blocks(progress, with_rates):
            recorder.push(sensor, block.stamps_ns, block.accel_mps2, block.gyro_radps)
        warnings = [*([MADE_BY_MODEL] if sensors.made_by_model else []), *sensors.bag_warnings()]
    recordings = recorder.finish()
    seconds = 1e-9 * float(recordings[-1].stamps_ns[-1] - recordings[0].stamps_ns[0])
    warnings += sensors.clock_warnings(seconds)
    return [dataclasses.replace(each, warnings=(*warnings, *each.warnings)) for each in recordings]


def case_of(bag: Bag) -> str:
    """The loading condition of a part, or by a bag's name: the only case in it, or the name without a trailing number.

    `rail_crossing_2.mcap` is rail, `gravel_03` is gravel; a name with two cases is a case of its own.
    """
    part = part_of(bag)
    if part.case is not None:
        return part.case
    path = part.path
    stem = path.stem if path.suffix in (".mcap", ".db3") else path.name
    named = [case for case in CASES if case in re.split(r"[^a-z]+", stem.lower())]
    return named[0] if len(named) == 1 else re.sub(r"[-_. ]*\d*$", "", stem) or stem
