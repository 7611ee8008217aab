"""The page of a campaign: state and errors of each subject, and a comparison of their parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.base.json_files import read_json
from biodyn_ros.base.wording import number
from biodyn_ros.fit.campaign_results import page_of
from biodyn_ros.fit.drawings import MARKERS, estimates_of, subjects
from biodyn_ros.fit.fitting import json_beside
from biodyn_ros.fit.page import judge_fit, mean_error
from biodyn_ros.reports.pages import check_reports, render, write_drawn
from biodyn_ros.reports.verdict import Verdict

Document = dict[str, Any]

MOST_DRAWN: Final = 40
"""The first subjects, up to this number, are drawn; the table has all."""

WORST_FIRST: Final = ("bad", "warn", "none", "good")


def write_campaign_page(document: Document, directory: Path) -> None:
    """Write the page of campaign.json and the files beside it; raises InputError as `write_drawn`."""
    write_drawn(page_of(directory), lambda: campaign_page(document, directory))


def campaign_page(document: Document, directory: Path) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing, or a fit.json is malformed."""
    check_reports()
    rows = document["subjects"]
    fits = {row["name"]: _fit(directory, row) for row in rows if row["state"] == "done"}
    done = [row["name"] for row in rows if row["state"] == "done"]
    drawn = done[:MOST_DRAWN]
    held_out_percent = {name: mean_error(fit, "held_out") for name, fit in fits.items()}
    known = [row["mean_error_percent"] for row in rows] + list(held_out_percent.values())
    return render(
        "campaign.html.j2",
        document=document,
        verdict=judge_campaign(document, held_out_percent, {name: judge_fit(fit).tone for name, fit in fits.items()}),
        numbers={name: place + 1 for place, name in enumerate(done)},
        held_out_percent=held_out_percent,
        links={row["name"]: quote(row["page"], errors="surrogateescape") for row in rows if row["page"]},
        scale=max((value for value in known if value is not None), default=1.0) or 1.0,
        classes=tuple(MARKERS),
        drawn=len(drawn),
        done=len(done),
        subjects_svg=subjects([estimates_of(fits[name]) for name in drawn]) if drawn else None,
    )


def judge_campaign(document: Document, held_out_percent: dict[str, float | None], tones: dict[str, str]) -> Verdict:
    """How many subjects are done, and how well they predict; the tone is that of the worst page."""
    rows = document["subjects"]
    of = {state: [row["name"] for row in rows if row["state"] == state] for state in ("done", "failed", "waiting")}
    headline = f"{len(of['done'])} of {counted(len(rows), 'subject')} fitted"
    reasons = []
    for state, text in (("failed", "Failed, --resume tries them again"), ("waiting", "Not begun, or not finished")):
        if of[state]:
            reasons.append(f"{text}: {', '.join(of[state])}.")
    means = [row["mean_error_percent"] for row in rows if row["mean_error_percent"] is not None]
    if means:
        reasons.append(f"Error on the events fitted to: {_span(means)} % of the rms.")
    known = [value for value in held_out_percent.values() if value is not None]
    if known:
        reasons.append(f"On events not fitted to: {_span(known)} %.")
    unknown = [name for name, value in held_out_percent.items() if value is None]
    if unknown:
        reasons.append(f"Prediction error unknown, since nothing was held out: {', '.join(unknown)}.")
    poor = [name for name, tone in tones.items() if tone == "bad"]
    if poor:
        reasons.append(f"Large errors on events not fitted to: {', '.join(poor)}.")
    own = {"bad"} if of["failed"] else {"warn"} if of["waiting"] else {"good"}
    return Verdict(next(tone for tone in WORST_FIRST if tone in own | set(tones.values())), headline, tuple(reasons))


def _span(values: list[float]) -> str:
    return " to ".join(dict.fromkeys((number(min(values)), number(max(values)))))


def _fit(directory: Path, row: Document) -> Document:
    path = json_beside(directory / row["result"])
    try:
        found = read_json(path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if not (isinstance(found, dict) and {"intervals", "identifiable", "held_out", "result"} <= found.keys()):
        raise InputError(f"{path}: is not a fit.json of biodyn; fit the subject again")
    return found
