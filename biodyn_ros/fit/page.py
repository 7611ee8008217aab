"""The page of a fit: one HTML file with the estimates, their uncertainty and the prediction errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import is_fitted
from biodyn_core.identification.fit import predictions
from biodyn_core.identification.problem import errors
from biodyn_core.tracing.findings import ComparedEvent, Use
from biodyn_ros import __version__
from biodyn_ros.base.wording import parameter_name, words
from biodyn_ros.fit.drawings import MARKERS, correlation, intervals, profiles
from biodyn_ros.fit.fitting import page_beside
from biodyn_ros.fit.report import FitEvent, Report
from biodyn_ros.fit.summary import fit_verdict, percent_text, summary_of
from biodyn_ros.fit.text import BY, remarks
from biodyn_ros.reading.provenance import without_note
from biodyn_ros.reports.pages import check_reports, render, write_drawn
from biodyn_ros.reports.residuals import of_spectra, over_frequency, over_time, stable_events


def write_fit_page(report: Report, output: Path) -> None:
    """Write the page beside a subject file that is there already; raises InputError as `write_drawn`."""
    write_drawn(page_beside(output), lambda: fit_page(report))


def fit_page(report: Report) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    compared = compared_events(report, report.held_out or report.fitted)
    worst = max(compared, key=lambda event: event.after.mean_percent)
    notes, warnings = without_note(report.warnings)
    known = [error.mean_percent for event in report.events for error in event.errors.values() if not error.is_unstable]
    singles = [fit.subject.parameters for fit in report.identification.fits]
    return render(
        "fit.html.j2",
        report=report,
        found=report.identification,
        fits=list(zip(report.fitted, report.identification.fits, strict=True)),
        version=__version__,
        before="given subject" if is_fitted(report.given.parameters) else "middle of Table 1",
        verdict=fit_verdict(summary_of(report)),
        remarks=list(remarks(report)),
        limitations=limitations(report),
        note=notes[0] if notes else None,
        warnings=warnings,
        segments=MEASURED_SEGMENTS,
        by=BY,
        scale=max(known, default=1.0) or 1.0,
        percent_text=percent_text,
        classes=tuple(MARKERS),
        parameter_name=parameter_name,
        intervals_svg=intervals(report.uncertainty.estimates, singles if len(singles) > 1 else []),
        correlation_svg=correlation(report.uncertainty),
        profiles_svg=profiles(report.profiles),
        worst=worst,
        compared=len(compared),
        stable=len(stable_events(compared)),
        drawn=len(of_spectra(compared)),
        time_svg=over_time(worst),
        spectra_svg=over_frequency(compared),
    )


def compared_events(report: Report, events: Sequence[FitEvent]) -> list[ComparedEvent]:
    """Events with predictions of the given and of the fitted subject, NaN of one that diverges in the event."""
    cases, subjects = [event.case for event in events], (report.given, report.identification.subject)
    compared = []
    for event, *models in zip(events, *(predictions(subject, cases) for subject in subjects), strict=True):
        case = event.case
        use: Use = "train" if event.use == "fitted" else "held_out"
        found = [errors(case, accel) for accel in models]
        # Some values of a simulation that diverges are finite, but too large to be drawn.
        drawn = [np.nan if error.is_unstable else accel for error, accel in zip(found, models, strict=True)]
        measured, before, after = (np.where(case.compared, accel, np.nan) for accel in (case.measured_mps2, *drawn))
        compared.append(
            ComparedEvent(case.name, case.case, use, case.rate_hz, measured, before, after, found[0], found[1])
        )
    return compared


def limitations(report: Report) -> list[str]:
    """Limits of the results on the page."""
    lines = [
        "Intervals include noise and colour of the residual, but not the error of the model itself.",
        "A small error over time alone is no validation: validate also compares transmissibility and doses.",
    ]
    if report.identification.settings.mass_scale == "fixed":
        lines.append("The mass scale was fixed and is not a result of the fit.")
    if report.joint.prior:
        lines.append("The prior is that of published groups; its spread between people is largely assumed.")
    if report.result == "idealized":
        lines.append("The subject is the fusion of the cases; intervals and identifiability are of the joint fit.")
    if len(report.fitted) == 1:
        lines.append("One case alone: another road or speed may give other parameters.")
    missing = [name for name in MEASURED_SEGMENTS if any(name not in event.case.fitted for event in report.fitted)]
    if missing:
        lines.append(f"Not measured, or too short, in some case: {', '.join(map(words, missing))}.")
    return lines
