"""Sessions that would give doubtful numbers: each reason is refused unless the user allows it by name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import known_are
from biodyn_ros.reading.events_file import FoundSession

LATE_S: Final = 1.0
"""A recorder starts its sensors within less."""

Refusal = Callable[[Sequence[FoundSession]], str]
"""What is wrong with the sessions and what to do about it, empty for nothing."""


def _no_rest(sessions: Sequence[FoundSession]) -> str:
    without = [one for one in sessions if not one.findings.rests and one.borrowed is None]
    if not without:
        return ""
    return (
        f"{without[0].bag}: no rest in {without[0].findings.seconds:.1f} s, so gravity is only the mean over motion;"
        " give a session of the same mounting with some seconds at rest as well"
    )


def _one_condition(sessions: Sequence[FoundSession]) -> str:
    cases = sorted({event.case for one in sessions for event in one.findings.events})
    if len(cases) != 1:
        return ""
    bags = ", ".join(str(one.bag) for one in sessions)
    return (
        f"{bags}: all events are of one loading condition ({cases[0]}), a subject needs two;"
        " give a further session, or name the conditions (--cases)"
    )


def _late_sensor(sessions: Sequence[FoundSession]) -> str:
    for one in sessions:
        for fault in one.findings.faults:
            if fault.kind == "missing" and fault.begin_s == 0.0 and fault.end_s > LATE_S:
                return (
                    f"{one.bag}: {fault.sensor} joins {fault.end_s:.1f} s after the seat, earlier events lack it;"
                    " record with all sensors from the beginning"
                )
    return ""


REFUSALS: Final[Mapping[str, Refusal]] = {
    "no-rest": _no_rest, "one-condition": _one_condition, "late-sensor": _late_sensor
}  # fmt: skip


def check_sessions(sessions: Sequence[FoundSession], allowed: Collection[str]) -> None:
    """Raise InputError for the first reason that is not allowed."""
    for name, refusal in REFUSALS.items():
        if name not in allowed and (reason := refusal(sessions)):
            raise InputError(f"{reason}; or allow it (--allow {name})")


def parse_allowed(text: str) -> tuple[str, ...]:
    """The reasons of a list, separated by commas; raises InputError for an unknown one."""
    names = tuple(sorted({name.strip() for name in text.split(",")} - {""}))
    for name in names:
        if name not in REFUSALS:
            raise InputError(f"--allow: unknown '{name}'; {known_are(name, REFUSALS)}")
    return names
