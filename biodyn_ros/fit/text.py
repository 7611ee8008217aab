"""A fit as text for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.base.wording import counted
from biodyn_core.body.usual_residual import LEAST_WINDOWS
from biodyn_core.identification.residuals import ResidualCheck
from biodyn_core.pipeline.intervals import undriven
from biodyn_core.population.distribution import SPREAD
from biodyn_ros.base.wording import number, parameter_name, with_interval, words
from biodyn_ros.fit.report import FitEvent, FitName, Report
from biodyn_ros.fit.summary import percent_text

_SAME_OBJECTIVE: Final = 1.02
"""Objectives of two refiners that differ by no more than this factor are the same."""

BY: Final[dict[FitName, str]] = {
    "alone": "by itself",
    "joint": "joint",
    "idealized": "idealized",
    "without_prior": "joint without prior",
}
"""The fits with their titles."""


def text_of(report: Report) -> str:
    """The report as text for the terminal."""
    lines = [
        _headline(report),
        "",
        "error, % of measured rms " + "".join(f"{words(name):>12}" for name in MEASURED_SEGMENTS) + f"{'mean':>9}",
        *(row for event in report.events for row in _error_rows(event)),
        "",
        *_parameter_rows(report),
        *_profile_rows(report),
        "",
        *remarks(report),
        *(f"warning: {line}" for line in report.warnings),
    ]
    return "\n".join(lines)


def _headline(report: Report) -> str:
    subject = report.given
    return (
        f"{subject.name}, {subject.body_mass_kg:g} kg, mass matrix {subject.mass_matrix}:"
        f" {counted(len(report.fitted), 'case')}, {report.seconds:.1f} s,"
        f" {counted(report.identification.evaluations, 'evaluation')}"
    )


def _error_rows(event: FitEvent) -> Iterator[str]:
    yield event.case.case + ("" if event.use == "fitted" else f" ({event.use})")
    for name, error in event.errors.items():
        cells = "".join(f"{number(percent):>12}" for percent in error.nrmse_rms_percent)
        yield f"  {BY[name]:<23}{cells}{percent_text(error.mean_percent):>9}"


def _parameter_rows(report: Report) -> Iterator[str]:
    yield f"{'parameter of the joint fit':<34}{'value':>8}  {'95 % interval':<24}{'CV of cases':>12}  "
    idealized = report.identification.idealized
    for estimate in report.uncertainty.estimates:
        name, cv = estimate.name, idealized.cv_percent[estimate.name]
        scatter = f"{cv:.1f} %{'!' if name in idealized.flagged else ' '}" if math.isfinite(cv) else "–"
        value, lower, upper = with_interval(estimate.value, estimate.lower, estimate.upper)
        unit = "" if estimate.unit == "-" else estimate.unit
        interval = f"{unit and f'{unit}, '}on its bound" if estimate.at_bound else f"{lower} to {upper} {unit}"
        degree = estimate.identifiability
        yield f"{parameter_name(name):<34}{value:>8}  {interval:<24}{scatter:>12}  {degree}".rstrip()


def _profile_rows(report: Report) -> Iterator[str]:
    """Intervals of the requested profiles; a side is open where no value of Table 1 passes the 95 % threshold."""
    for profile in report.profiles:
        lower, upper = profile.lower, profile.upper
        ends = ["open" if end is None else number(end) for end in (lower, upper)]
        if lower is not None and upper is not None:
            _, *ends = with_interval(lower, lower, upper)
        yield f"{'profile: ' + parameter_name(profile.name):<34}{'':>8}  {' to '.join(ends)}"
    for name in report.not_profiled:
        yield f"{'profile: ' + parameter_name(name):<34}{'':>8}  none, it lies on its bound"


def remarks(report: Report) -> Iterator[str]:
    """Further results of a fit, one line each."""
    found, joint = report.identification, report.joint
    if found.settings.mass_scale == "fixed":
        yield "mass scale: fixed; accelerations do not determine it"
    searches = (f"{name} {search.reached} of {search.costs.size}" for name, search in report.searches)
    yield f"swarms that reached the lowest minimum: {', '.join(searches)}"
    yield f"refined starts that reached the lowest objective: {joint.reached} of {joint.refined.costs.size}"
    yield from prior_lines(report)
    if joint.at_bound:
        yield f"on a bound of Table 1: {', '.join(map(parameter_name, joint.at_bound))}"
    if found.idealized.flagged:
        yield f"CV above 30 % (!): {', '.join(map(parameter_name, found.idealized.flagged))}"
    yield from _divergence_lines(report)
    yield _matrix_line(report)
    yield _refiner_line(report)
    if report.penalties:
        yield "penalties: " + ", ".join(f"{count} {cause}" for cause, count in report.penalties.items())
    yield from _residual_lines(report.residual_checks)
    if report.dealt:
        yield f"events: {report.dealt}"
    yield _interval_line(report)
    if not report.held_out:
        yield "nothing was held out: the prediction error on an unused event is not known (--hold-out, validate)"


def prior_lines(report: Report) -> Iterator[str]:
    """How far the result is from the published groups, and the parameters that are theirs rather than measured."""
    if report.joint.prior is None:
        return
    yield (
        f"prior: published groups of people; the result is {number(report.distance)} standard deviations from their"
        f" mean, where {number(math.sqrt(SPREAD.stop))} are usual"
    )
    if names := [one.name for one in report.uncertainty.estimates if one.identifiability == "from the prior"]:
        yield f"from the prior, because these recordings say little of them: {'; '.join(map(parameter_name, names))}"


def _interval_line(report: Report) -> str:
    """Whether predictions of the result will have intervals, or why not."""
    known = {words(name): law.windows for name, law in report.usual_residual.items()}
    if report.result != "joint":
        return "predictions will have no 95 % interval: only the joint result has a covariance"
    if needed := undriven(report.identification.subject):
        return f"predictions will have no 95 % interval: {needed}"
    if not known:
        return (
            f"predictions will have no 95 % interval: {LEAST_WINDOWS} s or more of a segment are needed in events"
            " that are not fitted to"
        )
    held_out = ", ".join(f"{name} {windows} s" for name, windows in known.items())
    return f"predictions will have 95 % intervals; the usual residual is from {held_out} that were not fitted to"


def _divergence_lines(report: Report) -> Iterator[str]:
    """The events in which the simulation of a result diverges."""
    for event in report.events:
        if names := [BY[name] for name, error in event.errors.items() if error.is_unstable]:
            yield (
                f"the model diverges in {event.case.case} ({event.use}, {event.bag.bag}) with the parameters of:"
                f" {', '.join(names)}; its error there is not known"
            )


def _matrix_line(report: Report) -> str:
    declared, better, percents = report.given.mass_matrix, report.better_mass_matrix, report.mass_matrix_percent
    errors = ", ".join(
        f"{name} {f'{number(percent)} %' if math.isfinite(percent) else 'diverges'}"
        for name, percent in percents.items()
    )
    where = "events held out" if report.held_out else "the fitted events"
    if report.joint.prior is not None:
        where += " without the prior"
    if not any(map(math.isfinite, percents.values())):
        return f"mass matrix: not compared, because the model diverges with both on {where}"
    if better is None:
        return f"mass matrix: no difference on {where} ({errors})"
    note = "" if better == declared else f"; the subject's file declares {declared}"
    return f"mass matrix: {better} predicts {where} better ({errors}){note}"


def _refiner_line(report: Report) -> str:
    squares, simplex = report.refiners["least-squares"], report.refiners["nelder-mead"]
    low, high = sorted((squares.objective, simplex.objective))
    ends = f"end at {number(squares.objective)} and {number(simplex.objective)}"
    if high <= _SAME_OBJECTIVE * low:
        ends = "end at the same objective"
    counts = f"{squares.evaluations} and {counted(simplex.evaluations, 'simulation')}"
    case = report.identification.compared_on.case
    return f"refiners on {case}: least squares and Nelder-Mead {ends} after {counts}"


def _residual_lines(checks: Sequence[ResidualCheck]) -> Iterator[str]:
    """The segments whose residual is coherent with the seat."""
    for check in checks:
        columns = zip(MEASURED_SEGMENTS, check.coherent, check.chance, strict=True)
        coherent = [f"{words(name)} {value:.2f}" for name, value, chance in columns if value > chance]
        if coherent:
            yield f"residual of {check.case} is coherent with the seat: {', '.join(coherent)}"
