"""A trace for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import wrap
from typing import Final

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.tracing.findings import RankedCandidate, Round, Trace
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.wording import number, parameter_name, table, words
from biodyn_ros.trace.document import PROOF
from biodyn_ros.trace.errors import USES, WHEN, errors_by_use, is_known, known
from biodyn_ros.trace.refit import ParameterChange, parameter_changes
from biodyn_ros.trace.report import Report
from biodyn_ros.trace.wording import (
    answer_rows,
    effect_name,
    grouped,
    headline,
    other_answers,
    parameters_of,
    probability,
    record_next,
    reliability,
    sensor_lines,
    short_name,
    subject_line,
)

_COLUMNS: Final = 120
_CANDIDATES: Final = 3
_CHANGED: Final = 3
_LISTED: Final = 4
"""Largest number of each in the text; trace.json and the page have all."""


def text_of(report: Report) -> str:
    """The report for the terminal."""
    trace = report.trace
    lines = [
        headline(trace),
        reliability(trace),
        *(f"because: {reason}" for reason in trace.reasons),
        "",
        *(_answer_lines(trace.rounds[0], trace.named_from or 0.0) if trace.rounds else ()),
        "error, % of measured rms " + "".join(f"{words(name):>12}" for name in MEASURED_SEGMENTS) + f"{'all':>9}",
        *_error_rows(trace),
        *_floor_line(trace),
        "",
        *_effect_lines(trace),
        *_candidate_lines(trace.rounds[0].ranking if trace.rounds else ()),
        *(f"sensor: {line}" for line in sensor_lines(trace)),
        *([f"refit: {report.refit.text}"] if report.refit else []),
        *_change_lines(trace),
        subject_line(trace),
        *_titled("also possible", grouped(trace.ambiguous_with)),
        *_titled("record next", record_next(trace)),
        *_titled("left out", trace.left_out),
        *_titled("not testable without a channel", [words(each) for each in trace.untestable]),
        *([f"bags: {report.dealt}"] if report.dealt else []),
        *(f"warning: {line}" for line in report.warnings),
        PROOF,
    ]
    return "\n".join(part for line in lines for part in _wrapped(line))


def _wrapped(line: str) -> list[str]:
    """The line in lines of a terminal; tables are narrow enough."""
    if len(line) <= _COLUMNS:
        return [line]
    return wrap(line, _COLUMNS, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False)


def _error_rows(trace: Trace) -> Iterator[str]:
    errors = {when: errors_by_use(trace, when) for when in WHEN}
    for use, title in USES.items():
        for when in WHEN:
            if is_known(trace, use):
                of = errors[when][use]
                cells = "".join(f"{number(of[name]):>12}" for name in MEASURED_SEGMENTS)
                yield f"  {title + ', ' + when:<23}{cells}{number(of['all']):>9}"


def _floor_line(trace: Trace) -> Iterator[str]:
    floor = known(trace.floor_percent)
    if floor is not None:
        yield f"floor, error by sensor noise alone: {number(floor)} %"


def _effect_lines(trace: Trace) -> Iterator[str]:
    for applied, intervals in zip(trace.effects, trace.intervals, strict=True):
        shown = ", ".join(f"{name} {value}" for name, value in parameters_of(applied, intervals))
        done = "added" if applied in trace.added else "found, not added"
        what = effect_name(applied.effect.name, applied.site)
        yield f"{done}: {what} [{applied.effect.family}]" + (f": {shown}" if shown else "")


def _answer_lines(first: Round, least: float) -> Iterator[str]:
    """The probabilities of the answers, the members of the 90 % set marked."""
    rows = [(f"  {name}", probability(p, least), "yes" if likely else "") for name, p, likely in answer_rows(first)]
    yield from table([("answer", "probability", "in the 90 % set"), *rows], left={0, 2})
    omitted = other_answers(first)
    yield from [f"  {omitted}"] if omitted else []
    yield ""


def _candidate_lines(ranking: Sequence[RankedCandidate]) -> Iterator[str]:
    if ranking:
        shown = (
            f"{short_name(one)} (probability {probability(one.probability)}, gain {number(finite(one.gain))})"
            for one in ranking[:_CANDIDATES]
        )
        yield f"most probable of {len(ranking)} candidates: {'; '.join(shown)}"


def _change_lines(trace: Trace) -> Iterator[str]:
    """The parameters that change most by the refit, then by the effect."""
    changes = parameter_changes(trace)
    by_refit = [(each, each.given, each.refitted, each.refit_percent) for each in changes]
    by_effect = [(each, each.refitted, each.after if trace.adds else None, each.percent) for each in changes]
    for title, rows in (("largest changes by the refit", by_refit), ("largest changes by the effect", by_effect)):
        nonzero = [(each, old, new, percent) for each, old, new, percent in rows if percent]
        largest = sorted(nonzero, key=lambda row: -abs(row[3]))[:_CHANGED]
        if largest:
            yield f"{title}: " + ", ".join(_change(*row) for row in largest)


def _change(change: ParameterChange, before: float | None, after: float | None, percent: float) -> str:
    return f"{parameter_name(change.name)} {number(before)} to {number(after)} ({percent:+.1f} %)"


def _titled(title: str, lines: Sequence[str]) -> Iterator[str]:
    if lines:
        more = f"; {len(lines) - _LISTED} more in trace.json" if len(lines) > _LISTED else ""
        yield f"{title}: {'; '.join(lines[:_LISTED])}{more}"
