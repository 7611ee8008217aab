"""A fit as text for the terminal, from the mapping of fit.json."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.base.wording import counted
from biodyn_ros.base.wording import number, parameter_name, with_interval, words

Document = dict[str, Any]

_SAME_OBJECTIVE: Final = 1.02
"""Objectives of two refiners that differ by no more than this factor are the same."""


def text_of(document: Document) -> str:
    """The text of a fit.json."""
    cases, held_out = document["cases"], document["held_out"]
    lines = [
        _headline(document),
        "",
        "error, % of measured rms " + "".join(f"{words(name):>12}" for name in MEASURED_SEGMENTS) + f"{'mean':>9}",
        *(row for event in cases for row in _error_rows(event, ("error", "joint", "idealized"))),
        *(row for event in held_out for row in _error_rows(event, ("joint", "idealized"))),
        "",
        *_parameter_rows(document),
        *_profile_rows(document),
        "",
        *remarks(document),
        *(f"warning: {line}" for line in document["warnings"]),
    ]
    return "\n".join(lines)


def _headline(document: Document) -> str:
    return (
        f"{document['subject']}, {document['body_mass_kg']:g} kg, mass matrix {document['mass_matrix']['declared']}:"
        f" {counted(len(document['cases']), 'case')}, {document['seconds']:.1f} s,"
        f" {counted(document['evaluations'], 'evaluation')}"
    )


BY: Final = {"error": "by itself", "joint": "joint", "idealized": "idealized"}


def _error_rows(event: Document, by: tuple[str, ...]) -> Iterator[str]:
    why = f" ({event['why']})" if "why" in event else ""
    yield f"{event['case']}{why}"
    for key in by:
        shown = [event[key]["nrmse_rms"][name] for name in MEASURED_SEGMENTS]
        cells = "".join(f"{number(value):>12}" for value in shown)
        yield f"  {BY[key]:<23}{cells}{number(event[key]['mean']):>9}"


def _parameter_rows(document: Document) -> Iterator[str]:
    yield f"{'parameter of the joint fit':<34}{'value':>8}  {'95 % interval':<24}{'CV of cases':>12}  "
    for name, of in document["intervals"].items():
        cv = document["cv"][name]
        scatter = f"{cv:.1f} %{'!' if name in document['flagged'] else ' '}" if cv is not None else "–"
        value, lower, upper = with_interval(of["value"], of["lower"], of["upper"])
        unit = "" if of["unit"] == "-" else of["unit"]
        interval = f"{unit and f'{unit}, '}on its bound" if of["at_bound"] else f"{lower} to {upper} {unit}"
        degree = document["identifiable"][name]
        yield f"{parameter_name(name):<34}{value:>8}  {interval:<24}{scatter:>12}  {degree}".rstrip()


def _profile_rows(document: Document) -> Iterator[str]:
    """Intervals of the requested profiles; a side is open where no value of Table 1 passes the 95 % threshold."""
    for name, profile in document["profiles"].items():
        lower, upper = profile["lower"], profile["upper"]
        ends = ["open" if end is None else number(end) for end in (lower, upper)]
        if lower is not None and upper is not None:
            _, *ends = with_interval(lower, lower, upper)
        yield f"{'profile: ' + parameter_name(name):<34}{'':>8}  {' to '.join(ends)}"
    for name in document["not_profiled"]:
        yield f"{'profile: ' + parameter_name(name):<34}{'':>8}  none, it lies on its bound"


def remarks(document: Document) -> Iterator[str]:
    """Further results of a fit, one line each."""
    joint, matrix = document["joint"], document["mass_matrix"]
    if document["settings"]["mass_scale"] == "fixed":
        yield "mass scale: fixed; accelerations do not determine it"
    swarms = (f"{one['case']} {one['reached']} of {one['of']}" for one in document["phase1"])
    yield f"swarms that reached the lowest minimum: {', '.join(swarms)}"
    yield f"refined starts that reached the lowest objective: {joint['starts']['reached']} of {joint['starts']['of']}"
    if joint["at_bound"]:
        yield f"on a bound of Table 1: {', '.join(parameter_name(name) for name in joint['at_bound'])}"
    if document["flagged"]:
        yield f"CV above 30 % (!): {', '.join(parameter_name(name) for name in document['flagged'])}"
    yield _matrix_line(matrix)
    yield _refiner_line(document["refiners"])
    if document["penalties"]:
        yield "penalties: " + ", ".join(f"{count} {cause}" for cause, count in document["penalties"].items())
    yield from _residual_lines(document["residuals"])
    if not document["held_out"]:
        yield "nothing was held out: the prediction error on an unused event is not known (--hold-out, validate)"


def _matrix_line(matrix: Document) -> str:
    errors = ", ".join(f"{name} {number(percent)} %" for name, percent in matrix["error_percent"].items())
    where = "events held out" if matrix["judged_by"] == "held_out" else "the fitted events"
    if matrix["better"] is None:
        return f"mass matrix: no difference on {where} ({errors})"
    note = "" if matrix["better"] == matrix["declared"] else f"; the subject's file declares {matrix['declared']}"
    return f"mass matrix: {matrix['better']} predicts {where} better ({errors}){note}"


def _refiner_line(refiners: Document) -> str:
    objective, evaluations = refiners["objective"], refiners["evaluations"]
    ours, simplex = objective["least-squares"], objective["nelder-mead"]
    counts = f"{evaluations['least-squares']} and {counted(evaluations['nelder-mead'], 'simulation')}"
    if max(ours, simplex) <= _SAME_OBJECTIVE * min(ours, simplex):
        what = "end at the same objective"
    else:
        what = f"end at {number(ours)} and {number(simplex)}"
    return f"refiners on {refiners['case']}: least squares and Nelder-Mead {what} after {counts}"


def _residual_lines(residuals: list[Document]) -> Iterator[str]:
    """The segments whose residual is coherent with the seat."""
    for residual in residuals:
        following = [
            f"{words(name)} {value:.2f}"
            for name, value in residual["input_coherence"].items()
            if value is not None and value > residual["chance_coherence"][name]
        ]
        if following:
            yield f"residual of {residual['case']} is coherent with the seat: {', '.join(following)}"
