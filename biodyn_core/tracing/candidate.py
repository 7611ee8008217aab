"""Candidate: one effect at one site, with the results of the stages that it has passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.parameters import Parameters
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.local_fit import LocalFit


@dataclass(frozen=True)
class ScreeningResult:
    """The result to first order.

    gain: mean log ratio of the squared residual without over with the effect, in the events for choosing; decrease: of
    the weighted squares in the events for fitting; size: of the strength, in multiples of its start value; absorbed:
    share of the effect's energy that theta explains; p_value: how often the largest random gain is as large.
    """

    gain: float
    decrease: float
    size: float
    absorbed: float
    p_value: float


@dataclass(frozen=True)
class PreliminaryFit:
    """The fit to the first event of each loading condition: gain in the events for choosing, share of the objective.

    applied, theta: the effect with its fitted values, and the theta that was fitted with it.
    """

    gain: float
    decrease: float
    applied: AppliedEffect
    theta: Parameters


@dataclass(frozen=True, eq=False)
class CandidateFit:
    """The fit to all events.

    gains (e,): log ratio in each event for choosing, whose loading conditions are conditions. typical_multiple: size in
    spreads of the typical deviation. fitted_at: the prior scale of the fit. steady: False if the effect is fitted again
    in every window or between events. objection: why it is no cause, if known.
    """

    local: LocalFit
    gains: Floats
    conditions: tuple[str, ...]
    steady: bool = True
    typical_multiple: float = np.inf
    fitted_at: float = 1.0
    objection: str = ""

    @property
    def applied(self) -> AppliedEffect:
        """The effect with its fitted values."""
        assert self.local.applied is not None
        return self.local.applied

    @property
    def gain(self) -> float:
        """Mean log ratio over the events for choosing."""
        return float(self.gains.mean())

    @property
    def improved_events(self) -> int:
        """The number of events with a positive gain."""
        return int(np.count_nonzero(self.gains > 0.0))


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect at one site with start values, and the results of its stages.

    strength: the parameter that scales its size, empty if presence alone is the effect. index: its place in the
    screening. screening, preliminary, fit: None before that stage. preliminary_general, general: the same fits with the
    general form of the law, None without one.
    """

    start: AppliedEffect
    strength: str
    index: int = -1
    screening: ScreeningResult | None = None
    preliminary: PreliminaryFit | None = None
    preliminary_general: PreliminaryFit | None = None
    fit: CandidateFit | None = None
    general: CandidateFit | None = None

    @property
    def key(self) -> tuple[str, str]:
        """The name of the effect, and its site."""
        return self.start.effect.name, self.start.site

    @property
    def screened(self) -> ScreeningResult:
        """The result of screening, which has taken place."""
        assert self.screening is not None
        return self.screening

    @property
    def tried(self) -> PreliminaryFit:
        """The preliminary fit, which has taken place."""
        assert self.preliminary is not None
        return self.preliminary

    @property
    def all_tried(self) -> tuple[PreliminaryFit, ...]:
        """The preliminary fits of both forms of the law, as far as they have taken place."""
        return tuple(one for one in (self.preliminary, self.preliminary_general) if one is not None)

    @property
    def best_fit(self) -> CandidateFit:
        """The fit of the general form if its gain is larger, else that of the textbook form."""
        return max((one for one in (self.fitted, self.general) if one is not None), key=lambda one: one.gain)

    @property
    def fitted(self) -> CandidateFit:
        """The fit to all events, which has taken place."""
        assert self.fit is not None
        return self.fit
