"""One greedy round: every effect at every site settled on few events, the best of them on all, one taken or none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.effects import AppliedEffect
from biodyn_core.errors import InputError
from biodyn_core.identification.fit import at_bound
from biodyn_core.identification.identify import fingerprint
from biodyn_core.identification.problem import Case
from biodyn_core.subject import Subject
from biodyn_core.tracing.background import FREE, Background
from biodyn_core.tracing.findings import Candidate, Round
from biodyn_core.tracing.glance import SIZES, STEPS, Glance, glance, larger, plain, taken_up
from biodyn_core.tracing.screen import Screened, Screening, Tried, by_event, candidates
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.settle import LEVELS, Settled, relief, settle
from biodyn_core.tracing.unsteady import unsteady

Floats = NDArray[np.float64]
Tell = Callable[[str, float], None]
Kept = MutableMapping[str, Any]
"""What is kept of the long parts of a trace, by a key that tells one problem from another."""

FROM_ALL: Final = 4
"""So many of those in the running are started from all their shapes and strengths."""

LEAST_EVENTS: Final = 3
LEAST_CASES: Final = 2
"""An effect is believed where it helps in so many events, or in events of so many loading conditions."""

TELLING: Final = 0.9
"""With less left than so many times what a good model misses, it is told how far a body departs."""

ANEW: Final = 0.25
"""What is set anew in the very events that choose always gains; 0.17 at most in 94 bodies with nothing hidden."""

NEXT_TO: Final = 0.1
"""A parameter of theta so near its bound without an effect, in shares of its range, is not moved there by it."""

LIFT_OFF: Final = "lift_off"

STEADY_SHARE: Final = ("clock",)
"""Of what is set anew time and again, these have a share that stays, which a subject carries."""

FIRST: Final = ("clock", "gain", "tilt", "skin")
"""What is wrong with a sensor is believed before a new law of tissue, where both explain as much."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A round with what it rests on: the background, settled without and, where an effect was taken, with it."""

    round: Round
    background: Background
    without: Settled
    taken: Settled | None

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
        """What was left when the round began, as by `left_over`."""
        return left_over(self.background, self.without)

    @property
    def after(self) -> float:
        """What is left now, likewise."""
        return left_over(self.background, self.taken or self.without)


def left_over(background: Background, settled: Settled) -> float:
    """What is left in the events that choose, in multiples of what a good model misses, rms, of the median event."""
    p, left = background.choose.products, settled.left
    each = [(left[p.event == e].sum(), p.samples[p.event == e].sum()) for e in np.unique(p.event)]
    return float(np.sqrt(np.median([square / max(samples, 1.0) for square, samples in each])))


@dataclass(frozen=True, eq=False)
class _Rung:
    """A candidate, settled, and its log ratio in each event that chooses (e,), whose loading conditions are cases.

    spreads: how many of the usual departure's it is.
    """

    settled: Settled
    gains: Floats
    cases: tuple[str, ...]
    absorbed: float
    screened: Screened
    steady: bool = True
    spreads: float = np.inf

    def usual(self, settings: TraceSettings) -> str:
        """Why a body may be so though nothing is missing, where it may."""
        if not self.steady and self.gain <= ANEW:
            return f"is set anew, which gains up to {ANEW:g} where nothing is hidden"
        farthest = settings.farthest if self.settled.level > LEVELS[-1] else 1.0
        if self.spreads < farthest:
            return f"is {self.spreads:.1f} times what is usual there, up to {farthest:g} is no cause"
        return ""

    @property
    def helps(self) -> bool:
        """Whether it helps in more than an event or two of one kind; a seat is left in few, and told by one."""
        if self.applied.effect.name == LIFT_OFF:
            return bool((self.gains > 0.0).any())
        helped = [case for case, gain in zip(self.cases, self.gains, strict=True) if gain > 0.0]
        return len(helped) >= LEAST_EVENTS or len(set(helped)) >= LEAST_CASES

    @property
    def applied(self) -> AppliedEffect:
        assert self.settled.applied is not None
        return self.settled.applied

    @property
    def gain(self) -> float:
        return float(self.gains.mean())


def one_round(
    subject: Subject, train: Sequence[Case], choose: Sequence[Case], settings: TraceSettings, seed: int, tell: Tell,
    kept: Kept | None = None,
) -> Outcome:  # fmt: skip
    """Look for one effect that the subject lacks; where there is none, none is taken."""
    few = _likeliest(Background.of(subject, first_of_each(train), first_of_each(choose), settings.background))
    glanced = _glanced(few, candidates([*train, *choose], subject.effects)[0], settings, seed, tell, kept)
    background = _likeliest(Background.of(subject, train, choose, settings.background))
    plain = _Plain(background)
    without = plain.at(background.level)
    if not np.isfinite(without.objective):
        names = ", ".join(case.name for case in choose)
        raise InputError(
            f"{subject.name}: the fitted chain runs away in one of {names}; look for outliers, leave it out"
        )
    rungs = []
    running = glanced.running(settings.refined)
    for number, one in enumerate(running):
        start = _best_start(few, glanced.screening, one.applied) if number < FROM_ALL else one.applied
        rung = _rung(background, plain, start, one.screened)
        if rung is not None:
            rungs.append(rung)
        tell("settling", (number + 1) / len(running))
    rungs = sorted([*rungs, *_unsteady(background, without, glanced.screening)], key=lambda rung: -rung.gain)
    threshold = max(_asked(background, plain, settings), float(np.quantile(glanced.screening.chance, 0.95)))
    told = [_candidate(rung, background, without, glanced.screening, settings) for rung in rungs]
    index = _taken(told, rungs, threshold, settings)
    ladder = (*told, *_screened_only(glanced.screening, told))
    if index is None:
        return Outcome(Round(ladder, threshold, None, ()), background, without, None)
    rivals = _rivals(index, told, rungs, glanced.screening, settings)
    chosen = rungs[index].settled
    if not rungs[index].steady and rungs[index].applied.effect.name not in STEADY_SHARE:
        return Outcome(Round(ladder, threshold, told[index], rivals), background, without, chosen)
    # Settled once more: a clock that was set time and again has no place in a subject, one that is late has.
    settled = settle(background.at_level(chosen.level), chosen.applied, with_intervals=True)
    settled = dataclasses.replace(settled, left=chosen.left)
    return Outcome(Round(ladder, threshold, told[index], rivals), background, without, settled)


def _likeliest(background: Background) -> Background:
    """For a body that departs from the model as far as is likeliest where nothing is missing.

    Where more is left than of a good model, something is, and departures that are small beside it tell nothing.
    """
    found = settle(background, None)
    plain = left_over(background, found) < TELLING and np.isfinite(found.objective)
    return background.at_level(found.level) if plain else background


def _asked(background: Background, plain: _Plain, settings: TraceSettings) -> float:
    """What a gain must exceed: more of a body that departs as far as usual than of one that is as the model has it.

    Where more is left than of a good model, something is missing, and the least will do. A body that is as the model
    has it gains next to nothing by any law, unless one was added: then the gap between that law and its own is left.
    """
    if left_over(background, plain.at(LEVELS[0])) >= TELLING:
        return settings.least_gain
    if background.level == LEVELS[-1] and not background.subject.effects:
        return settings.plain_gain
    decades = 1.0 + float(np.log10(background.level))
    return settings.least_gain * (1.0 + settings.departing * decades)


def _glanced(
    few: Background, tried: Sequence[Tried], settings: TraceSettings, seed: int, tell: Tell, kept: Kept | None
) -> Glance:  # fmt: skip
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


class _Plain:
    """The events without an effect, settled once at each level that is asked for."""

    def __init__(self, background: Background) -> None:
        self._background = background
        self._settled: dict[float, Settled] = {}

    def at(self, level: float) -> Settled:
        """Settled at a level."""
        if level not in self._settled:
            self._settled[level] = settle(self._background.at_level(level), None)
        return self._settled[level]


def _rung(background: Background, plain: _Plain, start: AppliedEffect, screened: Screened) -> _Rung | None:
    """An effect settled and weighed at the level that is likeliest without it and at that with it, by the lesser gain.

    None where it runs away.
    """
    settled = settle(background, start)
    if settled.applied is None or not np.isfinite(settled.objective):
        return None
    weighed = [_gains(background, plain.at(background.level), settled)]
    if settled.level != background.level:
        again = settle(background.at_level(settled.level), settled.applied)
        if np.isfinite(again.objective):
            weighed.append(_gains(background, plain.at(settled.level), again))
            settled = again
    rung = _Rung(settled, min(weighed, key=np.mean), _cases(background), screened.absorbed, screened)
    return dataclasses.replace(rung, spreads=background.spreads(rung.applied))


def _gains(background: Background, without: Settled, settled: Settled) -> Floats:
    """What an effect gains in each event that chooses, (e,), both settled at one level."""
    p = background.choose.products
    in_events = by_event(without.left, settled.left[:, None], p.event, p.samples)[:, 0]
    return np.asarray(in_events + relief(background, without, settled))


def _cases(background: Background) -> tuple[str, ...]:
    return tuple(case.case for case in background.choose.cases)


def _unsteady(background: Background, without: Settled, screening: Screening) -> list[_Rung]:
    """Rungs of what is set anew time and again; those that were not screened, for want of a channel, are left out."""
    p, found = background.choose.products, []
    screened = {(one.tried.applied.effect.name, one.tried.applied.site): one for one in reversed(screening.ladder)}
    for applied, left in unsteady(background, without):
        known = screened.get((applied.effect.name, applied.site))
        if known is not None:
            settled = dataclasses.replace(without, applied=applied, left=left)
            gains = by_event(without.left, left[:, None], p.event, p.samples)[:, 0]
            found.append(_Rung(settled, gains, _cases(background), known.absorbed, known, steady=False))
    return found


def _candidate(
    rung: _Rung, background: Background, without: Settled, screening: Screening, settings: TraceSettings
) -> Candidate:
    against = [f"{name} ends on a bound" for name in rung.settled.at_bound]
    if not rung.helps:
        against.append(f"helps in {np.count_nonzero(rung.gains > 0.0)} of {rung.gains.size} events")
    usual = rung.usual(settings)
    if usual:
        against.append(usual)
    before = {
        name
        for subject in (background.subject, without.subject)
        for name in at_bound(subject.parameters.vector(), FREE, NEXT_TO)
    }
    after = at_bound(rung.settled.subject.parameters.vector(), FREE)
    against += [f"{name} moves onto its bound" for name in after if name not in before]
    return Candidate(
        rung.applied, rung.gain, True, screening.p_value(rung.gain), rung.absorbed,
        int(np.count_nonzero(rung.gains > 0.0)), tuple(against), rung.steady, bool(usual),
    )  # fmt: skip


def _taken(told: Sequence[Candidate], rungs: Sequence[_Rung], threshold: float, settings: TraceSettings) -> int | None:
    """Which rung is taken: the best with nothing against it, but a sensor's fault before a tissue's law as good.

    One that ends on a bound is taken only where it gains overwhelmingly and nothing that does not comes near: the form
    of its law is then not quite the body's.
    """
    for i, one in enumerate(told):  # a seat that holds nobody down is a known omission, before any law of a joint
        if one.applied.effect.name == LIFT_OFF and one.gain > settings.least_lift_off and rungs[i].helps:
            return i
    good = [i for i, one in enumerate(told) if one.gain > threshold and not one.against]
    rough = [
        i
        for i, one in enumerate(told)
        if one.gain > settings.overwhelming * threshold and rungs[i].helps and not rungs[i].usual(settings)
    ]
    if rough and (not good or told[good[0]].gain < settings.near_alike * told[rough[0]].gain):
        return rough[0]
    if not good:
        return None
    best = good[0]
    close = [i for i in good if told[i].gain >= settings.near * told[best].gain and not _worse(rungs[i], rungs[best])]
    first = [i for i in close if told[i].applied.effect.name in FIRST]
    return first[0] if first else best


def _worse(one: _Rung, than: _Rung) -> bool:
    """Whether it predicts the events worse by more than their scatter."""
    apart = than.gains - one.gains
    error = apart.std(ddof=1) / np.sqrt(apart.size) if apart.size > 1 else 0.0
    return bool(apart.mean() > 2.0 * error)


def _rivals(
    index: int, told: Sequence[Candidate], rungs: Sequence[_Rung], screening: Screening, settings: TraceSettings
) -> tuple[Candidate, ...]:
    """Others that explain about as much as what was taken, the best of each name and site; none beside lift-off.

    That is a known omission: what explains more, or as much, is for the next round.
    """
    taken, found = told[index], []
    if taken.applied.effect.name == LIFT_OFF:
        return ()
    seen = {(taken.applied.effect.name, taken.applied.site)}
    for i, one in enumerate(told):
        key = (one.applied.effect.name, one.applied.site)
        if key in seen or one.gain <= 0.0:
            continue
        close = one.gain >= settings.near * taken.gain and not _worse(rungs[i], rungs[index])
        alike = screening.cosine(rungs[i].screened.tried, rungs[index].screened.tried) > settings.alike
        if close or (alike and one.gain >= settings.near_alike * taken.gain):
            seen.add(key)
            found.append(one)
    return tuple(found)


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
