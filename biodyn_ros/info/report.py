"""Report: the content of a bag by Imu topic, and whether `biodyn replay` would accept it. Constant memory."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.conditioning.gravity_search import GravitySearch
from biodyn_ros.bag import BagReader, imu_blocks
from biodyn_ros.bag.storage import TopicInfo
from biodyn_ros.base.progress import OnProgress, ignore_progress
from biodyn_ros.info.survey import Survey, SurveyedTopic
from biodyn_ros.reading.gravity import search_gravity
from biodyn_ros.reading.mapping import SensorMap, imu_messages, imu_topics, map_sensors
from biodyn_ros.reading.saturation import limits_of
from biodyn_ros.reading.sensors import ReadingOptions, check_seat
from biodyn_ros.reading.stamps import choose_times, clock_warnings


@dataclass(frozen=True)
class ReplayReport:
    """The sensors that `biodyn replay` would use, the missing ones and the faults of others, or why it would refuse."""

    refusal: str | None
    sensors: list[str]
    missing: list[str]
    faults: list[str]


@dataclass(frozen=True)
class Report:
    """The content of a bag; messages: of all topics; other_topics: those that are not Imu."""

    bag: str
    storage: str
    recovered: bool
    messages: int
    seconds: float
    topics: list[SurveyedTopic]
    other_topics: list[TopicInfo]
    replay: ReplayReport
    warnings: list[str]


def info_of(reader: BagReader, bag: str, options: ReadingOptions, progress: OnProgress = ignore_progress) -> Report:
    """Read an open bag and return its report; bag: its name there.

    `progress` is called with (samples done, all samples). InputError for a mapped topic that is not in the bag.
    """
    sensors = map_sensors(reader, options.mapping)
    topics = imu_topics(reader)
    times = choose_times(reader, topics, options.time)
    names = {topic: sensors.sensors.get(topic) for topic in topics}
    settings, notes = limits_of(reader, {topic: name or topic for topic, name in names.items()}, options.conditioning)
    by_stamps = {name: choice.time for name, choice in times.items()}
    searches = {topic: GravitySearch(settings[name or topic]) for topic, name in names.items()}
    gravity = search_gravity(searches, imu_blocks(reader, topics, by_stamps))
    surveys = {
        topic: Survey(name, topic, times[topic], settings[name or topic], gravity.get(topic))
        for topic, name in names.items()
    }
    total, done = imu_messages(reader), 0
    for topic, block in imu_blocks(reader, topics, by_stamps):
        surveys[topic].push(block)
        done += len(block)
        progress(done, total)
    for survey in surveys.values():
        survey.finish()
    return _report(reader, bag, sensors, surveys, notes)


def _report(reader: BagReader, bag: str, sensors: SensorMap, surveys: dict[str, Survey], notes: list[str]) -> Report:
    seconds = 1e-9 * (reader.end_ns - reader.start_ns) if reader.start_ns is not None and reader.end_ns else 0.0
    clocks = {survey.name: survey.clock() for survey in surveys.values()}
    warnings = [*reader.warnings, *notes]
    warnings += [line for survey in surveys.values() for line in survey.warnings()]
    warnings += clock_warnings(clocks, seconds)
    copied = [name for name, clock in clocks.items() if clock.drift is not None and clock.drift.copied]
    if copied:
        warnings.append(f"{', '.join(copied)}: log times repeat the header stamps: the clocks cannot be compared")
    return Report(
        bag=bag,
        storage=reader.storage,
        recovered=reader.recovered,
        messages=reader.message_count,
        seconds=seconds,
        topics=[survey.result() for survey in surveys.values()],
        other_topics=[topic for topic in reader.topics if topic.name not in surveys],
        replay=_replay(bag, sensors, surveys),
        warnings=list(dict.fromkeys(warnings)),
    )


def _replay(bag: str, sensors: SensorMap, surveys: dict[str, Survey]) -> ReplayReport:
    seen = {survey.sensor: survey.replayed for survey in surveys.values() if survey.sensor}
    refusal = sensors.refusal
    if refusal is None:
        try:
            status = seen[SEAT]
            assert status is not None
            check_seat(status, bag)
        except InputError as error:
            refusal = str(error)
    used = [name for name in SENSORS if (status := seen.get(name)) and status.rate_hz is not None]
    return ReplayReport(
        refusal=refusal,
        sensors=[] if refusal else used,
        missing=[name for name in SENSORS if name not in seen],
        faults=[status.fault for status in seen.values() if status and status.fault],
    )
