"""The page of sessions: a timeline, a waterfall and a table of events each, and the recordings still missing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from biodyn_core.base.segments import SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.gravity import angle_deg
from biodyn_core.conditioning.tilt import Vector
from biodyn_core.sessions.findings import Findings, Rest
from biodyn_ros import __version__
from biodyn_ros.events.drawings import colours_of, timeline
from biodyn_ros.events.lacking import lacking_for_fit, lacking_for_trace
from biodyn_ros.reading.events_file import FoundSession
from biodyn_ros.reports.frequency import waterfall
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.reports.verdict import Verdict


def events_page(sessions: Sequence[FoundSession]) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    return render(
        "events.html.j2",
        sessions=[_session(one) for one in sessions],
        total=sum(len(one.findings.events) for one in sessions),
        verdict=verdict_of(sessions),
        standard_g=STANDARD_GRAVITY_MPS2,
        version=__version__,
    )


def verdict_of(sessions: Sequence[FoundSession]) -> Verdict:
    """Whether the events suffice for a fit and for a trace; the reasons are the recordings still missing."""
    fit, trace = lacking_for_fit(sessions), lacking_for_trace(sessions)
    lines = [*(f"For fit: {line}" for line in fit), *(f"For trace: {line}" for line in trace)]
    if not lines:
        return Verdict("good", "Enough events for a fit and for a trace", ())
    headline = "Enough events for a fit, not for a trace" if not fit else "Further recordings are needed"
    return Verdict("warn", headline, tuple(lines))


def _session(one: FoundSession) -> dict[str, Any]:
    found = one.findings
    return {
        "bag": str(one.bag),
        "one": one,
        "found": found,
        "rested_s": sum(rest.end_s - rest.begin_s for rest in found.rests),
        "counts": Counter(event.case for event in found.events),
        "colours": colours_of(found),
        "warnings": one.all_warnings,
        "sensors": [name for name in SENSORS if any(name in rest.gravity_mps2 for rest in found.rests)],
        "tilts": tilts_deg(found.rests),
        "timeline_svg": timeline(found),
        "waterfall_svg": _waterfall(found),
    }


def tilts_deg(rests: Sequence[Rest]) -> list[dict[str, float]]:
    """By rest and sensor, the angle of gravity to that in the first rest of the sensor."""
    first: dict[str, Vector] = {}
    found = []
    for rest in rests:
        for name, mean in rest.gravity_mps2.items():
            first.setdefault(name, mean)
        found.append({name: angle_deg(first[name], mean) for name, mean in rest.gravity_mps2.items()})
    return found


def _waterfall(found: Findings) -> Any:
    """The waterfall of the seat, None for a record without a whole second."""
    if found.waterfall is None or found.waterfall.begins_ns.size == 0:
        return None
    return waterfall(found.waterfall, [("seat, vertical, low-passed", 0)], 0, "the first sample of the seat")
