"""The page and the text of a campaign over people: one row for each, with a link to the page of the person."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from biodyn_core.base.wording import counted, number
from biodyn_ros import __version__
from biodyn_ros.base.wording import table
from biodyn_ros.reports.verdict import Verdict
from biodyn_ros.subject.making import PAGE
from biodyn_ros.subject.people import PersonRow
from biodyn_ros.subject.wording import divergence_of

_HEADS: Final = ("person", "state", "events", "fitted, %", "held out, %", "missing effect")


def text_of(rows: Sequence[PersonRow]) -> str:
    """The table of people for the terminal."""
    lines = table([_HEADS, *(_cells(row) for row in rows)], left=(0, 1, 5))
    return "\n".join([lines[0], *(f"{line}{_error(row)}" for line, row in zip(lines[1:], rows, strict=True))])


def people_page(rows: Sequence[PersonRow], directory: Path) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    from biodyn_ros.reports.pages import check_reports, render  # an extra of its own

    check_reports()
    return render(
        "people.html.j2",
        heads=_HEADS,
        rows=[(row, _cells(row), _link(row, directory)) for row in rows],
        verdict=verdict_of(rows),
        version=__version__,
    )


def verdict_of(rows: Sequence[PersonRow]) -> Verdict:
    """How many people are done, why others are not, and whose fitted model diverges."""
    failed = [f"{row.name}: {row.error}." for row in rows if row.state != "done"]
    diverging = [f"{row.name}: {line}." for row in rows if (line := divergence_of(_steps(row).get("fit", {})))]
    headline = f"{len(rows) - len(failed)} of {counted(len(rows), 'person', 'people')} done"
    return Verdict("bad" if diverging else "warn" if failed else "none", headline, (*failed, *diverging))


def _cells(row: PersonRow) -> tuple[str, ...]:
    fit, trace = (_steps(row).get(name, {}) for name in ("fit", "trace"))
    return (
        row.name,
        row.state,
        str(len(row.document.get("uses", {})) or "–"),
        number(fit.get("fitted_percent")),
        number(fit.get("held_out_percent")),
        _short(trace),
    )


def _steps(row: PersonRow) -> dict[str, dict[str, Any]]:
    return {step["name"]: step for step in row.document.get("steps", ())}


def _short(trace: dict[str, Any]) -> str:
    return str(trace.get("verdict") or trace.get("state") or "–").replace("_", " ")


def _error(row: PersonRow) -> str:
    return f"\n  {row.error}" if row.error else ""


def _link(row: PersonRow, directory: Path) -> str | None:
    return quote(f"{row.name}/{PAGE}") if (directory / row.name / PAGE).exists() else None
