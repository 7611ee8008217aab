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


def with_cases(events: Sequence[Event], spans: Sequence[CaseSpan]) -> tuple[Event, ...]:
    """The events, with the loading condition of the span in which the peak of a shock, or the middle, lies."""
    found = []
    for event in events:
        at_s = event.peak_s if event.shocks else 0.5 * (event.begin_s + event.end_s)
        case = next((span.case for span in spans if span.begin_s <= at_s < span.end_s), event.case)
        found.append(dataclasses.replace(event, case=case))
    return named(found)
