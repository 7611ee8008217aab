"""Replay: the live pipeline over a bag, as fast as it goes, by the same causal path."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from biodyn_core.conditioning import ConditioningSettings
from biodyn_core.errors import InputError
from biodyn_core.limits import EU_LIMITS, Limits
from biodyn_core.pipeline import Frames, Pipeline, PipelineSettings
from biodyn_core.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.subject import Subject
from biodyn_ros import __version__, topics
from biodyn_ros.bag import BagWriter, imu_blocks, open_bag
from biodyn_ros.cdr import ACCEL_STAMPED_TYPE, encode_accel_stamped
from biodyn_ros.exposure_json import exposure_document, sensor_warnings
from biodyn_ros.mapping import sensors_of
from biodyn_ros.simulate import MADE_BY, MADE_BY_MODEL
from biodyn_ros.traces import Traces


@dataclass(frozen=True)
class ReplayOptions:
    """How a bag is replayed: which topic is which sensor, whose clock, and the pipeline's settings."""

    mapping: dict[str, str] = field(default_factory=dict)
    time: str = "header"
    conditioning: ConditioningSettings | None = None
    pipeline: PipelineSettings | None = None
    limits: Limits = EU_LIMITS


@dataclass(frozen=True)
class Replayed:
    """What a replay brought: the document of exposure.json and the pipeline behind it."""

    document: dict[str, Any]
    pipeline: Pipeline


def replay(
    bag: str | Path,
    subject: Subject,
    options: ReplayOptions | None = None,
    each: Callable[[Frames], Any] = lambda frames: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Replayed:
    """Drive the pipeline with a bag and hand every push's frames to `each`.

    `progress` hears (samples done, samples in all). Raises InputError for a bag without Imu or seat, or whose seat
    gives no prediction, saying why.
    """
    options = options or ReplayOptions()
    pipeline = Pipeline(subject, options.conditioning, options.pipeline, options.limits)
    with open_bag(bag) as reader:
        sensors = sensors_of(reader, options.mapping)
        total = sum(topic.messages for topic in reader.topics if topic.name in sensors)
        first_ns, last_ns, done = [], [], 0
        for topic, block in imu_blocks(reader, sensors, options.time):
            each(pipeline.push(sensors[topic], block.stamps_ns, block.accel_mps2))
            first_ns.append(int(block.stamps_ns[0]))
            last_ns.append(int(block.stamps_ns[-1]))
            done += len(block.stamps_ns)
            progress(done, total)
        each(pipeline.finish())
        warnings = [str(line) for line in reader.warnings]
        made_by_model = reader.metadata("biodyn").get("made_by") == MADE_BY
    _check_seat(pipeline, str(bag))
    warnings += [f"{name}: not in the bag" for name in SENSORS if name not in sensors.values()]
    warnings += [line for line in sensor_warnings(pipeline) if line.split(":")[0] in (*sensors.values(), "the model")]
    seconds = 1e-9 * (max(last_ns) - min(first_ns)) if first_ns else 0.0
    document = exposure_document(pipeline, str(bag), seconds, warnings)
    if made_by_model:
        document["bag_made_by_model"] = MADE_BY_MODEL
    return Replayed(document, pipeline)


def _check_seat(pipeline: Pipeline, bag: str) -> None:
    status = pipeline.status(SEAT)
    if status.fault:
        raise InputError(f"{bag}: {status.fault}")
    if status.rate_hz is None:
        raise InputError(
            f"{bag}: seat: shorter than the seconds of rest that gravity needs: record longer, or lower rest_s"
        )


class PredictedBag:
    """Writes every frame of a replay to a bag, topics and stamps as the live node publishes them."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        for topic in (*topics.PREDICTED.values(), *topics.MEASURED.values()):
            writer.add_topic(topics.absolute(topic), ACCEL_STAMPED_TYPE)

    def add(self, frames: Frames) -> None:
        """Add one push's frames; an instant without a number is not written."""
        self._write(topics.PREDICTED, SEGMENTS, frames.predicted.stamps_ns, frames.predicted.accel_mps2)
        self._write(topics.MEASURED, SENSORS, frames.measured.stamps_ns, frames.measured.accel_mps2)

    def _write(self, names: dict[str, str], order: tuple[str, ...], stamps_ns: Any, accel_mps2: Any) -> None:
        if stamps_ns.size == 0:
            return
        for column, name in enumerate(order):
            values = accel_mps2[:, column]
            here = ~np.isnan(values)
            if not here.all():
                stamps, values = stamps_ns[here], values[here]
            else:
                stamps = stamps_ns
            if stamps.size:
                self._writer.write(topics.absolute(names[name]), stamps, encode_accel_stamped(stamps, values, name))


def replay_to_directory(
    bag: str | Path,
    subject: Subject,
    directory: Path,
    options: ReplayOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    predicted: bool = True,
    report: bool = True,
) -> Replayed:
    """Replay a bag into a directory: `predicted.mcap`, `exposure.json`, `report.html`; nothing is left half-written."""
    _make(directory)
    listeners: list[Callable[[Frames], None]] = []
    with contextlib.ExitStack() as open_files:
        if report:
            from biodyn_ros.report import check_reports, write_replay_report  # an extra of its own

            check_reports()
            traces = Traces()
            listeners.append(traces.add)
        if predicted:
            writer = open_files.enter_context(
                BagWriter(directory / "predicted.mcap", compression="lz4", overwrite=True)
            )
            writer.add_metadata("biodyn", {"subject": subject.name, "bag": str(bag), "version": __version__})
            listeners.append(PredictedBag(writer).add)

        def each(frames: Frames) -> None:
            for listen in listeners:
                listen(frames)

        replayed = replay(bag, subject, options, each, progress)
    write_json(directory / "exposure.json", replayed.document)
    if report:
        write_replay_report(directory / "report.html", replayed.document, traces)
    return replayed


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{directory}: cannot be made a directory ({error.strerror})") from None


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON file beside and rename it, so that it is never half there."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(path)
