"""The page of a trace: one HTML file with the verdict, its reliability, and the residual before and after."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.findings import ComparedEvent, Round, Trace
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.wording import parameter_name
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.reports.residuals import of_spectra, over_frequency, over_time, stable_events
from biodyn_ros.trace.document import PROOF
from biodyn_ros.trace.drawings import SHOWN, force_panels, ranking, surface_map
from biodyn_ros.trace.errors import USES, WHEN, errors_by_use, is_known, known, mean_errors
from biodyn_ros.trace.refit import parameter_changes
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.wording import (
    answer_rows,
    chance,
    diagnostic_lines,
    effect_name,
    force_place,
    grouped,
    headline,
    other_answers,
    parameters_of,
    probability,
    record_next,
    reliability,
    sensor_lines,
    subject_line,
    tone,
)

_ORDER: Final = ("held_out", "choose", "train")
"""The use of the drawn event: the first that has one."""

_NUISANCE: Final = 16
"""Number of nuisance parameters on the page; trace.json has all."""

_REMARKED: Final = 4
"""Number of candidates whose remarks are on the page, beside the chosen one and its rivals; trace.json has all."""


def trace_page(report: Report) -> str:
    """The page of a report; raises InputError if jinja2 or matplotlib is missing."""
    check_reports()
    trace, worst = report.trace, worst_event(report.trace)
    compared = [event for event in trace.events if worst is not None and event.use == worst.use]
    errors = {when: errors_by_use(trace, when) for when in WHEN}
    changes = parameter_changes(trace)
    percents = [abs(percent) for each in changes for percent in (each.refit_percent, each.percent) if percent]
    return render(
        "trace.html.j2",
        trace=trace,
        report=report,
        proof=PROOF,
        version=__version__,
        tone=tone(report),
        headline=headline(trace),
        reliability=reliability(trace),
        record_next=record_next(trace),
        subject_line=subject_line(trace),
        chance=chance(trace),
        probability=probability,
        sensors=sensor_lines(trace),
        nuisance=[(one.name, finite(one.typical_multiple)) for one in trace.nuisance[:_NUISANCE]],
        diagnostics=diagnostic_lines(trace.diagnostics),
        added=_effects(trace, trace.added),
        not_added=_effects(trace, trace.not_added),
        rivals=grouped(trace.ambiguous_with),
        rows=(*MEASURED_SEGMENTS, "all"),
        uses={use: title for use, title in USES.items() if use in errors["before"]},
        known_uses={use: title for use, title in USES.items() if is_known(trace, use)},
        errors=errors,
        floor=known(trace.floor_percent),
        scale=max((value for of in errors.values() for use in of.values() for value in use.values() if value),
                  default=1.0),
        events=[_event(event) for event in trace.events],
        changes=changes,
        largest_percent=max(percents, default=0.0) or 1.0,
        parameter_name=parameter_name,
        worst=worst,
        compared=len(compared),
        stable=len(stable_events(compared)),
        drawn=len(of_spectra(compared)),
        time_svg=over_time(worst) if worst is not None else None,
        spectra_svg=over_frequency(compared),
        rounds=[_round(each) for each in trace.rounds if each.ranking],
        forces=[(each, force_place(each), force_panels(each)) for each in trace.restoring_forces],
        surface_svg=surface_map(trace.surface) if trace.surface is not None else None,
    )  # fmt: skip


def worst_event(trace: Trace) -> ComparedEvent | None:
    """The event with the largest error after, of those held out if there are any; None without a compared event."""
    for use in _ORDER:
        errors = {event: mean_errors([event.after])["all"] for event in trace.events if event.use == use}
        finite_errors = {event: error for event, error in errors.items() if error is not None}
        if finite_errors:
            return max(finite_errors, key=finite_errors.__getitem__)
    return None


def _effects(trace: Trace, effects: Sequence[AppliedEffect]) -> list[tuple[str, Any, list[tuple[str, str]]]]:
    """Effects as the page shows them: title, effect of the catalogue, and parameters as text."""
    return [
        (effect_name(applied.effect.name, applied.site), applied.effect, parameters_of(applied, intervals))
        for applied, intervals in zip(trace.effects, trace.intervals, strict=True)
        if applied in effects
    ]


def _event(event: ComparedEvent) -> tuple[ComparedEvent, float, list[float | None]]:
    """An event with its length, s, and its errors of the subject as given, before and after."""
    seconds = len(event.measured_mps2) / event.rate_hz
    errors = [mean_errors([each])["all"] if each else None for each in (event.given, event.before, event.after)]
    return event, seconds, errors


def _round(found: Round) -> dict[str, Any]:
    """A round with its answers, its drawing and the remarks on its first candidates."""
    first = {row.key for row in (*found.ranking[:_REMARKED], *([found.chosen] if found.chosen else []), *found.rivals)}
    return {
        "answers": answer_rows(found),
        "other_answers": other_answers(found),
        "count": len(found.ranking),
        "drawn": len(found.ranking[:SHOWN]),
        "svg": ranking(found),
        "remarks": [
            f"{effect_name(*row.key)}: {', '.join(row.remarks)}"
            for row in found.ranking[:SHOWN]
            if row.key in first and row.remarks
        ],
    }
