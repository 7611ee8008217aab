"""The page of a made subject: what was done, step by step, with links to the pages of the steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from urllib.parse import quote

from biodyn_ros import __version__
from biodyn_ros.base.files import remove
from biodyn_ros.reading.parts import BagPart
from biodyn_ros.reports.pages import check_reports, render, write_drawn
from biodyn_ros.reports.verdict import Verdict
from biodyn_ros.subject.making import PAGE, RESULT, VALIDATED, MadeSubject
from biodyn_ros.subject.steps import Step
from biodyn_ros.subject.uses import UsedEvents
from biodyn_ros.subject.wording import FILES, PAGES, TITLES, divergence_of, result_line, sentence_of


def write_page(made: MadeSubject, report: bool) -> None:
    """Write the page beside the results; without a report, an earlier one is removed. InputError as `write_drawn`."""
    path = made.directory / PAGE
    if report:
        write_drawn(path, lambda: subject_page(made))
    else:
        remove(path)


def subject_page(made: MadeSubject) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    return render(
        "subject.html.j2",
        made=made,
        steps=[_step(step, made) for step in made.steps.values()],
        verdict=verdict_of(made),
        result=RESULT if (made.directory / RESULT).exists() else None,
        validated=_validated(made),
        used=_used(made, made.used) if made.used else [],
        version=__version__,
    )


def verdict_of(made: MadeSubject) -> Verdict:
    """The result, the steps that were not possible, and whether the fitted model diverges."""
    against = {step.name: _against(step) for step in made.steps.values()}
    lines = [f"{TITLES[name]}: {reason}." for name, reason in against.items() if reason]
    tone = "bad" if against["fit"] else "warn" if lines else "none"
    line = result_line(made)
    return Verdict(tone, line[0].upper() + line[1:], tuple(lines))


def _against(step: Step) -> str:
    """Why a step was not possible, or what is wrong with its result; empty if neither."""
    return divergence_of(step.facts) if step.state == "done" else step.reason.rstrip(".")


def _step(step: Step, made: MadeSubject) -> dict[str, Any]:
    def existing(path: str | None) -> str | None:
        # A step that failed leaves the files of an earlier run, which are of other data.
        there = path and step.state == "done" and (made.directory / path).exists()
        return quote(path) if path and there else None

    return {
        "title": TITLES[step.name],
        "step": step,
        "sentence": sentence_of(step, made.used),
        "page": existing(PAGES.get(step.name)),
        "file": existing(FILES.get(step.name)),
    }


def _validated(made: MadeSubject) -> list[dict[str, Any]]:
    """The validated events with their pages."""
    step = made.steps["validate"]
    found = []
    for event in step.facts.get("events", ()):
        page = Path(VALIDATED) / event["name"] / "validate.html"
        link = quote(str(page)) if (made.directory / page).exists() else None
        found.append({**event, "page": link})
    return found


def _used(made: MadeSubject, used: UsedEvents) -> list[tuple[BagPart, str]]:
    """The events by time with their uses, and the use in the trace where it is another one."""
    changed = used.changed(made.steps["trace"].facts.get("uses"))
    parts = sorted((*used.fit, *used.held_out), key=lambda part: (str(part.path), part.begin_s))
    return [(part, _use(used.uses[str(part)], changed.get(str(part)))) for part in parts]


def _use(dealt: str, in_trace: str | None) -> str:
    return f"{dealt} (in the trace: {in_trace})" if in_trace else dealt
