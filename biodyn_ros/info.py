"""Info: what a bag holds, Imu topic by Imu topic, and whether `biodyn replay` would take it. One pass, flat memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.clocks import ClockComparison, ClockDrift
from biodyn_core.conditioned import SensorStatus
from biodyn_core.conditioning import Conditioner, ConditioningSettings
from biodyn_core.errors import InputError
from biodyn_core.segments import SEAT, SENSORS
from biodyn_ros.bag import BagReader, LoggedImu, imu_blocks, open_bag
from biodyn_ros.cdr import IMU_TYPE
from biodyn_ros.progress import OnProgress, unwatched
from biodyn_ros.reading.mapping import SensorMap, imu_topics, map_sensors
from biodyn_ros.reading.saturation import limits_of
from biodyn_ros.reading.sensors import ReadingOptions
from biodyn_ros.reading.stamps import SensorClock, TimeChoice, choose_times, clock_warnings
from biodyn_ros.replay.replaying import check_seat
from biodyn_ros.wording import number, stuck, table

CAUSES: Final = ("unset", "non_finite", "duplicate", "late", "stray")
UNEVEN_S: Final = 0.005
"""Stamps that are off an even clock by more than this and by more than half a period, on average, follow none."""

_MOST_STEPS: Final = 1 << 14
_MOST_KINDS: Final = 12


def info(
    bag: str | Path,
    options: ReadingOptions | None = None,
    progress: OnProgress = unwatched,
) -> dict[str, Any]:
    """Look through a bag and return the mapping of `biodyn info --json`.

    `progress` hears (samples done, samples in all). InputError for what is no bag and for a mapped topic not there.
    """
    options = options or ReadingOptions()
    with open_bag(bag) as reader:
        sensors = map_sensors(reader, options.mapping)
        topics = imu_topics(reader)
        times = choose_times(reader, topics, options.time)
        names = {topic: sensors.sensors.get(topic) for topic in topics}
        settings, told = limits_of(
            reader, {topic: name or topic for topic, name in names.items()}, options.conditioning
        )
        surveys = {topic: _Survey(name, topic, times[topic], settings[name or topic]) for topic, name in names.items()}
        total, done = sum(topic.messages for topic in reader.topics if topic.name in surveys), 0
        for topic, block in imu_blocks(reader, topics, {name: choice.time for name, choice in times.items()}):
            surveys[topic].push(block)
            done += len(block)
            progress(done, total)
        for survey in surveys.values():
            survey.finish()
        return _document(reader, str(bag), sensors, surveys, told)


class _Survey:
    """What is noted of one Imu topic; a mapped one is also conditioned as replay does, for what that would say."""

    def __init__(
        self, sensor: str | None, topic: str, choice: TimeChoice, settings: ConditioningSettings | None
    ) -> None:
        self.sensor, self.name, self.choice = sensor, sensor or topic, choice
        self._survey = Conditioner(self.name, settings, "survey")
        self._causal = Conditioner(sensor, settings) if sensor else None
        self._clocks = ClockComparison()
        self._steps = _Steps()
        self._messages = 0

    def push(self, block: LoggedImu) -> None:
        self._survey.push(block.stamps_ns, block.accel_mps2)
        if self._causal:
            self._causal.push(block.stamps_ns, block.accel_mps2)
        self._clocks.push(block.header_ns, block.log_ns)
        self._steps.push(block.stamps_ns)
        self._messages += len(block)

    def finish(self) -> None:
        self._survey.finish()

    @property
    def replayed(self) -> SensorStatus | None:
        """What replay would have seen; None for a topic that it does not take."""
        return self._causal.status() if self._causal else None

    def clock(self) -> SensorClock:
        return SensorClock(self.choice, self._clocks.result())

    def row(self, topic: str) -> dict[str, Any]:
        """One row of the document."""
        status, drift = self._survey.status(), self._clocks.result()
        if drift is not None and drift.copied:
            drift = None
        step_s = self._steps.median_s()
        return {
            "topic": topic,
            "sensor": self.sensor,
            "messages": self._messages,
            "time": self.choice.time,
            "rate_hz": status.rate_hz or (1.0 / step_s if step_s else None),
            **_clock_columns(drift),
            "jitter_ms": _ms(status.jitter_s),
            "median_step_ms": _ms(step_s),
            "longest_step_ms": _ms(self._steps.longest_s()),
            "gaps": max(status.runs - 1, 0),
            "gap_s": status.gap_s,
            "filled": status.filled,
            "rejected": status.rejected,
            "rejected_by_cause": {cause: getattr(status, cause) for cause in CAUSES},
            "flat": status.flat,
            "clipped": status.clipped,
            "gravity_mps2": status.gravity_mps2,
            "vertical": list(status.vertical) if status.vertical else None,
        }

    def warnings(self) -> list[str]:
        """What the survey has to say, a line each; a fault already begins with the name."""
        status = self._survey.status()
        lines = [status.fault] if status.fault else []
        if status.rate_hz is None and not status.fault:
            lines.append(f"{self.name}: too short to tell gravity, clock and gaps: rest_s of samples are needed")
        if status.rate_hz and status.jitter_s and status.jitter_s > max(0.5 / status.rate_hz, UNEVEN_S):
            lines.append(
                f"{self.name}: stamps are {1e3 * status.jitter_s:.0f} ms off an even clock on average: sampling is"
                " uneven, or the driver stamps late"
            )
        told = [*status.warnings, *([stuck(status.flat)] if status.flat else [])]
        return lines + [f"{self.name}: {text}" for text in told]


class _Steps:
    """Steps from stamp to stamp: the longest of all, and the median of a sample that does not grow without end."""

    def __init__(self) -> None:
        self._last = np.empty(0, dtype=np.int64)
        self._longest_ns = 0
        self._kept: list[np.ndarray[Any, np.dtype[np.int64]]] = []
        self._kept_count, self._every, self._seen = 0, 1, 0

    def push(self, stamps_ns: np.ndarray[Any, np.dtype[np.int64]]) -> None:
        stamps_ns = stamps_ns[stamps_ns != 0]
        steps_ns = np.diff(np.concatenate([self._last, stamps_ns]))
        if stamps_ns.size:
            self._last = stamps_ns[-1:]
        if not steps_ns.size:
            return
        self._longest_ns = max(self._longest_ns, int(steps_ns.max()))
        kept = steps_ns[-self._seen % self._every :: self._every]
        self._kept.append(kept)
        self._kept_count += kept.size
        self._seen += steps_ns.size
        if self._kept_count > _MOST_STEPS:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._kept_count, self._every = self._kept[0].size, 2 * self._every

    def median_s(self) -> float | None:
        return 1e-9 * float(np.median(np.concatenate(self._kept))) if self._kept else None

    def longest_s(self) -> float | None:
        return 1e-9 * self._longest_ns if self._kept else None


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds


def _clock_columns(drift: ClockDrift | None) -> dict[str, float | None]:
    """The header's clock against the recorder's; all None where nothing is known of it."""
    return {
        "clock_ppm": drift.ppm if drift else None,
        "clock_ppm_error": drift.ppm_error if drift else None,
        "offset_ms": _ms(drift.offset_s) if drift else None,
        "offset_scatter_ms": _ms(drift.scatter_s) if drift else None,
        "quantum_ms": _ms(drift.quantum_s) if drift else None,
    }


def _document(
    reader: BagReader, bag: str, sensors: SensorMap, surveys: dict[str, _Survey], told: list[str]
) -> dict[str, Any]:
    seconds = 1e-9 * (reader.end_ns - reader.start_ns) if reader.start_ns is not None and reader.end_ns else 0.0
    clocks = {survey.name: survey.clock() for survey in surveys.values()}
    warnings = [*reader.warnings, *told]
    warnings += [line for survey in surveys.values() for line in survey.warnings()]
    warnings += clock_warnings(clocks, seconds)
    copied = [name for name, clock in clocks.items() if clock.drift is not None and clock.drift.copied]
    if copied:
        warnings.append(f"{', '.join(copied)}: log times repeat the header stamps: nothing is known of the clocks")
    return {
        "bag": bag,
        "storage": reader.storage,
        "recovered": reader.recovered,
        "messages": reader.message_count,
        "seconds": seconds,
        "topics": [survey.row(topic) for topic, survey in surveys.items()],
        "other_topics": [
            {"topic": topic.name, "type": topic.type, "messages": topic.messages}
            for topic in reader.topics
            if topic.name not in surveys
        ],
        "replay": _replay(bag, sensors, surveys),
        "warnings": list(dict.fromkeys(warnings)),
    }


def _replay(bag: str, sensors: SensorMap, surveys: dict[str, _Survey]) -> dict[str, Any]:
    """What `biodyn replay` would do: the sensors it would use, those that are missing, or why it would refuse."""
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
    return {
        "refusal": refusal,
        "sensors": [] if refusal else used,
        "missing": [name for name in SENSORS if name not in seen],
        "faults": [status.fault for status in seen.values() if status and status.fault],
    }


# --- for people ------------------------------------------------------------------------------------------------------

_COLUMNS: Final[tuple[tuple[str, str, Callable[[dict[str, Any]], str]], ...]] = (
    ("topic", "", lambda row: row["topic"]),
    ("sensor", "", lambda row: row["sensor"] or "-"),
    ("messages", "", lambda row: str(row["messages"])),
    ("rate", "Hz", lambda row: f"{row['rate_hz']:.2f}" if row["rate_hz"] else "-"),
    ("time", "", lambda row: row["time"]),
    ("clock", "ppm", lambda row: _with_error(row["clock_ppm"], row["clock_ppm_error"])),
    ("offset", "ms", lambda row: _to_microseconds(row["offset_ms"])),
    ("jitter", "ms", lambda row: _to_microseconds(row["jitter_ms"])),
    ("step", "ms", lambda row: _to_microseconds(row["median_step_ms"])),
    ("longest", "ms", lambda row: _to_microseconds(row["longest_step_ms"])),
    ("gaps", "", lambda row: str(row["gaps"])),
    ("rejected", "", lambda row: str(row["rejected"])),
    ("clipped", "", lambda row: str(row["clipped"])),
    ("gravity", "m/s^2", lambda row: number(row["gravity_mps2"])),
    ("vertical", "", lambda row: " ".join(f"{v:.2f}" for v in row["vertical"]) if row["vertical"] else "-"),
)


def text_of(document: dict[str, Any]) -> str:
    """The document as a page of text."""
    state = ", recovered" if document["recovered"] else ""
    lines = [
        f"{document['bag']}: {document['storage']}{state}, {document['messages']} messages, {document['seconds']:.1f} s"
    ]
    if rows := document["topics"]:
        cells = [[show(row) for _, _, show in _COLUMNS] for row in rows]
        heads = [[name for name, _, _ in _COLUMNS], [unit for _, unit, _ in _COLUMNS]]
        below = [*_rejected_lines(rows), *_legend(rows)]
        lines += ["", *table([*heads, *cells], left=(0, 1)), *(["", *below] if below else [])]
    if document["other_topics"]:
        lines += ["", *_other_lines(document["other_topics"])]
    lines += ["", *_replay_lines(document["replay"], f"{document['bag']}: ")]
    return "\n".join([*lines, *(f"note: {line}" for line in document["warnings"])])


def _to_microseconds(milliseconds: float | None) -> str:
    return number(milliseconds if milliseconds is None else round(milliseconds, 3))


def _with_error(value: float | None, error: float | None) -> str:
    if value is None or error is None:
        return "–"
    digits = 2 if error < 0.1 else 1 if error < 5.0 else 0
    return f"{value:+.{digits}f} ± {error:.{digits}f}"


def _legend(rows: list[dict[str, Any]]) -> list[str]:
    if all(row["clock_ppm"] is None for row in rows):
        return []
    return ["clock: what header stamps gain on log time; offset: by how much log time is behind the header, at least"]


def _rejected_lines(rows: list[dict[str, Any]]) -> list[str]:
    lines = []
    for row in rows:
        causes = [f"{n} {cause.replace('_', ' ')}" for cause, n in row["rejected_by_cause"].items() if n]
        if causes:
            lines.append(f"{row['sensor'] or row['topic']}: rejected {', '.join(causes)}")
    return lines


def _other_lines(others: list[dict[str, Any]]) -> list[str]:
    """How many topics of each type there are besides, with one by name."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for other in others:
        kinds.setdefault(other["type"], []).append(other)
    width = max(len(kind) for kind in kinds)
    lines = [f"not {IMU_TYPE}: {len(others)} topics"]
    for kind, topics in [*kinds.items()][:_MOST_KINDS]:
        more = f" and {len(topics) - 1} more" if len(topics) > 1 else ""
        count = sum(topic["messages"] for topic in topics)
        lines.append(f"  {kind.ljust(width)}  {count:8d} messages  {topics[0]['topic']}{more}")
    if len(kinds) > _MOST_KINDS:
        lines.append(f"  and {len(kinds) - _MOST_KINDS} more types")
    return lines


def _replay_lines(replay: dict[str, Any], prefix: str) -> list[str]:
    if replay["refusal"]:
        refusal, _, _ = replay["refusal"].removeprefix(prefix).partition("; there is ")  # that stands above
        return [f"replay: refuses: {refusal}"]
    missing = f"; not in the bag: {', '.join(replay['missing'])}" if replay["missing"] else ""
    faults = [f"replay: without {fault}" for fault in replay["faults"]]
    return [f"replay: takes {', '.join(replay['sensors'])}{missing}", *faults]
