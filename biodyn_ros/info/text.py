"""The text output of `biodyn info`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from biodyn_core.base.wording import counted
from biodyn_ros.bag.cdr import IMU_TYPE
from biodyn_ros.bag.storage import TopicInfo
from biodyn_ros.base.wording import number, table
from biodyn_ros.info.report import ReplayReport, Report
from biodyn_ros.info.survey import SurveyedTopic

LEGEND: Final = "clock: drift of header stamps against log time; offset: smallest delay of log time after the header"
_MAX_KINDS: Final = 12

_COLUMNS: Final[tuple[tuple[str, str, Callable[[SurveyedTopic], str]], ...]] = (
    ("topic", "", lambda row: row.topic),
    ("sensor", "", lambda row: row.sensor or "-"),
    ("messages", "", lambda row: str(row.messages)),
    ("rate", "Hz", lambda row: f"{row.rate_hz:.2f}" if row.rate_hz else "-"),
    ("time", "", lambda row: row.time),
    ("clock", "ppm", lambda row: _with_error(row.drift.ppm, row.drift.ppm_error) if row.drift else "–"),
    ("offset", "ms", lambda row: _milliseconds(row.drift.offset_s if row.drift else None)),
    ("jitter", "ms", lambda row: _milliseconds(row.status.jitter_s)),
    ("step", "ms", lambda row: _milliseconds(row.median_step_s)),
    ("longest", "ms", lambda row: _milliseconds(row.longest_step_s)),
    ("gaps", "", lambda row: str(row.gaps)),
    ("rejected", "", lambda row: str(row.status.rejected)),
    ("clipped", "", lambda row: str(row.status.clipped)),
    ("gravity", "m/s^2", lambda row: number(row.status.gravity_mps2)),
    ("vertical", "", lambda row: " ".join(f"{v:.2f}" for v in row.status.vertical) if row.status.vertical else "-"),
)


def text_of(report: Report) -> str:
    """The report as text."""
    state = ", recovered" if report.recovered else ""
    messages = counted(report.messages, "message")
    lines = [f"{report.bag}: {report.storage}{state}, {messages}, {report.seconds:.1f} s"]
    if rows := report.topics:
        cells = [[show(row) for _, _, show in _COLUMNS] for row in rows]
        heads = [[name for name, _, _ in _COLUMNS], [unit for _, unit, _ in _COLUMNS]]
        legend = [LEGEND] if any(row.drift and row.drift.ppm is not None for row in rows) else []
        below = [*_rejected_lines(rows), *legend]
        lines += ["", *table([*heads, *cells], left=(0, 1)), *(["", *below] if below else [])]
    if report.other_topics:
        lines += ["", *_other_lines(report.other_topics)]
    lines += ["", *_replay_lines(report.replay, f"{report.bag}: ")]
    return "\n".join([*lines, *(f"note: {line}" for line in report.warnings)])


def _milliseconds(seconds: float | None) -> str:
    return number(None if seconds is None else round(1e3 * seconds, 3))


def _with_error(value: float | None, error: float | None) -> str:
    if value is None or error is None:
        return "–"
    digits = 2 if error < 0.1 else 1 if error < 5.0 else 0
    return f"{value:+.{digits}f} ± {error:.{digits}f}"


def _rejected_lines(rows: list[SurveyedTopic]) -> list[str]:
    lines = []
    for row in rows:
        causes = [f"{n} {cause.replace('_', ' ')}" for cause, n in row.rejected_by_cause.items() if n]
        if causes:
            lines.append(f"{row.sensor or row.topic}: rejected {', '.join(causes)}")
    return lines


def _other_lines(others: list[TopicInfo]) -> list[str]:
    """The number of other topics by type, with one name each."""
    kinds: dict[str, list[TopicInfo]] = {}
    for other in others:
        kinds.setdefault(other.type, []).append(other)
    width = max(len(kind) for kind in kinds)
    lines = [f"not {IMU_TYPE}: {counted(len(others), 'topic')}"]
    for kind, topics in [*kinds.items()][:_MAX_KINDS]:
        more = f" and {len(topics) - 1} more" if len(topics) > 1 else ""
        count = sum(topic.messages for topic in topics)
        messages = counted(count, "message ", "messages")
        lines.append(f"  {kind.ljust(width)}  {messages:>17}  {topics[0].name}{more}")
    if len(kinds) > _MAX_KINDS:
        lines.append(f"  and {counted(len(kinds) - _MAX_KINDS, 'more type')}")
    return lines


def _replay_lines(replay: ReplayReport, prefix: str) -> list[str]:
    if replay.refusal:
        refusal, _, _ = replay.refusal.removeprefix(prefix).partition("; its topics: ")  # the table lists them
        return [f"replay: refused: {refusal}"]
    missing = f"; not in the bag: {', '.join(replay.missing)}" if replay.missing else ""
    faults = [f"replay: without {fault}" for fault in replay.faults]
    return [f"replay: uses {', '.join(replay.sensors)}{missing}", *faults]
