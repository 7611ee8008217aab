"""Preliminary fits: every effect at every site, screened and fitted to the first event of each loading condition.

This is the longest stage of a trace. It only selects the candidates of the final fits, so its result can be stored.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.parameters import Parameters
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.candidate import Candidate, PreliminaryFit, ScreeningResult
from biodyn_core.tracing.joint_refit import general_starts
from biodyn_core.tracing.local_fit import LocalFit, evidence_gain, fit_locally, start_objective
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.screen import Screening, mean_log_ratio, screen
from biodyn_core.tracing.settings import PreliminarySettings, TraceSettings

OnStage = Callable[[str, float], None]
"""Called with the stage of a trace and the share of it that is done."""


@dataclass(frozen=True, eq=False)
class PreliminaryFits:
    """Screening, and the candidates that are fitted to few events."""

    screening: Screening
    candidates: tuple[Candidate, ...]

    def shortlist(self, count: int) -> list[Candidate]:
        """The candidates with the largest gains, half as many with the largest decrease, and all known omissions."""
        by_gain = sorted(self.candidates, key=lambda one: -max(fit.gain for fit in one.all_tried))[:count]
        by_decrease = sorted(self.candidates, key=lambda one: -max(fit.decrease for fit in one.all_tried))
        always = [one for one in self.candidates if one.start.effect.known_omission]
        return list({id(one): one for one in (*by_gain, *by_decrease[: count // 2], *always)}.values())


def preliminary_fits(
    few: NuisanceModel, candidates: Sequence[Candidate], seed: int, on_stage: OnStage,
    settings: TraceSettings | None = None, parallel: ParallelMap = serial_map,
) -> PreliminaryFits:  # fmt: skip
    """Screen all candidates on few events, and fit each effect at each site from its best shape."""
    s = settings or TraceSettings()
    screening = screen(few, candidates, s.replicates, seed, lambda share: on_stage("screening", share), parallel)
    chosen = _selected(screening, s.preliminary)
    without = fit_locally(few, None, s.few_steps)
    items = [
        (_sized(textbook, s.preliminary), _sized(best, s.preliminary) if i < s.preliminary.generalised else None, s)
        for i, (textbook, best) in enumerate(chosen)
    ]
    all_fits, found = parallel("preliminary fits", _fits, few, items), []
    for number, ((one, _), fits) in enumerate(zip(chosen, all_fits, strict=True)):
        textbook, general = (None if fit is None else _preliminary_fit(few, without, fit) for fit in fits)
        if textbook is not None:
            found.append(dataclasses.replace(one, preliminary=textbook, preliminary_general=general))
        on_stage("preliminary fits", (number + 1) / len(chosen))
    return PreliminaryFits(screening, tuple(found))


def _fits(
    few: NuisanceModel, item: tuple[AppliedEffect, AppliedEffect | None, TraceSettings]
) -> tuple[LocalFit | None, LocalFit | None]:
    """The fits of the textbook form and of the general form, None if it is not wanted or unstable.

    item: a start of each form, None for none, and the settings. The general form also starts from the end of the
    textbook form.
    """
    start, bent, s = item
    quick = dataclasses.replace(s.few_steps, least_decrease=s.preliminary.least_decrease)
    textbook = fit_locally(few, start, quick)
    if textbook.applied is None or not np.isfinite(textbook.objective):
        return None, None
    if bent is None or not start.effect.general_form:
        return textbook, None
    theta = textbook.subject.parameters
    starts = [one.effects[-1] for one in general_starts(textbook.subject, few.train.cases, s.joint_refit)]
    best = min((bent, *starts), key=lambda one: start_objective(few, one, theta, quick))
    steps = dataclasses.replace(quick, steps=s.preliminary.general_steps)
    general = fit_locally(few, best, steps, textbook=False, theta=theta)
    return textbook, general if np.isfinite(general.objective) else None


def _preliminary_fit(few: NuisanceModel, without: LocalFit, local: LocalFit) -> PreliminaryFit:
    assert local.applied is not None
    ratio = mean_log_ratio(without.residual_square, local.residual_square[:, None], few.choose.products)
    gain = float(ratio[0]) + evidence_gain(few, without, local)
    return PreliminaryFit(gain, 1.0 - local.objective / without.objective, local.applied, local.subject.parameters)


def _selected(screening: Screening, s: PreliminarySettings) -> list[tuple[Candidate, Candidate]]:
    """The best shapes of each effect at each site, of the textbook form and of all; the largest decrease first.

    All known omissions are selected, the others if one of their shapes decreases the objective enough.
    """
    textbook: dict[tuple[str, str], Candidate] = {}
    best: dict[tuple[str, str], Candidate] = {}
    for one in sorted(screening.ranking, key=lambda one: -one.screened.decrease):
        best.setdefault(one.key, one)
        if one.start.is_textbook:
            textbook.setdefault(one.key, one)
    most = max((one.screened.decrease for one in best.values()), default=0.0)
    least = max(s.least_fit * most, s.least_fit_of_all)
    return [
        (textbook[key], one)
        for key, one in best.items()
        if one.screened.decrease >= least or one.start.effect.known_omission
    ]


def to_checkpoint(fits: PreliminaryFits) -> dict[str, Any]:
    """Preliminary fits as plain lists; candidates by their index."""

    def row(one: Candidate) -> list[float]:
        of = one.screened
        return [one.index, of.gain, of.decrease, of.size, of.absorbed, of.p_value]

    return {
        "chance": fits.screening.chance.tolist(),
        "ranking": [row(one) for one in fits.screening.ranking],
        "fits": [[one.index, *([fit.gain, fit.decrease, dict(fit.applied.values), fit.theta.vector().tolist()]
                               for fit in one.all_tried)] for one in fits.candidates],
    }  # fmt: skip


def from_checkpoint(stored: Mapping[str, Any], candidates: Sequence[Candidate]) -> PreliminaryFits:
    """Preliminary fits from plain lists and their candidates; raises InputError for a damaged or other checkpoint."""
    try:
        ranking = tuple(_ranked(candidates, *row) for row in stored["ranking"])
        chance = np.array(stored["chance"], dtype=np.float64)
        by_index = {one.index: one for one in ranking}
        fitted = tuple(_fitted(by_index[int(index)], *row) for index, *row in stored["fits"])
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"the checkpoint of a trace is damaged ({error}); remove it to compute again") from None
    if len(ranking) != len(candidates) or chance.ndim != 1 or not chance.size or not np.isfinite(chance).all():
        raise InputError("the checkpoint of a trace is damaged; remove it to compute again")
    return PreliminaryFits(Screening(ranking, chance), fitted)


def _ranked(candidates: Sequence[Candidate], index: float, *values: float) -> Candidate:
    result = ScreeningResult(*(float(value) for value in values))
    return dataclasses.replace(candidates[int(index)], index=int(index), screening=result)


def _fitted(one: Candidate, *rows: Sequence[Any]) -> Candidate:
    """The candidate with its stored preliminary fits: of the textbook form, and of the general form if there is one."""
    textbook, *general = (_stored_fit(one.start, *row) for row in rows)
    return dataclasses.replace(one, preliminary=textbook, preliminary_general=general[0] if general else None)


def _stored_fit(
    start: AppliedEffect, gain: float, decrease: float, values: Mapping[str, float], theta: Sequence[float]
) -> PreliminaryFit:
    applied = dataclasses.replace(start, values={name: float(value) for name, value in values.items()})
    parameters = Parameters.from_vector(np.array(theta, dtype=np.float64))
    return PreliminaryFit(float(gain), float(decrease), applied, parameters)


def _sized(one: Candidate, s: PreliminarySettings) -> AppliedEffect:
    """The candidate with the strength of screening, within the range of starts and its own range."""
    size, least, most = one.screened.size, *s.strengths
    reversed_sign = any(p.name == one.strength and p.lower < 0.0 for p in one.start.effect.parameters) and size < 0.0
    limited = min(max(-size if reversed_sign else size, least), most)
    return scaled(one.start, one.strength, -limited if reversed_sign else limited)


def scaled(applied: AppliedEffect, strength: str, size: float) -> AppliedEffect:
    """The effect with a strength multiplied by size, within its range."""
    values = dict(applied.values)
    for parameter in applied.effect.parameters:
        if parameter.name == strength:
            values[strength] = min(max(values[strength] * size, parameter.lower), parameter.upper)
    return dataclasses.replace(applied, values=values)
