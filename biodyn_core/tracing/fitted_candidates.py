"""Rungs: what a candidate gains once it is settled on all events, and why that may be nothing but usual."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.local_fit import LEVELS, LocalFit, relief, settle
from biodyn_core.tracing.nuisance_model import Background
from biodyn_core.tracing.screen import Screened, Screening, by_event
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.unsteady import unsteady

LEAST_EVENTS: Final = 3
LEAST_CASES: Final = 2
"""An effect is believed where it helps in so many events, or in events of so many loading conditions."""

ANEW: Final = 0.25
"""What is set anew in the very events that choose always gains; 0.17 at most in 94 bodies with nothing hidden."""

LIFT_OFF: Final = "lift_off"


@dataclass(frozen=True, eq=False)
class FittedCandidate:
    """A candidate, settled, and its log ratio in each event that chooses (e,), whose loading conditions are cases.

    spreads: how many of the usual departure's it is. against: why it is not this, where that is known.
    """

    settled: LocalFit
    gains: Floats
    cases: tuple[str, ...]
    screened: Screened
    steady: bool = True
    spreads: float = np.inf
    against: str = ""

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
        """The effect as it was settled."""
        assert self.settled.applied is not None
        return self.settled.applied

    @property
    def gain(self) -> float:
        """Mean log ratio over the events that choose."""
        return float(self.gains.mean())


def residual_ratio(background: Background, settled: LocalFit) -> float:
    """What is left in the events that choose, in multiples of what a good model misses, rms, of the median event."""
    p, left = background.choose.products, settled.left
    each = [(left[p.event == e].sum(), p.samples[p.event == e].sum()) for e in np.unique(p.event)]
    return float(np.sqrt(np.median([square / max(samples, 1.0) for square, samples in each])))


class WithoutEffect:
    """The events without an effect, settled once at each level that is asked for."""

    def __init__(self, background: Background) -> None:
        self.background = background
        self._settled: dict[float, LocalFit] = {}

    def at(self, level: float) -> LocalFit:
        """The fit at a prior scale."""
        if level not in self._settled:
            self._settled[level] = settle(self.background.at_level(level), None)
        return self._settled[level]


def fitted_candidate(without_effect: WithoutEffect, start: AppliedEffect, screened: Screened) -> FittedCandidate | None:
    """An effect settled and weighed at the level that is likeliest without it and at that with it, by the lesser gain.

    None where it runs away.
    """
    background = without_effect.background
    settled = settle(background, start)
    if settled.applied is None or not np.isfinite(settled.objective):
        return None
    weighed = [_gains(without_effect, settled, background.level)]
    if settled.level != background.level:
        again = settle(background.at_level(settled.level), settled.applied)
        if np.isfinite(again.objective):
            weighed.append(_gains(without_effect, again, settled.level))
            settled = again
    rung = FittedCandidate(settled, min(weighed, key=np.mean), _cases(background), screened)
    return dataclasses.replace(rung, spreads=background.spreads(rung.applied))


def _gains(without_effect: WithoutEffect, settled: LocalFit, level: float) -> Floats:
    """What an effect gains in each event that chooses, (e,), both settled at one level."""
    background, without = without_effect.background, without_effect.at(level)
    p = background.choose.products
    in_events = by_event(without.left, settled.left[:, None], p.event, p.samples)[:, 0]
    return np.asarray(in_events + relief(background, without, settled))


def _cases(background: Background) -> tuple[str, ...]:
    return tuple(case.case for case in background.choose.cases)


def unsteady_candidates(background: Background, without: LocalFit, screening: Screening) -> list[FittedCandidate]:
    """Rungs of what is set anew time and again; those that were not screened, for want of a channel, are left out."""
    p, found = background.choose.products, []
    screened = {(one.tried.applied.effect.name, one.tried.applied.site): one for one in reversed(screening.ladder)}
    for one in unsteady(background, without):
        known = screened.get((one.applied.effect.name, one.applied.site))
        if known is not None:
            settled = dataclasses.replace(without, applied=one.applied, left=one.left)
            gains = by_event(without.left, one.left[:, None], p.event, p.samples)[:, 0]
            found.append(FittedCandidate(settled, gains, _cases(background), known, steady=False, against=one.against))
    return found
