"""The page of a trace: one HTML file that shows the residual, what took it away, and how far to believe it."""

from __future__ import annotations

from typing import Any, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.findings import ComparedEvent, Round, Trace
from biodyn_ros.base.wording import number, parameter_name, with_interval
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.reports.residuals import of_one_rate, over_frequency, over_time
from biodyn_ros.trace.document import event_document
from biodyn_ros.trace.drawings import RUNGS, ladder, surface_map
from biodyn_ros.trace.refit import outside, refitted_beside
from biodyn_ros.trace.text import USES, known_use
from biodyn_ros.trace.wording import (
    belief,
    diagnosed,
    effect_name,
    grouped,
    headline,
    parameters_of,
    sensors_said,
    subject_said,
    tone,
)

Document = dict[str, Any]

_ORDER: Final = ("held_out", "choose", "train")
"""Which event is drawn: a held-out one where there is any."""

_DEPARTURES: Final = 16
"""So many are shown, the first; trace.json has all."""


def trace_page(document: Document, trace: Trace) -> str:
    """The page of a trace and its document; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    worst = worst_event(trace)
    compared = [event for event in trace.events if worst is not None and event.use == worst.use]
    return render(
        "trace.html.j2",
        document=document,
        tone=tone(document),
        headline=headline(document),
        belief=belief(document),
        reasons=document["reasons"],
        subject_said=subject_said(document),
        sensors=sensors_said(document),
        refit=document.get("refit"),
        departures=document["departures"][:_DEPARTURES],
        diagnosed=diagnosed(document["diagnostics"]),
        added=[_added(effect) for effect in document["effects"] if effect["added"]],
        named=[_added(effect) for effect in document["effects"] if not effect["added"]],
        rivals=grouped(document["ambiguous_with"]),
        rows=(*MEASURED_SEGMENTS, "all"),
        uses={use: title for use, title in USES.items() if use in document["error"]["before"]},
        told={use: title for use, title in USES.items() if known_use(document["error"], use)},
        scale=_largest(document),
        moved=_moved(document),
        worst=worst,
        compared=len(compared),
        drawn=len(of_one_rate(compared)),
        time_svg=over_time(worst) if worst is not None else None,
        spectra_svg=over_frequency(compared),
        ladders=[(ladder(each), _objections(each)) for each in trace.rounds if each.ladder],
        surface_svg=surface_map(trace.surface) if trace.surface is not None else None,
    )


def worst_event(trace: Trace) -> ComparedEvent | None:
    """The event with the largest error after, of those held out where there are any; None where none is compared."""
    for use in _ORDER:
        errors = {event: event_document(event)["after"]["all"] for event in trace.events if event.use == use}
        known = {event: error for event, error in errors.items() if error is not None}
        if known:
            return max(known, key=known.__getitem__)
    return None


def _added(effect: Document) -> Document:
    """An effect as the page shows it, with its equation and mark from the catalogue."""
    known = CATALOGUE[effect["name"]]
    return {
        "name": effect_name(effect["name"], effect["site"]),
        "family": effect["family"],
        "equation": known.equation,
        "signature": known.signature,
        "parameters": parameters_of(effect),
    }


def _objections(found: Round) -> list[str]:
    """What speaks against each candidate that is drawn, where anything does."""
    rungs = [(rung.applied, rung.against) for rung in found.ladder[:RUNGS] if rung.against]
    return [f"{effect_name(applied.effect.name, applied.site)}: {', '.join(against)}" for applied, against in rungs]


def _largest(document: Document) -> float:
    """The end of the bars of errors, percent."""
    error = document["error"]
    known = [value for when in error.values() for use in when.values() for value in use.values() if value is not None]
    return max(known, default=1.0) or 1.0


def _moved(document: Document) -> list[tuple[str, Document]]:
    """Every parameter with its values as texts, and the lengths of its bars, 100 for the one that moved most."""
    moved = document["parameters_moved"]
    changes = ("refit_percent", "percent")
    most = max((abs(of[key]) for of in moved.values() for key in changes if of[key] is not None), default=0.0) or 1.0
    return [
        (
            parameter_name(name),
            {
                "given": _with_interval(of),
                "refitted": refitted_beside(of),
                "with_effect": number(of["with_effect"]),
                "outside": outside(of),
                "unit": of["unit"],
                **{key: of[key] for key in changes},
                **{f"{key}_length": 100.0 * abs(of[key] or 0.0) / most for key in changes},
            },
        )
        for name, of in moved.items()
    ]


def _with_interval(of: Document) -> str:
    """The value that was given, with its interval where the file has one."""
    if of["given"] is None or of["given_interval"] is None:
        return number(of["given"])
    value, lower, upper = with_interval(of["given"], *of["given_interval"])
    return f"{value} ({lower} to {upper})"
