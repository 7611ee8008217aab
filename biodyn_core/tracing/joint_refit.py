"""Joint refit: theta and all effects of a subject fitted together to all events, without nuisance parameters.

Local fits have nuisance parameters and textbook laws. The resulting subject and the reported errors have general laws
and no nuisance parameters.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, Ranges, logistic
from biodyn_core.effects.ranges import FINITE
from biodyn_core.identification.objectives import PENALTY, RegularizationTerm, TimeDomain, linearised_of
from biodyn_core.identification.phase2 import interior, mapped, slope_by_phi, trust_region
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import Clocks
from biodyn_core.tracing.answers import answers, first_unstable
from biodyn_core.tracing.nuisance_model import FREE
from biodyn_core.tracing.settings import JointRefitSettings

STEP: Final = 1e-4
"""Step of an effect's parameter for its derivative, as a share of its range.

The change of the answer is far larger than rounding errors, and still linear.
"""


@dataclass(frozen=True, eq=False)
class JointFit:
    """A subject with its effects, and the sum of squares (Eq. 33), prior included."""

    subject: Subject
    objective: float


def jointly_refitted(
    subject: Subject, cases: Sequence[Case], settings: JointRefitSettings | None = None,
    parallel: ParallelMap = serial_map,
) -> Subject:  # fmt: skip
    """The subject with theta and the textbook parameters of the least sum of squares over all cases (Eq. 33)."""
    return refit(subject, cases, [subject], textbook=True, settings=settings, parallel=parallel).subject


def generalised(
    subject: Subject, cases: Sequence[Case], settings: JointRefitSettings | None = None,
    also: Sequence[Subject] = (), parallel: ParallelMap = serial_map,
) -> Subject:  # fmt: skip
    """A refitted subject with the general form of its last effect, from several starts, and all refitted again.

    also: further starts. The subject itself if its last effect has no general form.
    """
    if not subject.effects or not subject.effects[-1].effect.general_form:
        return subject
    starts = [*general_starts(subject, cases, settings), *also]
    return refit(subject, cases, starts, settings=settings, parallel=parallel).subject


def covariances(
    subject: Subject, cases: Sequence[Case], independent: float, settings: JointRefitSettings | None = None
) -> list[Floats]:
    """Covariance (p, p) of the parameters of each effect of a refitted subject on the real line, all else fitted too.

    independent: the share of the samples that count as independent. The residual counts as noise.
    """
    s = settings or JointRefitSettings()
    problem = _Problem(subject, cases, FREE, "trusted", textbook=False, settings=s)
    share = np.clip(problem.shares(), FINITE, 1.0 - FINITE)  # the draws of a law are around the same point
    residuals, slopes = problem.linearised(problem.theta, share)
    slopes[:, -share.size :] *= share * (1.0 - share)
    samples = sum(int(case.compared.sum()) for case in cases)
    variance = float(residuals @ residuals) / max(independent * samples, 1.0)
    spread = np.concatenate([np.full(slopes.shape[1] - share.size, s.theta_spread), np.full(share.size, s.psi_spread)])
    covariance: Floats = np.asarray(np.linalg.inv(slopes.T @ slopes / variance + np.diag(1.0 / spread**2)))
    ends = np.cumsum([len(one.effect.parameters) for one in subject.effects]) + covariance.shape[0] - share.size
    return [
        covariance[end - len(one.effect.parameters) : end, end - len(one.effect.parameters) : end]
        for end, one in zip(ends, subject.effects, strict=True)
    ]


def refit(
    subject: Subject,
    cases: Sequence[Case],
    tried: Sequence[Subject],
    clocks: Clocks = "trusted",
    textbook: bool = False,
    free: Flags = FREE,
    settings: JointRefitSettings | None = None,
    parallel: ParallelMap = serial_map,
) -> JointFit:
    """The best of several starts, refitted until it converges; never worse than the subject itself.

    textbook: general parameters keep their values. parallel: simulates the cases side by side.
    """
    s = settings or JointRefitSettings()

    def problem(one: Subject) -> _Problem:
        return _Problem(one, cases, free, clocks, textbook, s)

    ends = [_descended(problem(_stable(one, cases, s.halvings)), s.first_evaluations, parallel) for one in tried]
    best = min(ends, key=lambda end: end.objective)
    last = _descended(problem(best.subject), s.evaluations, parallel)
    return min((last, best, JointFit(subject, problem(subject).objective())), key=lambda end: end.objective)


def general_starts(
    subject: Subject, cases: Sequence[Case], settings: JointRefitSettings | None = None
) -> list[Subject]:
    """The subject, and with each combination of the starts of the general parameters of its last effect.

    Strengths then give the change of the answer that the subject's own values give, by least squares. A combination
    is left out if its simulation, or that of the subject's own values, is unstable at every strength.
    """
    if not subject.effects:
        return [subject]
    halvings = (settings or JointRefitSettings()).halvings
    *others, last = subject.effects
    without = dataclasses.replace(subject, effects=tuple(others))
    plain = np.concatenate([one.ravel() for one in answers(without, cases)])

    def change(one: AppliedEffect) -> Floats:
        bent = dataclasses.replace(without, effects=(*others, one))
        return np.concatenate([each.ravel() for each in answers(_stable(bent, cases, halvings), cases)]) - plain

    general = [p for p in last.effect.parameters if p.neutral is not None and p.grid]
    found, own = [subject], change(last)
    for values in itertools.product(*(p.grid for p in general)):
        shape = dict(zip((p.name for p in general), values, strict=True))
        one = dataclasses.replace(last, values={**last.values, **shape})
        if one == last:
            continue
        other = change(one)
        with np.errstate(all="ignore"):
            factor = float(own @ other) / max(float(other @ other), 1e-30)
        if np.isfinite(factor):
            found.append(dataclasses.replace(subject, effects=(*others, _scaled(one, factor))))
    return found


def _stable(subject: Subject, cases: Sequence[Case], halvings: int) -> Subject:
    """The subject, with weaker strengths of its last effect if its simulation is unstable."""
    for _ in range(halvings):
        if first_unstable(subject, cases) is None or not subject.effects:
            break
        *others, last = subject.effects
        subject = dataclasses.replace(subject, effects=(*others, _scaled(last, 0.5)))
    return subject


def _scaled(applied: AppliedEffect, factor: float) -> AppliedEffect:
    """The effect with its strengths times a factor, within their ranges."""
    values = {
        p.name: min(max(applied.values[p.name] * factor, p.lower), p.upper)
        for p in applied.effect.parameters
        if p.kind == "strength"
    }
    return dataclasses.replace(applied, values={**applied.values, **values})


def _descended(problem: _Problem, evaluations: int, parallel: ParallelMap) -> JointFit:
    """The end of the trust region from the problem's own subject."""
    theta, phi = mapped(interior(problem.theta, problem.free), problem.free)
    start = np.concatenate([phi, problem.start()])

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        at, share = theta(point[: phi.size]), logistic(point[phi.size :])
        residuals, slopes = problem.linearised(at, share, parallel)
        slopes[:, : phi.size] *= slope_by_phi(at)[problem.free]
        slopes[:, phi.size :] *= share * (1.0 - share)
        return residuals, slopes

    end, objective = trust_region(linearised, start, evaluations, problem.settings.least_decrease)
    return JointFit(problem.subject(logistic(end[phi.size :]), theta(end[: phi.size])), objective)


class _Problem:
    """The objective of the cases; effect parameters are shares of their ranges (m,)."""

    def __init__(
        self, subject: Subject, cases: Sequence[Case], free: Flags, clocks: Clocks, textbook: bool,
        settings: JointRefitSettings,
    ) -> None:  # fmt: skip
        self.free, self.settings = free, settings
        self._subject, self._cases, self._clocks = subject, cases, clocks
        self._fitted = [
            one.effect.textbook_parameters if textbook else one.effect.parameters for one in subject.effects
        ]
        self._parameters = [(one, p) for one, its in zip(subject.effects, self._fitted, strict=True) for p in its]
        self._ranges = Ranges([p for _, p in self._parameters])
        self._values = np.array([applied.values[p.name] for applied, p in self._parameters])
        # Chosen once, so that the objective is smooth.
        self._substeps: list[int] = []
        self._substeps = [self._domain(number, self.shares()).substeps[0] for number in range(len(cases))]

    @property
    def theta(self) -> Floats:
        """Theta (15,) of the subject."""
        return self._subject.parameters.vector()

    def objective(self) -> float:
        """The sum of squares at the subject's own values."""
        residuals, _ = self.linearised(self.theta, self.shares())
        return float(residuals @ residuals) if np.isfinite(residuals).all() else PENALTY

    def start(self) -> Floats:
        """The start of the effect parameters, on the real line (m,)."""
        return self._ranges.unbounded(self._values, self.settings.inside)

    def subject(self, share: Floats, theta: Floats) -> Subject:
        """The subject with these shares and theta (15,)."""
        values = iter(self._ranges.values(share).tolist())
        effects = tuple(
            dataclasses.replace(one, values={**one.values, **{p.name: next(values) for p in its}})
            for one, its in zip(self._subject.effects, self._fitted, strict=True)
        )
        return dataclasses.replace(self._subject, parameters=Parameters.from_vector(theta), effects=effects)

    def linearised(self, theta: Floats, share: Floats, parallel: ParallelMap = serial_map) -> tuple[Floats, Floats]:
        """Residuals and their derivatives by ln theta and by the shares, as `TimeDomain.linearised`, then the prior."""
        items = [(number, theta, share) for number in range(len(self._cases))]
        products = sum(parallel("refitting", _products, self, items), start=np.zeros(()))  # in the order of the cases
        residuals, slopes = linearised_of(products)
        if not share.size:
            return residuals, slopes
        slopes[:, -share.size :] /= _steps(share)
        prior, along = self._prior(share)
        beside = np.zeros((prior.size, slopes.shape[1]))
        beside[:, -share.size :] = np.diag(along)
        return np.concatenate([residuals, prior]), np.concatenate([slopes, beside])

    def products(self, number: int, theta: Floats, share: Floats) -> Floats:
        """The part of one case in the products of residuals and derivatives; those by shares are differences."""
        stepped = [self._domain(number, share + step) for step in np.diag(_steps(share))]
        others = [domain.accelerations(0, theta) for domain in stepped]
        domain = self._domain(number, share)
        return domain.products(0, theta, self.free, np.stack(others, axis=2) if others else None)

    def _prior(self, share: Floats) -> tuple[Floats, Floats]:
        """Weighted multiples of the prior spread of each parameter (m,), and their derivatives by its share."""

        def multiples(shares: Floats) -> Floats:
            return np.array([
                0.0 if p.neutral is None else (p.at_share(s) - p.neutral) / p.spread
                for (_, p), s in zip(self._parameters, shares, strict=True)
            ])  # fmt: skip

        at, weight = multiples(share), np.sqrt(self.settings.prior_weight)
        step = _steps(share)
        return weight * at, weight * (multiples(share + step) - at) / step

    def shares(self) -> Floats:
        """The effect parameters of the subject as shares of their ranges, (m,)."""
        return self._ranges.shares(self._values)

    def _domain(self, number: int, share: Floats) -> TimeDomain:
        """The objective of one case."""
        subject, substeps = self.subject(share, self.theta), self._substeps[number : number + 1]
        none = RegularizationTerm(self.theta, 0.0)
        return TimeDomain([self._cases[number]], subject, none, self._clocks, substeps)


def _products(problem: _Problem, item: tuple[int, Floats, Floats]) -> Floats:
    return problem.products(*item)


def _steps(share: Floats) -> Floats:
    """Steps of shares (m,) for their derivatives, inwards."""
    return np.where(share < 0.5, STEP, -STEP)
