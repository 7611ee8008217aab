"""What the events of sessions lack for `fit` and for `trace`, as a list of recordings still to be made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from biodyn_core.base.segments import MEASURED_SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.recording.recording import WARM_UP_S
from biodyn_core.sessions.findings import Event
from biodyn_core.tracing.data_checks import Contents, missing_from
from biodyn_core.tracing.settings import FloorSettings
from biodyn_ros.reading.events_file import FoundSession


def lacking_for_fit(sessions: Sequence[FoundSession]) -> list[str]:
    """Why a fit is not possible, or weak; a line each."""
    counts = Counter(event.case for one in sessions for event in one.findings.events)
    found = []
    worn = [name for name in MEASURED_SEGMENTS if any(_is_worn(one, name) for one in sessions)]
    if not worn:
        found.append("no sensor on the person: only the seat was measured")
    if len(counts) < 2:
        found.append(
            f"one loading condition only ({', '.join(counts)}): parameters that depend on the load stay unsure"
        )
    found += [f"{case}: one event, a second one is needed to hold out" for case, count in counts.items() if count == 1]
    return found


def lacking_for_trace(sessions: Sequence[FoundSession], settings: FloorSettings | None = None) -> list[str]:
    """What is missing for a verdict of a trace, if half of the events is fitted to; a line each."""
    s = settings or FloorSettings()
    has = contents([event for one in sessions for event in one.findings.events], s)
    half = Contents(0.5 * has.road_s, has.shocks // 2, has.hard_shocks // 2)
    return missing_from(half, "each half of the events", s)


def contents(events: Sequence[Event], settings: FloorSettings) -> Contents:
    """Seconds without shocks, after the warm-up, and numbers of shocks."""
    peaks_g = [shock.peak_mps2 / STANDARD_GRAVITY_MPS2 for event in events for shock in event.shocks]
    shocks = sum(peak >= settings.shock_g for peak in peaks_g)
    hard = sum(peak >= settings.hard_shock_g for peak in peaks_g)
    return Contents(sum(_road_s(events, settings)), shocks, hard)


def _road_s(events: Sequence[Event], settings: FloorSettings) -> Iterator[float]:
    for event in events:
        yield max(0.0, event.end_s - event.begin_s - WARM_UP_S - settings.apart_s * len(event.shocks))


def _is_worn(one: FoundSession, name: str) -> bool:
    return one.findings.statuses[name].accepted > 0
