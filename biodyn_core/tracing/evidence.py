"""Evidence of one round: the numbers of every candidate and of the whole body from which probabilities follow."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from biodyn_core.identification.fit import at_bound
from biodyn_core.tracing.beside import Beside
from biodyn_core.tracing.candidate import Candidate, CandidateFit
from biodyn_core.tracing.findings import Diagnostics
from biodyn_core.tracing.fitted_candidates import WithoutEffect, residual_ratio, residual_ratios
from biodyn_core.tracing.local_fit import LocalFit, evidence_gain
from biodyn_core.tracing.nuisance_model import FREE, NuisanceModel
from biodyn_core.tracing.screen import Screening
from biodyn_core.tracing.sensor_tilt import mean_tilts


@dataclass(frozen=True)
class FitEvidence:
    """The evidence of a fit to all events.

    gains (e,): log ratio in each event for choosing; evidence_gain: the part of it that comes from the penalty;
    decrease: of the objective, as a share; residual: `residual_ratio`; nuisance_square, prior_scale: see `LocalFit`;
    typical_multiple: None if no deviation is like it; on_bound: parameters of the effect on a bound; theta_on_bound:
    those of theta that are there with the effect alone; theta_shift: rms change of ln theta by the effect.
    """

    gains: tuple[float, ...]
    evidence_gain: float
    decrease: float
    residual: float
    nuisance_square: float
    prior_scale: float
    typical_multiple: float | None
    on_bound: int
    theta_on_bound: int
    theta_shift: float

    @property
    def gain(self) -> float:
        """The mean gain."""
        return float(np.mean(self.gains))


@dataclass(frozen=True)
class CandidateEvidence:
    """The evidence of one effect at one site.

    screened, decrease, absorbed: gain, decrease and absorbed share of screening; tried: gain and decrease of the
    preliminary fit of the better form; fit, general: of the textbook form and of the general one; None before that
    stage. varying: gains (e,) of the same cause fitted again in every window or between events, and whether there is an
    objection to it; None if there is no such cause. beside: effect, site and gain of each other fitted candidate beside
    this one.
    """

    effect: str
    site: str
    screened: float
    decrease: float
    absorbed: float
    tried: tuple[float, float] | None = None
    fit: FitEvidence | None = None
    varying: tuple[tuple[float, ...], bool] | None = None
    general: FitEvidence | None = None
    beside: tuple[tuple[str, str, float], ...] = ()

    @property
    def key(self) -> tuple[str, str]:
        """The name of the effect, and its site."""
        return self.effect, self.site


@dataclass(frozen=True)
class BodyEvidence:
    """The evidence of a body without an effect.

    residuals (e,): rms of the events for choosing in multiples of a good model's, at the most probable prior scale;
    residual_at_unit_scale: the median at prior scale 1. chance: quantiles 0.5 and 0.95 of the largest random gain.
    conditions, peaks_mps2 (e,): loading condition and peak of the seat of each event for choosing. samples: independent
    ones for fitting. tilts: mean tilt by the gyro, as a share of g, by sensor. known_effects: of the subject.
    level_slope, jump (p-value), drift (largest), bracket, transfer (largest ratio), coherent: see `Diagnostics`.
    """

    residuals: tuple[float, ...]
    residual_at_unit_scale: float
    nuisance_square: float
    prior_scale: float
    chance: tuple[float, float]
    conditions: tuple[str, ...]
    peaks_mps2: tuple[float, ...]
    samples: float
    tilts: Mapping[str, float]
    known_effects: int
    level_slope: float | None
    jump: float | None
    drift: float
    transfer: float
    bracket: tuple[str, ...]
    coherent: Mapping[str, tuple[str, float]]


@dataclass(frozen=True)
class Evidence:
    """The evidence of one round: of its body, and of each effect at each site that was tried."""

    body: BodyEvidence
    candidates: tuple[CandidateEvidence, ...]

    def to_dict(self) -> dict[str, Any]:
        """As plain data with four significant digits."""
        found: dict[str, Any] = _rounded(dataclasses.asdict(self))
        return found

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> Evidence:
        """From plain data."""
        body = {key: _frozen(value) for key, value in stored["body"].items()}
        return cls(BodyEvidence(**body), tuple(map(_candidate, stored["candidates"])))


def evidence_of(
    without_effect: WithoutEffect, screening: Screening, preliminary: Sequence[Candidate], fitted: Sequence[Candidate],
    beside: Beside, diagnostics: Diagnostics, near_bound: float,
) -> Evidence:  # fmt: skip
    """The evidence of a round from its fits."""
    best: dict[tuple[str, str], Candidate] = {}
    steady = [one for one in fitted if one.fitted.steady]
    for one in (*steady, *preliminary, *screening.ranking):  # the furthest stage of each, then the largest gain
        best.setdefault(one.key, one)
    varying = {one.key: (tuple(one.fitted.gains.tolist()), bool(one.fitted.objection)) for one in fitted
               if not one.fitted.steady}  # fmt: skip
    candidates = [_of_candidate(without_effect, one, near_bound) for one in best.values()]
    return Evidence(
        _of_body(without_effect, screening, diagnostics),
        tuple(
            dataclasses.replace(one, beside=beside.get(one.key, ()), varying=varying.get(one.key)) for one in candidates
        ),
    )


def _of_body(without_effect: WithoutEffect, screening: Screening, diagnostics: Diagnostics) -> BodyEvidence:
    nuisance, d = without_effect.nuisance, diagnostics
    without, cases = without_effect.at(nuisance.prior_scale), nuisance.choose.cases
    return BodyEvidence(
        residuals=residual_ratios(nuisance, without),
        residual_at_unit_scale=residual_ratio(nuisance, without_effect.at(1.0)),
        nuisance_square=without.nuisance_square,
        prior_scale=nuisance.prior_scale,
        chance=(float(np.quantile(screening.chance, 0.5)), float(np.quantile(screening.chance, 0.95))),
        conditions=tuple(case.case for case in cases),
        peaks_mps2=tuple(float(np.abs(case.seat_mps2).max()) for case in cases),
        samples=nuisance.independent_samples,
        tilts=mean_tilts([*nuisance.train.cases, *cases]),
        known_effects=len(nuisance.subject.effects),
        level_slope=d.level_slope,
        jump=d.jump[1] if d.jump else None,
        drift=max(d.drift.values()),
        transfer=max(quiet / max(everything, 1e-9) for quiet, everything in d.amplitude_transfer.values()),
        bracket=d.bracket,
        coherent=dict(d.coherent),
    )


def _of_candidate(without_effect: WithoutEffect, one: Candidate, near_bound: float) -> CandidateEvidence:
    best = max(one.all_tried, key=lambda fit: fit.gain, default=None)
    tried = None if best is None else (best.gain, best.decrease)
    fit, general = (
        None if each is None else _of_fit(without_effect, each, near_bound) for each in (one.fit, one.general)
    )
    of = one.screened
    return CandidateEvidence(*one.key, of.gain, of.decrease, of.absorbed, tried, fit, general=general)


def _of_fit(without_effect: WithoutEffect, fit: CandidateFit, near_bound: float) -> FitEvidence:
    nuisance = without_effect.nuisance.at_scale(fit.fitted_at)
    local, without = fit.local, without_effect.at(nuisance.prior_scale)
    multiple = fit.typical_multiple
    return FitEvidence(
        gains=tuple(fit.gains.tolist()),
        evidence_gain=evidence_gain(nuisance, without, local),
        decrease=1.0 - local.objective / without.objective,
        residual=residual_ratio(nuisance, local),
        nuisance_square=local.nuisance_square,
        prior_scale=local.prior_scale,
        typical_multiple=float(multiple) if np.isfinite(multiple) else None,
        on_bound=len(local.at_bound),
        theta_on_bound=len(theta_moved_to_bound(nuisance, without, local, near_bound)),
        theta_shift=_theta_shift(without, local),
    )


def theta_moved_to_bound(nuisance: NuisanceModel, without: LocalFit, fit: LocalFit, near_bound: float) -> list[str]:
    """The parameters of theta that end on a bound with an effect, and are not near it without."""
    before = {
        name
        for subject in (nuisance.subject, without.subject)
        for name in at_bound(subject.parameters.vector(), FREE, near_bound)
    }
    return [name for name in at_bound(fit.subject.parameters.vector(), FREE) if name not in before]


def _theta_shift(without: LocalFit, fit: LocalFit) -> float:
    ratio = fit.subject.parameters.vector()[FREE] / without.subject.parameters.vector()[FREE]
    return float(np.sqrt(np.mean(np.log(ratio) ** 2)))


def _rounded(value: Any) -> Any:
    """Plain data with floats of four significant digits; lists for tuples."""
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, (list, tuple)) else value


def _frozen(value: Any) -> Any:
    """Lists as tuples."""
    if isinstance(value, Mapping):
        return {key: _frozen(one) for key, one in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _candidate(stored: Mapping[str, Any]) -> CandidateEvidence:
    values = {key: _frozen(value) for key, value in stored.items()}
    fit, general = (None if one is None else FitEvidence(**one) for one in (values.pop("fit"), values.pop("general")))
    return CandidateEvidence(**values, fit=fit, general=general)
