"""Refits of the score: one effect of the catalogue together with theta, with the true class and site known."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect, Effect
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.tracing import joint_refit, screen
from biodyn_core.tracing.joint_refit import JointFit
from biodyn_core.tracing.reach import Reach
from blind.tracing.outcome import Cause, site_distance

Floats = NDArray[np.float64]

SIDE_BY_SIDE: Final = 8
"""Starts that are simulated together; their answers to nine events are about 30 MB each."""

FARTHEST_MPS2: Final = 1e5
"""A larger acceleration means that the simulation is unstable."""

STARTS: Final = 2


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
    """The true class refitted from the best starts at its true site, or at the best one if unknown.

    A class is a mechanism: the law of each of its effects is tried.
    """
    tried: list[AppliedEffect] = []
    for effect in (one for one in CATALOGUE.values() if one.mechanism == cause.mechanism):
        sites = [site for site in effect.sites if cause.site and not site_distance(effect.name, site, cause.site)]
        tried += tries(fit.subject, effect, sites or effect.sites, cases)
    ranked = starts(fit, cases, tried)
    return refitted(fit, cases, [one.applied for one in ranked[:STARTS]]).subject


def placebo(fit: Fit, cases: Sequence[Case], cause: Cause) -> Subject | None:
    """The refit of a wrong class: the median by first-order gain of those with the nearest number of parameters."""
    count = len(CATALOGUE[cause.name].parameters)
    wrong = [effect for effect in CATALOGUE.values() if effect.name != cause.name and effect.family != cause.family]
    nearest = min(abs(len(effect.parameters) - count) for effect in wrong)
    alike = [effect for effect in wrong if abs(len(effect.parameters) - count) == nearest]
    best: dict[tuple[str, str], Start] = {}
    for one in starts(
        fit, cases, (start for effect in alike for start in tries(fit.subject, effect, effect.sites, cases))
    ):
        best.setdefault((one.applied.effect.name, one.applied.site), one)
    ranked = list(best.values())
    return refitted(fit, cases, [ranked[len(ranked) // 2].applied]).subject if ranked else None


def refitted(fit: Fit, cases: Sequence[Case], tried: Sequence[AppliedEffect], textbook: bool = False) -> JointFit:
    """Theta and an effect fitted together from these values, its general form last; never worse than the fit."""
    clocks, free = fit.settings.clocks, fit.settings.free
    with_effect = [dataclasses.replace(fit.subject, effects=(one,)) for one in tried]
    best = joint_refit.refit(fit.subject, cases, with_effect, clocks, textbook=True, free=free)
    if textbook or not best.subject.effects:
        return best
    return joint_refit.refit(best.subject, cases, joint_refit.general_starts(best.subject, cases), clocks, free=free)


def tries(subject: Subject, effect: Effect, sites: Iterable[str], cases: Sequence[Case]) -> list[AppliedEffect]:
    """The starts of an effect at sites where its channels are."""
    reach = Reach.of(subject, cases)
    testable = [
        site for site in sites if all(set(effect.required_channels(site)) <= set(case.channels) for case in cases)
    ]
    return [applied for site in testable for _, applied in screen.starts(effect, site, reach)]


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
