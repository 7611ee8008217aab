"""One greedy round: every effect at every site settled on few events, the best of them on all, one taken or none."""

from __future__ import annotations

import dataclasses
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.identify import fingerprint
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.choice import TELLING, asked, candidate, rivals, taken
from biodyn_core.tracing.findings import Candidate, Round
from biodyn_core.tracing.fitted_candidates import (
    FittedCandidate,
    WithoutEffect,
    fitted_candidate,
    residual_ratio,
    unsteady_candidates,
)
from biodyn_core.tracing.local_fit import LocalFit, settle
from biodyn_core.tracing.nuisance_model import Background
from biodyn_core.tracing.preliminary_fit import SIZES, STEPS, PreliminaryFits, Tell, glance, larger, plain, taken_up
from biodyn_core.tracing.screen import Screening, Tried, candidates
from biodyn_core.tracing.settings import TraceSettings

Kept = MutableMapping[str, Any]
"""What is kept of the long parts of a trace, by a key that tells one problem from another."""

FROM_ALL: Final = 4
"""So many of those in the running are started from all their shapes and strengths."""

STEADY_SHARE: Final = ("clock",)
"""Of what is set anew time and again, these have a share that stays, which a subject carries."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A round with what it rests on: the background, settled without and, where an effect was taken, with it."""

    round: Round
    background: Background
    without: LocalFit
    taken: LocalFit | None

    @property
    def carried(self) -> bool:
        """Whether the subject that was taken carries the effect: what is never twice the same, none can."""
        return self.taken is not None and len(self.taken.subject.effects) > len(self.background.subject.effects)

    def uncarried(self, why: str) -> Outcome:
        """The round where no subject carries what it took; only what is never the same twice stays taken."""
        chosen, settled = self.round.taken, self.taken
        assert chosen is not None and settled is not None
        if not chosen.steady:
            return dataclasses.replace(self, taken=dataclasses.replace(settled, subject=self.background.subject))
        refused = dataclasses.replace(chosen, against=(*chosen.against, why))
        ladder = tuple(refused if one is chosen else one for one in self.round.ladder)
        return dataclasses.replace(self, round=Round(ladder, self.round.threshold, None, ()), taken=None)

    @property
    def before(self) -> float:
        """What was left when the round began, as by `residual_ratio`."""
        return residual_ratio(self.background, self.without)

    @property
    def after(self) -> float:
        """What is left now, likewise."""
        return residual_ratio(self.background, self.taken or self.without)


def one_round(
    subject: Subject, train: Sequence[Case], choose: Sequence[Case], settings: TraceSettings, seed: int, tell: Tell,
    kept: Kept | None = None,
) -> Outcome:  # fmt: skip
    """Look for one effect that the subject lacks; where there is none, none is taken."""
    few = _likeliest(Background.of(subject, first_of_each(train), first_of_each(choose), settings.background))
    glanced = _glanced(few, candidates([*train, *choose], subject.effects)[0], settings, seed, tell, kept)
    background = _likeliest(Background.of(subject, train, choose, settings.background))
    without_effect = WithoutEffect(background)
    without = without_effect.at(background.level)
    if not np.isfinite(without.objective):
        names = ", ".join(case.name for case in choose)
        raise InputError(
            f"{subject.name}: the fitted chain runs away in one of {names}; look for outliers, leave it out"
        )
    rungs = _climbed(few, glanced, without_effect, settings, tell)
    rungs = sorted([*rungs, *unsteady_candidates(background, without, glanced.screening)], key=lambda rung: -rung.gain)
    threshold = max(asked(without_effect, settings), float(np.quantile(glanced.screening.chance, 0.95)))
    told = [candidate(rung, background, without, glanced.screening, settings) for rung in rungs]
    ladder = (*told, *_screened_only(glanced.screening, told))
    index = taken(told, rungs, threshold, settings)
    if index is None:
        return Outcome(Round(ladder, threshold, None, ()), background, without, None)
    alike = rivals(index, told, rungs, glanced.screening, settings)
    settled = _settled_anew(background, rungs[index])
    return Outcome(Round(ladder, threshold, told[index], alike), background, without, settled)


def _climbed(
    few: Background, glanced: PreliminaryFits, without_effect: WithoutEffect, settings: TraceSettings, tell: Tell
) -> list[FittedCandidate]:
    """Those in the running, settled on all events; what runs away is left out."""
    found = []
    running = glanced.running(settings.refined)
    for number, one in enumerate(running):
        start = _best_start(few, glanced.screening, one.applied) if number < FROM_ALL else one.applied
        rung = fitted_candidate(without_effect, start, one.screened)
        if rung is not None:
            found.append(rung)
        tell("settling", (number + 1) / len(running))
    return found


def _settled_anew(background: Background, rung: FittedCandidate) -> LocalFit:
    """What was taken with its intervals, and of a cause that was set time and again the share that stays."""
    chosen = rung.settled
    if not rung.steady and rung.applied.effect.name not in STEADY_SHARE:
        return chosen
    settled = settle(background.at_level(chosen.level), chosen.applied, with_intervals=True)
    return dataclasses.replace(settled, left=chosen.left)


def _likeliest(background: Background) -> Background:
    """For a body that departs from the model as far as is likeliest where nothing is missing.

    Where more is left than of a good model, something is, and departures that are small beside it tell nothing.
    """
    found = settle(background, None)
    plain = residual_ratio(background, found) < TELLING and np.isfinite(found.objective)
    return background.at_level(found.level) if plain else background


def _glanced(
    few: Background, tried: Sequence[Tried], settings: TraceSettings, seed: int, tell: Tell, kept: Kept | None
) -> PreliminaryFits:  # fmt: skip
    """The glance that was kept of these very events, theta, channels and settings, or a new one, kept."""
    cases = [*few.train.cases, *few.choose.cases]
    key = f"glance {fingerprint(cases, few.subject, seed, settings)}"
    if kept is not None and key in kept:
        return taken_up(kept[key], tried)
    found = glance(few, tried, settings.replicates, seed, tell)
    if kept is not None:
        kept[key] = plain(found)
    return found


def first_of_each(cases: Sequence[Case]) -> list[Case]:
    """The first event of each loading condition."""
    first: dict[str, Case] = {}
    for case in cases:
        first.setdefault(case.case, case)
    return list(first.values())


def _best_start(few: Background, screening: Screening, start: AppliedEffect) -> AppliedEffect:
    """From where the effect ends lowest on few events: as it was glanced at, or from other shapes and strengths."""
    others = [
        larger(one.applied, one.strength, size)
        for one in screening.tried
        for size in SIZES
        if one.applied.effect is start.effect and one.applied.site == start.site
    ]
    settled = [settle(few, one, STEPS) for one in (start, *others)]
    best = min(settled, key=lambda one: one.objective)
    return start if best.applied is None or not np.isfinite(best.objective) else best.applied


def _screened_only(screening: Screening, told: Sequence[Candidate]) -> list[Candidate]:
    """The rest of the catalogue, one for each effect and site, with the gain of screening's linear step."""
    seen = {(one.applied.effect.name, one.applied.site) for one in told}
    found = []
    for one in screening.ladder:
        key = (one.tried.applied.effect.name, one.tried.applied.site)
        if key not in seen:
            seen.add(key)
            found.append(Candidate(one.tried.applied, one.gain, False, one.p_value, one.absorbed, 0))
    return found
