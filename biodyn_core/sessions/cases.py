"""Cases: the loading conditions of events, by what the seat did or as a person states them, and names by condition."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from biodyn_core.sessions.findings import Event


@dataclass(frozen=True)
class CaseSpan:
    """A loading condition between two times, as a person states it."""

    begin_s: float
    end_s: float
    case: str


def named(events: Sequence[Event]) -> tuple[Event, ...]:
    """The events with names: their loading condition and a number within it, from 1 on."""
    counts: Counter[str] = Counter()
    found = []
    for event in events:
        counts[event.case] += 1
        found.append(dataclasses.replace(event, name=f"{event.case}_{counts[event.case]:02d}"))
    return tuple(found)


def _time_of(event: Event) -> float:
    """The time that decides the loading condition of an event: the peak of its shock, or its middle."""
    return event.peak_s if event.shocks else 0.5 * (event.begin_s + event.end_s)


def unused(events: Sequence[Event], spans: Sequence[CaseSpan]) -> list[CaseSpan]:
    """The spans that name no event."""
    times_s = [_time_of(event) for event in events]
    return [span for span in spans if not any(span.begin_s <= at_s < span.end_s for at_s in times_s)]


def with_cases(events: Sequence[Event], spans: Sequence[CaseSpan]) -> tuple[Event, ...]:
    """The events, with the loading condition of the span in which the peak of a shock, or the middle, lies."""
    found = []
    for event in events:
        at_s = _time_of(event)
        case = next((span.case for span in spans if span.begin_s <= at_s < span.end_s), event.case)
        found.append(dataclasses.replace(event, case=case))
    return named(found)
