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
from biodyn_core.tracing.local_fit import evidence_gain, fit_from, fit_locally
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
        by_gain = sorted(self.candidates, key=lambda one: -one.tried.gain)[:count]
        by_decrease = sorted(self.candidates, key=lambda one: -one.tried.decrease)[: count // 2]
        always = [one for one in self.candidates if one.start.effect.known_omission]
        return list({id(one): one for one in (*by_gain, *by_decrease, *always)}.values())


def preliminary_fits(
    few: NuisanceModel, candidates: Sequence[Candidate], seed: int, on_stage: OnStage,
    settings: TraceSettings | None = None, parallel: ParallelMap = serial_map,
) -> PreliminaryFits:  # fmt: skip
    """Screen all candidates on few events, and fit each effect at each site from its best shape."""
    s = settings or TraceSettings()
    screening = screen(few, candidates, s.replicates, seed, lambda share: on_stage("screening", share), parallel)
    chosen, found = _selected(screening, s.preliminary), []
    without = fit_locally(few, None, s.few_steps)
    few_steps = dataclasses.replace(s.few_steps, least_decrease=s.preliminary.least_decrease)
    fits = parallel(
        "preliminary fits", fit_from, few, [(_sized(one, s.preliminary), None, few_steps) for one in chosen]
    )
    for number, (one, local) in enumerate(zip(chosen, fits, strict=True)):
        if local.applied is not None and np.isfinite(local.objective):
            ratio = mean_log_ratio(without.residual_square, local.residual_square[:, None], few.choose.products)
            gain = float(ratio[0]) + evidence_gain(few, without, local)
            decrease = 1.0 - local.objective / without.objective
            result = PreliminaryFit(gain, decrease, local.applied, local.subject.parameters)
            found.append(dataclasses.replace(one, preliminary=result))
        on_stage("preliminary fits", (number + 1) / len(chosen))
    return PreliminaryFits(screening, tuple(found))


def _selected(screening: Screening, s: PreliminarySettings) -> list[Candidate]:
    """The best shape of each effect at each site, if it decreases the objective enough, and all known omissions."""
    best: dict[tuple[str, str], Candidate] = {}
    for one in sorted(screening.ranking, key=lambda one: -one.screened.decrease):
        best.setdefault(one.key, one)
    most = max((one.screened.decrease for one in best.values()), default=0.0)
    least = max(s.least_fit * most, s.least_fit_of_all)
    return [one for one in best.values() if one.screened.decrease >= least or one.start.effect.known_omission]


def to_checkpoint(fits: PreliminaryFits) -> dict[str, Any]:
    """Preliminary fits as plain lists; candidates by their index."""

    def row(one: Candidate) -> list[float]:
        of = one.screened
        return [one.index, of.gain, of.decrease, of.size, of.absorbed, of.p_value]

    return {
        "chance": fits.screening.chance.tolist(),
        "ranking": [row(one) for one in fits.screening.ranking],
        "fits": [[one.index, one.tried.gain, one.tried.decrease, dict(one.tried.applied.values),
                  one.tried.theta.vector().tolist()] for one in fits.candidates],
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


def _fitted(
    one: Candidate, gain: float, decrease: float, values: Mapping[str, float], theta: Sequence[float]
) -> Candidate:
    applied = dataclasses.replace(one.start, values={name: float(value) for name, value in values.items()})
    parameters = Parameters.from_vector(np.array(theta, dtype=np.float64))
    return dataclasses.replace(one, preliminary=PreliminaryFit(float(gain), float(decrease), applied, parameters))


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
