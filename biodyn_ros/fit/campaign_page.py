"""The page of a campaign: state and errors of each subject, and a comparison of their parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final
from urllib.parse import quote

from biodyn_core.base.wording import counted
from biodyn_ros import __version__
from biodyn_ros.base.wording import number, words
from biodyn_ros.fit.campaign_results import CampaignReport, page_of
from biodyn_ros.fit.drawings import MARKERS, subjects
from biodyn_ros.fit.fitting import json_beside
from biodyn_ros.fit.summary import FitSummary, fit_verdict, percent_text, read_summary
from biodyn_ros.reports.pages import check_reports, render, write_drawn
from biodyn_ros.reports.verdict import Verdict

MOST_DRAWN: Final = 40
"""The first subjects, up to this number, are drawn; the table has all."""

WORST_FIRST: Final = ("bad", "warn", "none", "good")


def write_campaign_page(report: CampaignReport, directory: Path) -> None:
    """Write the page of a campaign from the files of its subjects; raises InputError as `write_drawn`."""
    write_drawn(page_of(directory), lambda: campaign_page(report, directory))


def campaign_page(report: CampaignReport, directory: Path) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing, or a fit.json is malformed."""
    check_reports()
    fits = {
        row.name: read_summary(json_beside(directory / row.result))
        for row in report.rows
        if row.state == "done" and row.result
    }
    held_out_percent = {name: fit.held_out_percent for name, fit in fits.items()}
    drawn = [fit.estimates for fit in fits.values()][:MOST_DRAWN]
    known = _known([*(row.mean_error_percent for row in report.rows), *held_out_percent.values()])
    return render(
        "campaign.html.j2",
        report=report,
        version=__version__,
        verdict=campaign_verdict(report, fits),
        numbers={name: place + 1 for place, name in enumerate(fits)},
        held_out_percent=held_out_percent,
        percent_text=percent_text,
        links={row.name: quote(row.page, errors="surrogateescape") for row in report.rows if row.page},
        scale=max(known, default=1.0) or 1.0,
        classes=tuple(MARKERS),
        drawn=len(drawn),
        done=len(fits),
        subjects_svg=subjects(drawn) if drawn else None,
    )


def campaign_verdict(report: CampaignReport, fits: Mapping[str, FitSummary]) -> Verdict:
    """How many subjects are done, and how well they predict; the tone is that of the worst page."""
    failed, waiting = report.named("failed"), report.named("waiting")
    reasons = []
    if failed:
        reasons.append(f"Failed, --resume tries them again: {', '.join(failed)}.")
    if waiting:
        reasons.append(f"Not begun, or not finished: {', '.join(waiting)}.")
    if means := _known(row.mean_error_percent for row in report.rows):
        reasons.append(f"Error on the events fitted to: {_span(means)} % of the rms.")
    if known := _known(fit.held_out_percent for fit in fits.values()):
        reasons.append(f"On events not fitted to: {_span(known)} %.")
    if unknown := [name for name, fit in fits.items() if fit.held_out_percent is None]:
        reasons.append(f"Prediction error unknown, since nothing was held out: {', '.join(unknown)}.")
    for what, models in _models(fits).items():
        if len(models) > 1:
            listed = "; ".join(f"{model}: {', '.join(names)}" for model, names in models.items())
            reasons.append(f"Parameters of different models, not to be compared, by {what}: {listed}.")
    tones = {name: fit_verdict(fit).tone for name, fit in fits.items()}
    diverging = [name for name, fit in fits.items() if fit.unstable]
    if diverging:
        reasons.append(f"Diverges in an event: {', '.join(diverging)}.")
    if poor := [name for name, tone in tones.items() if tone == "bad" and name not in diverging]:
        reasons.append(f"Large errors on events not fitted to: {', '.join(poor)}.")
    all_tones = {"bad" if failed else "warn" if waiting else "good", *tones.values()}
    headline = f"{len(report.named('done'))} of {counted(len(report.rows), 'subject')} fitted"
    return Verdict(next(tone for tone in WORST_FIRST if tone in all_tones), headline, tuple(reasons))


def _models(fits: Mapping[str, FitSummary]) -> dict[str, dict[str, list[str]]]:
    """The names of the subjects by the mass matrix, and by the effects, that they were fitted with."""
    found: dict[str, dict[str, list[str]]] = {"mass matrix": {}, "effects": {}}
    for name, fit in fits.items():
        effects = " and ".join(f"{effect} ({words(site)})" if site else effect for effect, site in fit.effects)
        found["mass matrix"].setdefault(fit.mass_matrix, []).append(name)
        found["effects"].setdefault(effects or "none", []).append(name)
    return found


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None and math.isfinite(value)]


def _span(values: list[float]) -> str:
    return " to ".join(dict.fromkeys((number(min(values)), number(max(values)))))
