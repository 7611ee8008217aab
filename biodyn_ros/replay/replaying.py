"""Replay: the live pipeline over a bag, as fast as possible, on the same causal path."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.conditioner import Mode
from biodyn_core.exposure.limits import EU_LIMITS, Limits
from biodyn_core.pipeline.frames import Frames
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros import __version__
from biodyn_ros.bag import BagWriter
from biodyn_ros.bag.blocks import measured_blocks, predicted_blocks
from biodyn_ros.bag.cdr import ACCEL_STAMPED_TYPE, encode_accel_stamped
from biodyn_ros.bag.files import files_of_directory
from biodyn_ros.bag.trajectories import JOINT_TRAJECTORY_TYPE
from biodyn_ros.base import topics
from biodyn_ros.base.files import check_directory, check_keeps_inputs, make_directory, remove
from biodyn_ros.base.json_files import write_json
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.reading.gravity import gravity_of_part
from biodyn_ros.reading.parts import Bag, BagPart, part_of
from biodyn_ros.reading.sensors import ReadingOptions, check_seat, open_sensors
from biodyn_ros.replay.traces import Traces
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import ExposureReport, exposure_report, sensor_warnings

PREDICTED: Final = "predicted.mcap"
BLOCK: Final = 64
"""Most samples of a block in the bag."""

REPORT: Final = "report.html"


@dataclass(frozen=True)
class ReplayOptions(ReadingOptions):
    """Options of reading and replaying a bag."""

    pipeline: PipelineSettings | None = None
    limits: Limits = EU_LIMITS
    mode: Mode = "causal"
    project: bool = False


@dataclass(frozen=True)
class Replayed:
    """Result of a replay, and its pipeline."""

    report: ExposureReport
    pipeline: Pipeline

    @cached_property
    def document(self) -> dict[str, Any]:
        """The mapping of exposure.json."""
        return exposure_document(self.report)


def replay(
    bag: Bag,
    subject: Subject,
    options: ReplayOptions | None = None,
    each: Callable[[Frames], Any] = lambda frames: None,
    progress: OnProgress = ignore_progress,
) -> Replayed:
    """Drive the pipeline with a bag and pass every push's frames to `each`.

    `progress` is called with (samples done, samples in all). Raises InputError for a bag without Imu or seat, or with a
    seat that allows no prediction.
    """
    options, part = options or ReplayOptions(), part_of(bag)
    with open_sensors(part, options) as sensors:
        settings = options.pipeline or PipelineSettings()
        gravity = gravity_of_part(part, sensors, options, settings.verticals())
        pipeline = Pipeline(subject, sensors.conditioning, settings, options.limits, options.mode, gravity)
        for sensor, block in sensors.blocks(progress):
            each(pipeline.push(sensor, block.stamps_ns, block.accel_mps2))
        each(pipeline.finish())
        warnings, marks = sensors.bag_warnings(), sensors.marks()
    check_seat(pipeline.status(SEAT), str(bag))
    warnings += [f"{name}: not in the bag" for name in SENSORS if name not in sensors.times]
    warnings += sensor_warnings(pipeline, sensors.times) + sensors.clock_warnings(pipeline.run_status().seconds)
    report = replace(
        exposure_report(pipeline, str(bag), options.project), warnings=warnings, times=sensors.times, marks=marks,
        is_made_by_model=sensors.made_by_model,
    )  # fmt: skip
    return Replayed(report, pipeline)


def replay_to_directory(
    bag: Bag,
    subject: Subject,
    directory: Path,
    options: ReplayOptions | None = None,
    progress: OnProgress = ignore_progress,
    predicted: bool = True,
    report: bool = True,
) -> Replayed:
    """Replay a bag into a directory: `predicted.mcap`, `exposure.json`, `report.html`; no file is left half-written.

    The directory is made with the first output, so that a refused bag leaves none. Files that are not requested are
    deleted, if an earlier replay wrote them. Raises InputError where that would delete the bag itself.
    """
    check_directory(directory)
    _check_predicted(directory / PREDICTED, part_of(bag))
    listeners: list[Callable[[Frames], None]] = []
    with contextlib.ExitStack() as open_files:
        if report:
            from biodyn_ros.replay.page import replay_page  # an extra of its own
            from biodyn_ros.reports.pages import check_reports, write_drawn

            check_reports()
            traces = Traces()
            listeners.append(traces.add)
        if predicted:
            listeners.append(_PredictedBag(directory, subject, str(bag), open_files).add)

        def each(frames: Frames) -> None:
            for listen in listeners:
                listen(frames)

        replayed = replay(bag, subject, options, each, progress)
    make_directory(directory)
    write_json(directory / "exposure.json", replayed.document)
    if not predicted:
        remove(directory / PREDICTED)
    if report:
        write_drawn(directory / REPORT, lambda: replay_page(replayed.report, traces))
    else:
        remove(directory / REPORT)
    return replayed


def _check_predicted(path: Path, part: BagPart) -> None:
    """Raise InputError for a path that an earlier replay did not write: a directory, or a file of the bag itself."""
    if path.is_dir():
        raise InputError(f"{path}: is a directory; a result has this name: give another directory for the results")
    for bag in filter(None, (part.path, part.rest_bag)):
        check_keeps_inputs(path, files_of_directory(bag, []) if bag.is_dir() else [bag])


class _PredictedBag:
    """Write every frame of a replay to a bag, with the live node's topics and stamps.

    The bag begins with the first frame; on failure it is removed with its new directories.
    """

    def __init__(self, directory: Path, subject: Subject, bag: str, open_files: contextlib.ExitStack) -> None:
        self._directory, self._open_files = directory, open_files
        self._metadata = {"subject": subject.name, "bag": bag, "version": __version__}
        self._blocks = predicted_blocks(subject.mass_matrix == "segment"), measured_blocks()
        self._writer: BagWriter | None = None

    def add(self, frames: Frames) -> None:
        """Add one push's frames; NaN is not written."""
        self._write(topics.PREDICTED, SEGMENTS, *frames.predicted[:2])
        self._write(topics.MEASURED, SENSORS, *frames.measured[:2])
        predicted, measured = self._blocks
        self._write_blocks(topics.PREDICTED_BLOCK, predicted.blocks(frames.predicted, BLOCK))
        self._write_blocks(topics.MEASURED_BLOCK, measured.blocks(frames.measured, BLOCK))

    def _write(self, names: dict[str, str], order: tuple[str, ...], stamps_ns: Integers, accel_mps2: Floats) -> None:
        if stamps_ns.size == 0:
            return
        if self._writer is None:
            self._writer = self._begin()
        for name, column in zip(order, accel_mps2.T, strict=True):
            known = ~np.isnan(column)
            stamps, values = (stamps_ns, column) if known.all() else (stamps_ns[known], column[known])
            if stamps.size:
                self._writer.write(topics.absolute(names[name]), stamps, encode_accel_stamped(stamps, values, name))

    def _write_blocks(self, name: str, blocks: Iterator[tuple[int, bytes]]) -> None:
        """Blocks are logged when they are complete, as live."""
        for last_ns, message in blocks:
            assert self._writer is not None  # begun with the single samples of these frames
            payload = np.frombuffer(message, np.uint8)[None]
            self._writer.write(topics.absolute(name), np.array([last_ns]), payload)

    def _begin(self) -> BagWriter:
        # Each removal is registered before the work that it undoes: an interruption may come between two lines.
        self._open_files.push(_unmake_on_failure(_new_directories(self._directory)))
        make_directory(self._directory)
        writer = BagWriter(self._directory / PREDICTED, compression="lz4", overwrite=True)
        self._open_files.push(writer)
        writer.__enter__()
        writer.add_metadata("biodyn", self._metadata)
        for topic in (*topics.PREDICTED.values(), *topics.MEASURED.values()):
            writer.add_topic(topics.absolute(topic), ACCEL_STAMPED_TYPE)
        for topic in (topics.PREDICTED_BLOCK, topics.MEASURED_BLOCK):
            writer.add_topic(topics.absolute(topic), JOINT_TRAJECTORY_TYPE)
        return writer


def _new_directories(directory: Path) -> list[Path]:
    """The directories that do not exist yet, innermost first."""
    return [path for path in (directory, *directory.parents) if not path.exists()]


def _unmake_on_failure(new: list[Path]) -> Callable[..., None]:
    """An exit callback that removes empty directories after an error."""

    def leave(kind: type[BaseException] | None, *_: object) -> None:
        with contextlib.suppress(OSError):
            for path in new if kind else []:
                path.rmdir()

    return leave
