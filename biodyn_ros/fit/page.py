"""The page of a fit: one HTML file with the estimates, their uncertainty and the prediction errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.base.wording import counted
from biodyn_core.identification.fit import predictions
from biodyn_core.identification.problem import Case, errors
from biodyn_core.tracing.findings import ComparedEvent
from biodyn_ros.base.wording import number, parameter_name
from biodyn_ros.fit.drawings import MARKERS, correlation, intervals, profiles
from biodyn_ros.fit.fitting import Fitted, page_beside
from biodyn_ros.fit.text import BY, remarks
from biodyn_ros.reading.provenance import without_note
from biodyn_ros.reports.pages import check_reports, render, write_drawn
from biodyn_ros.reports.residuals import of_one_rate, over_frequency, over_time
from biodyn_ros.reports.verdict import Verdict
from biodyn_ros.validate.settings import ValidationSettings

Document = dict[str, Any]

_MAX_PERCENT: Final = ValidationSettings().nrmse_percent


def write_fit_page(fitted: Fitted, output: Path) -> None:
    """Write the page beside a subject file that is there already; raises InputError as `write_drawn`."""
    write_drawn(page_beside(output), lambda: fit_page(fitted))


def fit_page(fitted: Fitted) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    document, events = fitted.document, fit_events(fitted)
    compared = [event for event in events if event.use == ("held_out" if fitted.held_out else "train")]
    worst = max(compared, key=lambda event: event.after.mean_percent)
    note, warnings = made_by_model(document["warnings"])
    return render(
        "fit.html.j2",
        document=document,
        verdict=judge_fit(document),
        remarks=list(remarks(document)),
        limitations=limitations(document),
        note=note,
        warnings=warnings,
        segments=MEASURED_SEGMENTS,
        by=BY,
        rows=_rows(document),
        scale=_largest(document),
        classes=tuple(MARKERS),
        names={name: parameter_name(name) for name in (*document["cv"], *document["least_known"]["combination"])},
        intervals_svg=intervals(document),
        correlation_svg=correlation(document),
        profiles_svg=profiles(document),
        worst=worst,
        compared=len(compared),
        drawn=len(of_one_rate(compared)),
        time_svg=over_time(worst),
        spectra_svg=over_frequency(compared),
    )


def fit_events(fitted: Fitted) -> list[ComparedEvent]:
    """Every event with predictions of the given and of the fitted subject, those held out last."""
    cases = [(case, "train") for case in fitted.identification.cases] + [(case, "held_out") for case in fitted.held_out]
    both = [
        list(predictions(subject, [case for case, _ in cases]))
        for subject in (fitted.given, fitted.identification.subject)
    ]
    return [_event(case, use, *parts) for (case, use), *parts in zip(cases, *both, strict=True)]


def _event(case: Case, use: Any, before: Any, after: Any) -> ComparedEvent:
    measured, *models = (np.where(case.compared, values, np.nan) for values in (case.measured_mps2, before, after))
    found = [errors(case, accel) for accel in (before, after)]
    return ComparedEvent(case.name, case.case, use, case.rate_hz, measured, *models, *found)


def judge_fit(document: Document) -> Verdict:
    """The prediction error on events not fitted to, and reasons against the fit."""
    held_out = document["held_out"]
    fitted, predicted = mean_error(document, "cases"), mean_error(document, "held_out")
    against = list(_reasons_against(document))
    if predicted is None:
        headline = f"Fitted to {number(fitted)} % of the rms; the error on an unused event is not known"
        return Verdict("none", headline, ("Nothing was held out: --hold-out, or validate on another event.", *against))
    headline = f"Predicts events it was not fitted to with a mean error of {number(predicted)} % of their rms"
    first = f"Mean over {counted(len(held_out), 'such event')}; {number(fitted)} % on those fitted to."
    if predicted > _MAX_PERCENT:
        line = f"More than {_MAX_PERCENT:g} %, the limit of a validation."
        return Verdict("bad", headline, (first, line, *against))
    made, _ = made_by_model(document["warnings"])
    return Verdict("warn" if against else "none" if made else "good", headline, (first, *against))


def _reasons_against(document: Document) -> list[str]:
    """Reasons against the fit."""
    lines = []
    pinned = document["joint"]["at_bound"]
    for degree in ("not identifiable", "weakly identifiable"):
        found = [name for name, of in document["identifiable"].items() if of == degree and name not in pinned]
        if found:
            lines.append(f"{degree.capitalize()} from these recordings: {_listed(found, document)}.")
    if pinned:
        lines.append(f"On a bound of Table 1, so perhaps beyond it: {_listed(pinned, document)}.")
    matrix = document["mass_matrix"]
    if matrix["better"] not in (None, matrix["declared"]):
        lines.append(f"Mass matrix {matrix['better']} predicts better than the declared {matrix['declared']}.")
    starts = document["joint"]["starts"]
    if starts["of"] > 1 and starts["reached"] < 2:
        lines.append(
            f"Only {starts['reached']} of {counted(starts['of'], 'refined start')} reached the lowest objective."
        )
    return lines


def _listed(names: list[str], document: Document) -> str:
    if len(names) == len(document["identifiable"]):
        return f"all {counted(len(names), 'parameter')}"
    return "; ".join(parameter_name(name) for name in names)


def limitations(document: Document) -> list[str]:
    """Limits of the results on the page."""
    lines = [
        "Intervals include noise and colour of the residual, but not the error of the model itself.",
        "A small error over time alone is no validation: validate also compares transmissibility and doses.",
    ]
    if document["settings"]["mass_scale"] == "fixed":
        lines.append("The mass scale was fixed and is not a result of the fit.")
    if document["result"] == "idealized":
        lines.append("The subject is the fusion of the cases; intervals and identifiability are of the joint fit.")
    if len(document["cases"]) == 1:
        lines.append("One case alone: another road or speed may give other parameters.")
    missing = sorted({name for case in document["cases"] for name in case["not_fitted"]}, key=MEASURED_SEGMENTS.index)
    if missing:
        lines.append(f"Not measured, or too short, in some case: {', '.join(missing).replace('_', ' ')}.")
    return lines


def made_by_model(warnings: list[str]) -> tuple[str | None, list[str]]:
    """The note that recordings were made by the model, and all other warnings."""
    notes, rest = without_note(warnings)
    return (notes[0] if notes else None), rest


def _rows(document: Document) -> list[tuple[Document, str, list[str]]]:
    """Every event, its use, and the fits for which its errors are known."""
    fitted = [(case, "fitted", ["error", "joint", "idealized"]) for case in document["cases"]]
    return fitted + [(event, event["why"], ["joint", "idealized"]) for event in document["held_out"]]


def _largest(document: Document) -> float:
    """The upper end of the error bars' scale, percent."""
    means = [event[key]["mean"] for event, _, keys in _rows(document) for key in keys]
    return max((mean for mean in means if mean is not None), default=1.0) or 1.0


def mean_error(document: Document, events: str) -> float | None:
    """Mean error of the fitted subject over the `cases` or the `held_out` events of a fit.json, percent."""
    means = [event[document["result"]]["mean"] for event in document[events]]
    known = [mean for mean in means if mean is not None]
    return sum(known) / len(known) if known else None
