"""The text output of `biodyn info`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from biodyn_core.base.wording import counted
from biodyn_ros.bag.cdr import IMU_TYPE
from biodyn_ros.base.wording import number, table

LEGEND: Final = "clock: drift of header stamps against log time; offset: smallest delay of log time after the header"
_MAX_KINDS: Final = 12

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
    """The document as text."""
    state = ", recovered" if document["recovered"] else ""
    messages = counted(document["messages"], "message")
    lines = [f"{document['bag']}: {document['storage']}{state}, {messages}, {document['seconds']:.1f} s"]
    if rows := document["topics"]:
        cells = [[show(row) for _, _, show in _COLUMNS] for row in rows]
        heads = [[name for name, _, _ in _COLUMNS], [unit for _, unit, _ in _COLUMNS]]
        legend = [LEGEND] if any(row["clock_ppm"] is not None for row in rows) else []
        below = [*_rejected_lines(rows), *legend]
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


def _rejected_lines(rows: list[dict[str, Any]]) -> list[str]:
    lines = []
    for row in rows:
        causes = [f"{n} {cause.replace('_', ' ')}" for cause, n in row["rejected_by_cause"].items() if n]
        if causes:
            lines.append(f"{row['sensor'] or row['topic']}: rejected {', '.join(causes)}")
    return lines


def _other_lines(others: list[dict[str, Any]]) -> list[str]:
    """The number of other topics by type, with one name each."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for other in others:
        kinds.setdefault(other["type"], []).append(other)
    width = max(len(kind) for kind in kinds)
    lines = [f"not {IMU_TYPE}: {counted(len(others), 'topic')}"]
    for kind, topics in [*kinds.items()][:_MAX_KINDS]:
        more = f" and {len(topics) - 1} more" if len(topics) > 1 else ""
        count = sum(topic["messages"] for topic in topics)
        messages = counted(count, "message ", "messages")
        lines.append(f"  {kind.ljust(width)}  {messages:>17}  {topics[0]['topic']}{more}")
    if len(kinds) > _MAX_KINDS:
        lines.append(f"  and {counted(len(kinds) - _MAX_KINDS, 'more type')}")
    return lines


def _replay_lines(replay: dict[str, Any], prefix: str) -> list[str]:
    if replay["refusal"]:
        refusal, _, _ = replay["refusal"].removeprefix(prefix).partition("; its topics: ")  # the table lists them
        return [f"replay: refused: {refusal}"]
    missing = f"; not in the bag: {', '.join(replay['missing'])}" if replay["missing"] else ""
    faults = [f"replay: without {fault}" for fault in replay["faults"]]
    return [f"replay: uses {', '.join(replay['sensors'])}{missing}", *faults]
