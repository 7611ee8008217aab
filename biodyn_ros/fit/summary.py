"""Summary of a fit, from its report or from its fit.json, and the verdict of the fit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_core.identification.compare import body_effects
from biodyn_core.identification.uncertainty import Estimate, Identifiability
from biodyn_ros.base.json_files import read_json
from biodyn_ros.base.wording import number, parameter_name
from biodyn_ros.fit.report import Report
from biodyn_ros.reading.provenance import without_note
from biodyn_ros.reports.verdict import Verdict
from biodyn_ros.validate.settings import ValidationSettings

_MAX_PERCENT: Final = ValidationSettings().nrmse_percent


@dataclass(frozen=True)
class FitSummary:
    """The results of a fit that decide its verdict.

    fitted, held_out: the mean error of the resulting subject in each event, percent. mass_matrix: the declared one.
    effects: on body and seat, beside which theta was fitted, each with its site. reached: how many of the refined
    starts of the joint fit reached the lowest objective.
    """

    fitted: tuple[float, ...]
    held_out: tuple[float, ...]
    estimates: tuple[Estimate, ...]
    mass_matrix: str
    better_mass_matrix: str | None
    reached: int
    starts: int
    is_made_by_model: bool
    effects: tuple[tuple[str, str], ...] = ()

    @property
    def percents(self) -> tuple[float, ...]:
        """The errors of all events; infinite where the model diverges."""
        return (*self.fitted, *self.held_out)

    @property
    def unstable(self) -> int:
        """How many events the model diverges in."""
        return sum(map(math.isinf, self.percents))

    @property
    def fitted_percent(self) -> float | None:
        """The mean error over the events fitted to."""
        return _mean(self.fitted)

    @property
    def held_out_percent(self) -> float | None:
        """The mean error over the events only predicted, None without one."""
        return _mean(self.held_out)


def summary_of(report: Report) -> FitSummary:
    """The summary of a report."""
    fitted, held_out = (
        tuple(event.errors[report.result].mean_percent for event in events)
        for events in (report.fitted, report.held_out)
    )
    return FitSummary(
        fitted=fitted,
        held_out=held_out,
        estimates=report.uncertainty.estimates,
        mass_matrix=report.given.mass_matrix,
        better_mass_matrix=report.better_mass_matrix,
        reached=report.joint.reached,
        starts=report.joint.refined.costs.size,
        is_made_by_model=bool(without_note(report.warnings)[0]),
        effects=tuple(sorted((one.effect.name, one.site) for one in body_effects(report.given))),
    )


def read_summary(path: Path) -> FitSummary:
    """The summary of a fit.json; raises InputError for a file that cannot be read or is none."""
    try:
        document: Any = read_json(path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    try:
        return _of_document(document)
    except (KeyError, TypeError, AttributeError):
        raise InputError(f"{path}: is not a fit.json of biodyn; fit the subject again") from None


def _of_document(document: Any) -> FitSummary:
    result, starts, matrix = document["result"], document["joint"]["starts"], document["mass_matrix"]
    fitted, held_out = (
        tuple(_percent(event[result]["mean"]) for event in document[events]) for events in ("cases", "held_out")
    )
    return FitSummary(
        fitted=fitted,
        held_out=held_out,
        estimates=tuple(
            _estimate(name, of, document["identifiable"][name]) for name, of in document["intervals"].items()
        ),
        mass_matrix=matrix["declared"],
        better_mass_matrix=matrix["better"],
        reached=starts["reached"],
        starts=starts["of"],
        is_made_by_model=bool(without_note(document["warnings"])[0]),
        effects=tuple(sorted((one["name"], one["site"]) for one in document.get("effects", []))),
    )


def _estimate(name: str, of: Any, identifiability: Identifiability) -> Estimate:
    half_width = math.inf if of["half_width_percent"] is None else of["half_width_percent"] / 100.0
    return Estimate(
        name, of["unit"], of["value"], of["lower"], of["upper"], half_width, identifiability, of["at_bound"]
    )


def _percent(stored: float | None) -> float:
    """A stored error; JSON has no infinity, which an unstable prediction has."""
    return math.inf if stored is None else stored


def percent_text(percent: float | None) -> str:
    """A mean error, percent; that of an unstable simulation is infinite."""
    return "diverges" if percent == math.inf else number(percent)


def _mean(percents: Sequence[float]) -> float | None:
    return sum(percents) / len(percents) if percents else None


def fit_verdict(found: FitSummary) -> Verdict:
    """The prediction error on events not fitted to, and reasons against the fit."""
    against = tuple(_reasons_against(found))
    if unstable := found.unstable:
        headline = f"The model diverges in {unstable} of {counted(len(found.percents), 'event')}"
        return Verdict("bad", headline, ("Its error there is not known, so there is no mean error.", *against))
    fitted = number(found.fitted_percent)
    if found.held_out_percent is None:
        headline = f"Fitted to {fitted} % of the rms; the error on an unused event is not known"
        return Verdict("none", headline, ("Nothing was held out: --hold-out, or validate on another event.", *against))
    percent = number(found.held_out_percent)
    headline = f"Predicts events it was not fitted to with a mean error of {percent} % of their rms"
    first = f"Mean over {counted(len(found.held_out), 'such event')}; {fitted} % on those fitted to."
    if found.held_out_percent > _MAX_PERCENT:
        line = f"More than {_MAX_PERCENT:g} %, the limit of a validation."
        return Verdict("bad", headline, (first, line, *against))
    return Verdict("warn" if against else "none" if found.is_made_by_model else "good", headline, (first, *against))


def _reasons_against(found: FitSummary) -> Iterator[str]:
    inside = [estimate for estimate in found.estimates if not estimate.at_bound]
    for degree in ("not identifiable", "weakly identifiable", "from the prior"):
        if names := [estimate.name for estimate in inside if estimate.identifiability == degree]:
            source = "" if degree == "from the prior" else " from these recordings"
            yield f"{degree.capitalize()}{source}: {_listed(names, found)}."
    if on_bound := [estimate.name for estimate in found.estimates if estimate.at_bound]:
        yield f"On a bound of Table 1, so perhaps beyond it: {_listed(on_bound, found)}."
    if found.better_mass_matrix not in (None, found.mass_matrix):
        yield f"Mass matrix {found.better_mass_matrix} predicts better than the declared {found.mass_matrix}."
    if found.starts > 1 and found.reached < 2:
        yield f"Only {found.reached} of {counted(found.starts, 'refined start')} reached the lowest objective."


def _listed(names: Sequence[str], found: FitSummary) -> str:
    if len(names) == len(found.estimates):
        return f"all {counted(len(names), 'parameter')}"
    return "; ".join(parameter_name(name) for name in names)
