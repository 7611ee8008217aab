"""The text output of `biodyn events`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Final

from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.base.wording import counted, number
from biodyn_core.sessions.findings import Event, Fault
from biodyn_ros.base.wording import table
from biodyn_ros.events.lacking import lacking_for_fit, lacking_for_trace
from biodyn_ros.reading.events_file import FoundSession

MOST_ROWS: Final = 40
"""More events than this are in the file and on the page only."""

_HEADS: Final = (("name", "start", "end", "peak", "aw", "shocks", ""), ("", "s", "s", "g", "m/s^2", "", ""))


def text_of(sessions: Sequence[FoundSession]) -> str:
    """The sessions as text."""
    lines: list[str] = []
    for one in sessions:
        lines += [*_session_lines(one), ""]
    for command, missing in (("fit", lacking_for_fit(sessions)), ("trace", lacking_for_trace(sessions))):
        lines += [f"for {command}: {line}" for line in missing] or [f"for {command}: enough events"]
    return "\n".join(lines)


def _session_lines(one: FoundSession) -> list[str]:
    found = one.findings
    counts = Counter(event.case for event in found.events)
    each = f": {', '.join(f'{count} {case}' for case, count in counts.items())}" if counts else ""
    rested_s = sum(rest.end_s - rest.begin_s for rest in found.rests)
    rests, events = counted(len(found.rests), "rest"), counted(len(found.events), "event")
    lines = [
        f"{one.bag}: {found.seconds:.1f} s, {rests} of {rested_s:.1f} s in all, {events}{each}",
        "",
    ]
    if found.events:
        lines += table([*_HEADS, *(_row(event) for event in found.events[:MOST_ROWS])], left=(0, 6))
    if len(found.events) > MOST_ROWS:
        lines.append(f"and {len(found.events) - MOST_ROWS} more")
    lines += _fault_lines(found.faults)
    return [*lines, *(f"note: {line}" for line in one.all_warnings)]


def _fault_lines(faults: Sequence[Fault]) -> Iterator[str]:
    """The faults of a sensor and kind, with the time of the first."""
    kinds: dict[tuple[str, str], list[Fault]] = {}
    for fault in faults:
        kinds.setdefault((fault.sensor, fault.kind), []).append(fault)
    for (sensor, kind), each in kinds.items():
        more = f" and {counted(len(each) - 1, 'more time')}" if len(each) > 1 else ""
        yield f"fault: {sensor}: {kind} from {each[0].begin_s:.1f} to {each[0].end_s:.1f} s{more}"


def _row(event: Event) -> tuple[str, ...]:
    return (
        event.name,
        f"{event.begin_s:.1f}",
        f"{event.end_s:.1f}",
        number(event.peak_mps2 / STANDARD_GRAVITY_MPS2),
        number(event.aw_mps2),
        str(len(event.shocks) or "-"),
        "; ".join(event.quality),
    )
