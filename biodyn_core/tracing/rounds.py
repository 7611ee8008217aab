"""One greedy round: every candidate is fitted to few events, the best ones to all events, and at most one is chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.identify import fingerprint
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import UnstableSimulation
from biodyn_core.tracing.beside import Beside, answered, beside
from biodyn_core.tracing.candidate import Candidate
from biodyn_core.tracing.choice import choose
from biodyn_core.tracing.diagnose import diagnose
from biodyn_core.tracing.evidence import Evidence, evidence_of
from biodyn_core.tracing.findings import Diagnostics, Round
from biodyn_core.tracing.fitted_candidates import (
    WithoutEffect,
    candidate_fit,
    fits_at_scales,
    residual_ratio,
    unsteady_candidates,
)
from biodyn_core.tracing.general_fit import with_general_fits
from biodyn_core.tracing.local_fit import LocalFit, fit_from, fit_locally
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.preliminary_fit import (
    OnStage,
    PreliminaryFits,
    from_checkpoint,
    preliminary_fits,
    scaled,
    to_checkpoint,
)
from biodyn_core.tracing.probability import probabilities
from biodyn_core.tracing.screen import Screening, all_candidates
from biodyn_core.tracing.settings import PreliminarySettings, TraceSettings

Checkpoint = MutableMapping[str, Any]
"""Stored results of the long stages of traces, by a key that identifies the problem."""

PRELIMINARY: Final = "preliminary"
"""The first word of the keys of screenings with their preliminary fits."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A round with its fits: without an effect and, if one is chosen, with it; why: the reason if it is not added."""

    round: Round
    diagnostics: Diagnostics
    nuisance: NuisanceModel
    without: LocalFit
    chosen: LocalFit | None
    why: str = ""

    @property
    def adds_effect(self) -> bool:
        """Whether the subject of the chosen fit has the effect; one that varies with time cannot be stored in it."""
        return self.chosen is not None and len(self.chosen.subject.effects) > len(self.nuisance.subject.effects)

    def refused(self, why: str) -> Outcome:
        """The round with its effect named but not added to the subject, for this reason."""
        assert self.chosen is not None
        return dataclasses.replace(
            self, chosen=dataclasses.replace(self.chosen, subject=self.nuisance.subject), why=why
        )

    @property
    def before(self) -> float:
        """The `residual_ratio` before the round."""
        return residual_ratio(self.nuisance, self.without)

    @property
    def after(self) -> float:
        """The `residual_ratio` after the round."""
        return residual_ratio(self.nuisance, self.chosen or self.without)


@dataclass(frozen=True, eq=False)
class Search:
    """The fits of a round before its decision.

    fitted: candidates fitted to all events, the largest gain first. beside: gains of these beside each other, without
    those that vary with time.
    """

    without_effect: WithoutEffect
    screening: Screening
    preliminary: tuple[Candidate, ...]
    fitted: tuple[Candidate, ...]
    beside: Beside

    @property
    def nuisance(self) -> NuisanceModel:
        """The nuisance model of all events."""
        return self.without_effect.nuisance

    @property
    def without(self) -> LocalFit:
        """The fit without an effect."""
        return self.without_effect.at(self.nuisance.prior_scale)

    def diagnostics(self, settings: TraceSettings) -> Diagnostics:
        """The diagnostics of the residual without an effect."""
        return diagnose(self.nuisance.subject, self.nuisance, settings.diagnostics)

    def evidence(self, settings: TraceSettings, diagnostics: Diagnostics) -> Evidence:
        """The evidence of all candidates."""
        return evidence_of(
            self.without_effect, self.screening, self.preliminary, self.fitted, self.beside, diagnostics,
            settings.evidence.near_bound,
        )  # fmt: skip


def one_round(
    subject: Subject, train: Sequence[Case], held: Sequence[Case], settings: TraceSettings, seed: int,
    on_stage: OnStage, checkpoint: Checkpoint | None = None, parallel: ParallelMap = serial_map, least: float = 0.0,
) -> Outcome:  # fmt: skip
    """Search for one effect that the subject lacks; least: the probability that its mechanism needs."""
    return decided(search(subject, train, held, settings, seed, on_stage, checkpoint, parallel), settings, least)


def search(
    subject: Subject, train: Sequence[Case], held: Sequence[Case], settings: TraceSettings, seed: int,
    on_stage: OnStage, checkpoint: Checkpoint | None = None, parallel: ParallelMap = serial_map,
) -> Search:  # fmt: skip
    """Fit all candidates: each to few events, the best ones to all events."""
    first = (first_of_each(train), first_of_each(held))
    few = _most_probable(NuisanceModel.of(subject, *first, settings.nuisance, parallel), settings)
    nuisance = _most_probable(NuisanceModel.of(subject, train, held, settings.nuisance, parallel), settings)
    without_effect = WithoutEffect(nuisance, settings.local_fit)
    without = without_effect.at(nuisance.prior_scale)
    if not np.isfinite(without.objective):  # known before the long stages
        raise UnstableSimulation(
            f"{subject.name}: the simulation is unstable near the fitted parameters in one of"
            f" {', '.join(case.name for case in (*train, *held))}; look for outliers, leave it out"
        )
    candidates = all_candidates(subject, [*train, *held])
    preliminary = _preliminary(few, candidates, settings, seed, on_stage, checkpoint, parallel)
    screening = preliminary.screening
    fitted = _fitted(few, preliminary, without_effect, settings, on_stage, parallel)
    gains = beside(nuisance, {one.key: answered(nuisance, one.best_fit.local.subject) for one in fitted})
    fitted += unsteady_candidates(nuisance, without, screening, settings.unsteady)
    by_gain = tuple(sorted(fitted, key=lambda one: -one.best_fit.gain))
    return Search(without_effect, screening, preliminary.candidates, by_gain, gains)


def decided(found: Search, settings: TraceSettings, least: float = 0.0) -> Outcome:
    """Choose at most one of the candidates; least: the probability that its mechanism needs."""
    nuisance, without, screening = found.nuisance, found.without, found.screening
    diagnostics = found.diagnostics(settings)
    p = probabilities(found.evidence(settings, diagnostics))
    rest = _not_fitted(screening, found.fitted)
    choice = choose(found.fitted, rest, p, least, nuisance, without, screening, settings.evidence.near_bound)
    fit = None if choice.index is None else _with_intervals(nuisance, choice.fitted[choice.index], settings)
    return Outcome(choice.round, diagnostics, nuisance, without, fit)


def _fitted(
    few: NuisanceModel, preliminary: PreliminaryFits, without_effect: WithoutEffect, settings: TraceSettings,
    on_stage: OnStage, parallel: ParallelMap,
) -> list[Candidate]:  # fmt: skip
    """The candidates of the shortlist, fitted to all events, without those that are unstable."""
    found = []
    shortlist = preliminary.shortlist(settings.refined)
    on_stage("fitting candidates", 0.0)
    starts = _best_starts(few, preliminary.screening, shortlist, settings, parallel)
    items = [(*start, settings.local_fit) for start in starts]
    all_fits = parallel("fitting candidates", fits_at_scales, without_effect.nuisance, items)
    for number, (one, fits) in enumerate(zip(shortlist, all_fits, strict=True)):
        if fits:
            found.append(dataclasses.replace(one, fit=candidate_fit(without_effect, fits)))
        on_stage("fitting candidates", (number + 1) / len(shortlist))
    return with_general_fits(few, without_effect, found, settings, parallel)


def _with_intervals(nuisance: NuisanceModel, one: Candidate, s: TraceSettings) -> LocalFit:
    """The better fit of the chosen candidate, with the intervals of the textbook form.

    Of a cause that varies with time, the fit of its constant part if there is one.
    """
    best, textbook = one.best_fit.local, one.fitted.local
    if not one.fitted.steady and not one.start.effect.constant_part:
        return textbook
    scaled_model, theta = nuisance.at_scale(textbook.prior_scale), textbook.subject.parameters
    fit = fit_locally(scaled_model, textbook.applied, s.local_fit, with_intervals=True, theta=theta)
    if best is not textbook:
        return dataclasses.replace(best, intervals=fit.intervals)
    return dataclasses.replace(fit, residual_square=textbook.residual_square)


def _most_probable(nuisance: NuisanceModel, settings: TraceSettings) -> NuisanceModel:
    """The model at its most probable prior scale, if the residual is that of a good model.

    A larger residual shows that something is missing; the nuisance parameters are then small beside it.
    """
    found = fit_locally(nuisance, None, settings.local_fit)
    good = residual_ratio(nuisance, found) < settings.evidence.good_fit and np.isfinite(found.objective)
    return nuisance.at_scale(found.prior_scale) if good else nuisance


def _preliminary(
    few: NuisanceModel, candidates: Sequence[Candidate], settings: TraceSettings, seed: int, on_stage: OnStage,
    checkpoint: Checkpoint | None, parallel: ParallelMap,
) -> PreliminaryFits:  # fmt: skip
    """The stored preliminary fits of the same events, theta, candidates and settings, or new ones, which are stored.

    The starts of candidates follow from all events, also from those that are not in `few`.
    """
    tried = [(one.key, one.strength, sorted(one.start.values.items())) for one in candidates]
    key = f"{PRELIMINARY} {fingerprint([*few.train.cases, *few.choose.cases], few.subject, seed, (settings, tried))}"
    if checkpoint is not None and key in checkpoint:
        return from_checkpoint(checkpoint[key], candidates)
    found = preliminary_fits(few, candidates, seed, on_stage, settings, parallel)
    if checkpoint is not None:
        checkpoint[key] = to_checkpoint(found)
    return found


def first_of_each(cases: Sequence[Case]) -> list[Case]:
    """The first event of each loading condition."""
    first: dict[str, Case] = {}
    for case in cases:
        first.setdefault(case.case, case)
    return list(first.values())


def _best_starts(
    few: NuisanceModel, screening: Screening, shortlist: Sequence[Candidate], s: TraceSettings, parallel: ParallelMap
) -> list[tuple[AppliedEffect, Parameters]]:
    """The start of each candidate and of theta: its preliminary fit; of the first ones the best fit from all starts.

    These are the preliminary fit, and all shapes and strengths; they are fitted to few events.
    """
    of = s.preliminary
    all_starts = [
        [(one.tried.applied, one.tried.theta), *((start, None) for start in _shapes(screening, one, of))]
        for one in shortlist[: of.many_starts]
    ]
    items = [(*start, s.few_steps) for starts in all_starts for start in starts]
    fits = parallel("fitting candidates", fit_from, few, items)
    found = [(one.tried.applied, one.tried.theta) for one in shortlist]
    for number, starts in enumerate(all_starts):
        best = min([next(fits) for _ in starts], key=lambda fit: fit.objective)
        if best.applied is not None and np.isfinite(best.objective):
            found[number] = best.applied, best.subject.parameters
    return found


def _shapes(screening: Screening, one: Candidate, s: PreliminarySettings) -> list[AppliedEffect]:
    """Every shape of the textbook form of a candidate's effect at its site, with every strength of a start."""
    return [
        scaled(other.start, other.strength, size)
        for other in screening.candidates
        for size in s.strengths
        if other.key == one.key and other.start.is_textbook
    ]


def _not_fitted(screening: Screening, fitted: Sequence[Candidate]) -> list[Candidate]:
    """The best screened candidate of each other effect and site."""
    best = {one.key: one for one in reversed(screening.ranking)}
    known = {one.key for one in fitted}
    return [one for one in screening.ranking if best[one.key] is one and one.key not in known]
