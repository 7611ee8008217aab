"""Refits of the score: one effect of the catalogue together with theta, from several starts, without the tracer."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect, Effect, Ranges, logistic
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.phase2 import interior, mapped, slope_by_phi, trust_region
from biodyn_core.identification.problem import Case
from blind.tracing.outcome import Cause, site_distance

Floats = NDArray[np.float64]

STEP: Final = 1e-4
"""Step for the derivative by an effect's parameter, as a share of its range."""

INSIDE: Final = 0.02
SIDE_BY_SIDE: Final = 8
"""Starts that are simulated together; their answers to nine events are about 30 MB each."""

FARTHEST_MPS2: Final = 1e5
"""A larger acceleration means that the simulation is unstable."""

STARTS: Final = 2
EVALUATIONS: Final = 150


@dataclass(frozen=True, eq=False)
class Start:
    """A start of a refit, and the share of the residual's energy that it removes to first order."""

    applied: AppliedEffect
    gain: float


def starts(fit: Fit, cases: Sequence[Case], tried: Iterable[AppliedEffect]) -> list[Start]:
    """Starts with strengths from the residual, theta refitted to first order; the largest gain first."""
    every, found = list(tried), []
    for begin in range(0, len(every), SIDE_BY_SIDE):
        found += _sized(fit, cases, every[begin : begin + SIDE_BY_SIDE])
    return sorted(found, key=lambda one: -one.gain)


def oracle(fit: Fit, cases: Sequence[Case], cause: Cause) -> Subject:
    """The true class refitted from the best starts at its true site, or at the best one if unknown."""
    effect = CATALOGUE[cause.name]
    sites = [site for site in effect.sites if cause.site and not site_distance(effect.name, site, cause.site)]
    ranked = starts(fit, cases, _tries(effect, sites or effect.sites, cases))
    return min((refitted(fit, cases, one.applied) for one in ranked[:STARTS]), key=lambda end: end[1])[0]


def placebo(fit: Fit, cases: Sequence[Case], cause: Cause) -> Subject | None:
    """The refit of a wrong class: the median by first-order gain of those with the nearest number of parameters."""
    count = len(CATALOGUE[cause.name].parameters)
    wrong = [effect for effect in CATALOGUE.values() if effect.name != cause.name and effect.family != cause.family]
    nearest = min(abs(len(effect.parameters) - count) for effect in wrong)
    alike = [effect for effect in wrong if abs(len(effect.parameters) - count) == nearest]
    best: dict[tuple[str, str], Start] = {}
    for one in starts(fit, cases, (start for effect in alike for start in _tries(effect, effect.sites, cases))):
        best.setdefault((one.applied.effect.name, one.applied.site), one)
    ranked = list(best.values())
    return refitted(fit, cases, ranked[len(ranked) // 2].applied)[0] if ranked else None


def refitted(fit: Fit, cases: Sequence[Case], applied: AppliedEffect) -> tuple[Subject, float]:
    """Theta and the effect fitted together from the fit's theta and these values, and the sum of squared residuals."""
    joint = _Joint(fit, cases, applied)
    theta, phi = mapped(interior(fit.subject.parameters.vector()), fit.settings.free)

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        at, share = theta(point[: phi.size]), logistic(point[phi.size :])
        residuals, slopes = joint.linearised(at, share)
        slopes[:, : phi.size] *= slope_by_phi(at)[fit.settings.free]
        slopes[:, phi.size :] *= share * (1.0 - share)
        return residuals, slopes

    share = np.clip(joint.shares(applied), INSIDE, 1.0 - INSIDE)
    end, objective = trust_region(linearised, np.concatenate([phi, np.log(share / (1.0 - share))]), EVALUATIONS)
    return joint.subject(logistic(end[phi.size :]), theta(end[: phi.size])), objective


class _Joint:
    """The objective of cases for a subject with a further effect, whose parameters are shares of their ranges (m,)."""

    def __init__(self, fit: Fit, cases: Sequence[Case], applied: AppliedEffect) -> None:
        self._fit, self._cases, self._applied = fit, cases, applied
        self._names = [parameter.name for parameter in applied.effect.parameters]
        self._ranges = Ranges(applied.effect.parameters)
        self._substeps: tuple[int, ...] | None = None
        # Chosen once, so that the objective is smooth.
        self._substeps = self._domain(self.shares(applied)).substeps

    def shares(self, applied: AppliedEffect) -> Floats:
        """Values as shares of their ranges."""
        return self._ranges.shares(np.array([applied.values[name] for name in self._names]))

    def subject(self, share: Floats, theta: Floats) -> Subject:
        """The fit's subject with this effect and this theta."""
        values = dict(zip(self._names, self._ranges.values(share).tolist(), strict=True))
        applied = AppliedEffect(self._applied.effect, self._applied.site, values)
        return dataclasses.replace(self._fit.subject, parameters=Parameters.from_vector(theta), effects=(applied,))

    def linearised(self, theta: Floats, share: Floats) -> tuple[Floats, Floats]:
        """As `TimeDomain.linearised`, with the derivatives by the shares behind those by ln theta."""
        if not share.size:
            return self._domain(share).linearised(theta, self._fit.settings.free)
        steps = np.where(share < 0.5, STEP, -STEP)  # inwards
        stepped = [self._domain(share + step) for step in np.diag(steps)]
        others = [np.stack([one.accelerations(i, theta) for one in stepped], axis=2) for i in range(len(self._cases))]
        residuals, slopes = self._domain(share).linearised(theta, self._fit.settings.free, others)
        slopes[:, -share.size :] /= steps
        return residuals, slopes

    def _domain(self, share: Floats) -> TimeDomain:
        subject = self.subject(share, self._fit.subject.parameters.vector())
        return TimeDomain(self._cases, subject, _no_regularization(subject), self._fit.settings.clocks, self._substeps)


def _tries(effect: Effect, sites: Iterable[str], cases: Sequence[Case]) -> list[AppliedEffect]:
    """Every combination of an effect's grids with each strength, at sites with the needed channels."""
    found = []
    for site in sites:
        if not all(name in case.channels for case in cases for name in effect.required_channels(site)):
            continue
        grids = [p.grid or (p.size,) for p in effect.parameters]
        for values in itertools.product(*grids):
            shape = dict(zip((p.name for p in effect.parameters), values, strict=True))
            for strength in effect.strengths or ("",):
                others = {name: 0.0 for name in effect.strengths if name != strength}
                found.append(AppliedEffect(effect, site, shape | others))
    return found


def _sized(fit: Fit, cases: Sequence[Case], tried: Sequence[AppliedEffect]) -> list[Start]:
    """The same effects with strengths from one linear step together with theta."""
    theta, free = fit.subject.parameters.vector(), fit.settings.free
    bent = [dataclasses.replace(fit.subject, effects=(one,)) for one in tried]
    domains = [TimeDomain(cases, subject, _no_regularization(subject), fit.settings.clocks) for subject in bent]
    with np.errstate(all="ignore"):  # unstable simulations are detected below
        others = [np.stack([one.accelerations(i, theta) for one in domains], axis=2) for i in range(len(cases))]
    unstable = np.any([~(np.abs(answers).max(axis=(0, 1)) < FARTHEST_MPS2) for answers in others], axis=0)
    for answers in others:
        answers[:, :, unstable] = 0.0
    plain = TimeDomain(cases, fit.subject, _no_regularization(fit.subject), fit.settings.clocks)
    residual, slopes = plain.linearised(theta, free, others)
    base, own = slopes[:, : int(free.sum())], slopes[:, int(free.sum()) :]
    both = np.column_stack([own, residual])
    left = both - base @ np.linalg.lstsq(base, both, rcond=1e-12)[0]
    found = []
    for i, one in enumerate(tried):
        energy, match = float(left[:, i] @ left[:, i]), -float(left[:, i] @ left[:, -1])
        seen = not unstable[i] and energy > 1e-12
        size, gain = (match / energy, match * match / energy) if seen else (1.0, 0.0)
        found.append(Start(_scaled(one, size), gain / max(float(left[:, -1] @ left[:, -1]), 1e-30)))
    return found


def _scaled(applied: AppliedEffect, factor: float) -> AppliedEffect:
    """The same with its strengths so much larger, within their ranges."""
    values = dict(applied.values)
    for parameter in applied.effect.parameters:
        if parameter.kind == "strength":
            values[parameter.name] = min(max(values[parameter.name] * factor, parameter.lower), parameter.upper)
    try:
        return AppliedEffect(applied.effect, applied.site, values)
    except InputError:
        return applied


def _no_regularization(subject: Subject) -> RegularizationTerm:
    return RegularizationTerm(subject.parameters.vector(), 0.0)
