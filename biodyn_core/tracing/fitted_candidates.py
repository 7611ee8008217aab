"""Fitted candidates: the gain of each candidate after a fit to all events."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.parameters import Parameters
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.candidate import Candidate, CandidateFit
from biodyn_core.tracing.local_fit import LocalFit, evidence_gain, fit_locally
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.screen import Screening, by_event
from biodyn_core.tracing.settings import LocalFitSettings, UnsteadySettings
from biodyn_core.tracing.unsteady import unsteady_causes


def residual_ratio(nuisance: NuisanceModel, fit: LocalFit) -> float:
    """Residual of the median event for choosing, rms, in multiples of a good model's."""
    return float(np.sqrt(np.median(np.square(residual_ratios(nuisance, fit)))))


def residual_ratios(nuisance: NuisanceModel, fit: LocalFit) -> tuple[float, ...]:
    """Residual of each event for choosing, rms, in multiples of a good model's."""
    p, square = nuisance.choose.products, fit.residual_square
    each = [(square[p.event == e].sum(), p.samples[p.event == e].sum()) for e in np.unique(p.event)]
    return tuple(float(np.sqrt(total / max(samples, 1.0))) for total, samples in each)


class WithoutEffect:
    """The fits without an effect, one for each prior scale that is needed."""

    def __init__(self, nuisance: NuisanceModel, settings: LocalFitSettings | None = None) -> None:
        self.nuisance, self.settings = nuisance, settings or LocalFitSettings()
        self._fits: dict[float, LocalFit] = {}

    def at(self, prior_scale: float) -> LocalFit:
        """The fit at a prior scale."""
        if prior_scale not in self._fits:
            self._fits[prior_scale] = fit_locally(self.nuisance.at_scale(prior_scale), None, self.settings)
        return self._fits[prior_scale]


def fits_at_scales(
    nuisance: NuisanceModel, item: tuple[AppliedEffect, Parameters, LocalFitSettings]
) -> list[tuple[float, LocalFit]]:
    """Fits of an effect to all events, with their prior scales: the most probable without and with the effect.

    item: its start, the start of theta, and the settings. Empty if the simulation is unstable.
    """
    start, theta, settings = item
    local = fit_locally(nuisance, start, settings, theta=theta)
    if local.applied is None or not np.isfinite(local.objective):
        return []
    if local.prior_scale == nuisance.prior_scale:
        return [(nuisance.prior_scale, local)]
    again = fit_locally(nuisance.at_scale(local.prior_scale), local.applied, settings, theta=local.subject.parameters)
    both = [(nuisance.prior_scale, local), (local.prior_scale, again)]
    return both if np.isfinite(again.objective) else both[:1]


def candidate_fit(without_effect: WithoutEffect, fits: Sequence[tuple[float, LocalFit]]) -> CandidateFit:
    """The fit of an effect by its `fits_at_scales`, at least one; its gain is the smaller one of both prior scales."""
    nuisance = without_effect.nuisance
    gains = [_gains(without_effect, local, scale) for scale, local in fits]
    fitted_at, local = fits[-1]
    fit = CandidateFit(local, min(gains, key=np.mean), _conditions(nuisance), fitted_at=fitted_at)
    return dataclasses.replace(fit, typical_multiple=nuisance.typical_multiple(fit.applied))


def _gains(without_effect: WithoutEffect, local: LocalFit, prior_scale: float) -> Floats:
    """The gain of an effect in each event for choosing, (e,), both fits at one prior scale."""
    nuisance, without = without_effect.nuisance, without_effect.at(prior_scale)
    ratios = by_event(without.residual_square, local.residual_square[:, None], nuisance.choose.products)[:, 0]
    return np.asarray(ratios + evidence_gain(nuisance, without, local))


def _conditions(nuisance: NuisanceModel) -> tuple[str, ...]:
    return tuple(case.case for case in nuisance.choose.cases)


def unsteady_candidates(
    nuisance: NuisanceModel, without: LocalFit, screening: Screening, settings: UnsteadySettings
) -> list[Candidate]:
    """Causes that vary with time, as fitted candidates; only those that were screened."""
    products, found = nuisance.choose.products, []
    screened = {one.key: one for one in reversed(screening.ranking)}
    for cause in unsteady_causes(nuisance, without, settings):
        known = screened.get((cause.applied.effect.name, cause.applied.site))
        if known is not None:
            local = dataclasses.replace(without, applied=cause.applied, residual_square=cause.residual_square)
            gains = by_event(without.residual_square, cause.residual_square[:, None], products)[:, 0]
            fit = CandidateFit(local, gains, _conditions(nuisance), steady=False, objection=cause.objection)
            found.append(dataclasses.replace(known, fit=fit))
    return found
