"""Local fit: theta, the nuisance parameters and one effect fitted together from given start values.

Gauss-Newton steps. The derivatives by theta and by the nuisance parameters are those of the fitted subject, which a
small effect hardly changes, so a step costs one simulation for each parameter of the effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, Effect, EffectParameter, Ranges
from biodyn_core.effects.ranges import FINITE
from biodyn_core.tracing.answers import RUNAWAY_MPS2, accelerations, answers, sensed
from biodyn_core.tracing.nuisance_model import FREE, N_THETA, EventSet, NuisanceModel
from biodyn_core.tracing.rows import Products
from biodyn_core.tracing.settings import LocalFitSettings

PSI_STEP: Final = 0.02
"""Step for the derivative by an effect's parameter, which is mapped to the real line.

It moves a parameter by at most half a percent of its range: far more than rounding errors, and the change of the answer
is still linear.
"""


@dataclass(frozen=True, eq=False)
class LocalFit:
    """The fitted subject, with the effect if there is one, and its residual.

    coefficients (k,) of the known columns, theta's first; objective: on the events for fitting, infinite if the
    simulation is unstable; nuisance_square: sum of squared nuisance parameters, in typical spreads; prior_scale: the
    most probable one; penalty: of theta and nuisance parameters, in twice the log evidence, at the prior
    scale of the model; residual_square (w,): by window of the events for choosing; intervals: 95 % of each parameter
    of the effect; at_bound: those of them that end on a bound.
    """

    subject: Subject
    applied: AppliedEffect | None
    coefficients: Floats
    objective: float
    nuisance_square: float
    prior_scale: float
    penalty: float
    residual_square: Floats
    intervals: tuple[tuple[float, float], ...] = ()
    at_bound: tuple[str, ...] = ()


def fit_locally(
    nuisance: NuisanceModel, start: AppliedEffect | None, settings: LocalFitSettings | None = None,
    with_intervals: bool = False, textbook: bool = True, theta: Parameters | None = None,
) -> LocalFit:  # fmt: skip
    """Fit theta, the nuisance parameters and an effect from its start values; without a start, no effect.

    textbook: general parameters keep their values. theta: a further start of it, beside that of the fitted subject.
    Intervals cost as much as one step.
    """
    s = settings or LocalFitSettings()
    problem = _Problem(nuisance, start, s, textbook)
    at = problem.start(theta)
    for _ in range(s.steps):
        better = _line_search(problem, at, s.step_shares) if np.isfinite(at.objective) else None
        if better is None:
            break
        little = at.objective - better.objective < s.least_decrease * at.objective
        at = better
        if little:
            break
    unstable = LocalFit(at.subject, start, at.b, np.inf, 0.0, 1.0, 0.0, nuisance.choose.products.square)
    if not np.isfinite(at.objective):
        return unstable
    at, residual_square = problem.stable(at)
    prior_scale, penalty = problem.most_probable(at)
    # Other events, or parameters beside the solution, may be unstable although the solution is stable.
    if not (residual_square.max() < RUNAWAY_MPS2**2 and np.isfinite(penalty)):
        return unstable
    applied = problem.applied(at.psi) if start else None
    intervals = problem.intervals(at) if with_intervals else ()
    return LocalFit(
        at.subject, applied, at.b, at.objective, problem.nuisance_square(at), prior_scale, penalty, residual_square,
        intervals, problem.at_bound(at.psi),
    )  # fmt: skip


def fit_from(nuisance: NuisanceModel, item: tuple[AppliedEffect, Parameters | None, LocalFitSettings]) -> LocalFit:
    """The local fit from a start, and one of theta, with settings, for a parallel map."""
    start, theta, settings = item
    return fit_locally(nuisance, start, settings, theta=theta)


def start_objective(
    nuisance: NuisanceModel, start: AppliedEffect, theta: Parameters, settings: LocalFitSettings
) -> float:
    """The objective of an effect with these values at this theta, with the best nuisance parameters."""
    problem = _Problem(nuisance, start, settings, textbook=False)
    return problem.at(problem.relative(theta), problem.unbounded(start)).objective


def evidence_gain(nuisance: NuisanceModel, without: LocalFit, fitted: LocalFit) -> float:
    """Decrease of the penalty by an effect, in twice the log evidence for each independent sample.

    An effect that replaces a large nuisance parameter predicts no better, but it is more probable. Both fits need the
    same prior scale, because penalty and residual change with it in opposite directions.
    """
    return (without.penalty - fitted.penalty) / nuisance.independent_samples


def simulated_products(events: EventSet, subject: Subject) -> Products:
    """The products of events for another subject."""
    return events.products_of(events.residuals(subject))


def _line_search(problem: _Problem, at: _Point, shares: Sequence[float]) -> _Point | None:
    """The first point at these shares of the step with a smaller objective; None if there is none."""
    slopes = problem.by_psi(at)
    delta, psi = problem.step(at, slopes)
    if not (np.isfinite(delta).all() and np.isfinite(psi).all()):  # the simulation is unstable beside this point
        return None
    for share in shares:
        tried = problem.at(at.delta + share * (delta - at.delta), at.psi + share * (psi - at.psi), slopes)
        if tried.objective < at.objective:
            return tried
    return None


@dataclass(frozen=True, eq=False)
class _Point:
    """ln theta relative to the fit's (14,), the effect's parameters on the real line (p,), and the simulation of both.

    accel (n, 6) and answers (n, 5) of each event are those of the segments and the sensors; slopes: the derivatives by
    psi that led here, by event, empty at the start.
    """

    delta: Floats
    psi: Floats
    subject: Subject
    accel: list[Floats]
    answers: list[Floats]
    residuals: list[Floats]
    products: Products
    b: Floats
    objective: float
    slopes: Sequence[Floats]


def _fitted_parameters(effect: Effect, textbook: bool) -> tuple[EffectParameter, ...]:
    return effect.textbook_parameters if textbook else effect.parameters


class _Problem:
    """The objective of the events for fitting: squared residuals and the prior."""

    def __init__(
        self, nuisance: NuisanceModel, template: AppliedEffect | None, settings: LocalFitSettings, textbook: bool
    ) -> None:
        self._nuisance, self._template, self._settings = nuisance, template, settings
        parameters = _fitted_parameters(template.effect, textbook) if template else ()
        self._names = [p.name for p in parameters]
        self._ranges = Ranges(parameters)
        self._inside = np.array([FINITE if p.kind == "nuisance" else settings.inside for p in parameters])
        self._normal = nuisance.normal()
        self._own = np.linalg.inv(self._normal[N_THETA:, N_THETA:])
        self._has_strength = template is not None and bool(template.effect.strengths)
        self._without = self._objective(nuisance.train.products, np.zeros(N_THETA))[0]

    def at(self, delta: Floats, psi: Floats, slopes: Sequence[Floats] = ()) -> _Point:
        """Simulate a point and fit its nuisance parameters; the objective is infinite if the simulation is unstable."""
        train = self._nuisance.train
        subject = self._subject(delta, psi)
        accel = accelerations(subject, train.cases)
        sensor_accel = sensed(subject, train.cases, accel)
        residuals = [rows.residual(one) for rows, one in zip(train.rows, sensor_accel, strict=True)]
        products = train.products_of(residuals)
        if not products.square.max() < RUNAWAY_MPS2**2:  # also for NaN
            b = np.zeros(len(self._normal))
            return _Point(delta, psi, subject, accel, sensor_accel, residuals, products, b, np.inf, slopes)
        objective, b = self._objective(products, delta)
        return _Point(delta, psi, subject, accel, sensor_accel, residuals, products, b, objective, slopes)

    def _objective(self, products: Products, delta: Floats) -> tuple[float, Floats]:
        """The objective with the best nuisance parameters, and all coefficients (k,), theta's zero."""
        weight = self._nuisance.weight
        right = weight @ products.cross[:, N_THETA:]
        own = self._own @ right
        prior = float(self._nuisance.precision[:N_THETA] @ delta**2)
        return float(weight @ products.square) - float(right @ own) + prior, np.concatenate([np.zeros(N_THETA), own])

    def start(self, theta: Parameters | None) -> _Point:
        """The better start of theta; if no effect fits better than it, the best of weaker strengths.

        An effect that replaces a part of a joint, such as a cushion, fits only with another theta than without it.
        """
        psi = self.unbounded(self._template)
        found = self.at(np.zeros(N_THETA), psi)
        if theta is not None:
            found = min(found, self.at(self.relative(theta), psi), key=lambda point: point.objective)
        for share in self._settings.weaker_starts if self._has_strength else ():
            if found.objective < self._without:
                break
            tried = self.at(found.delta, self._weaker(self._template, share))
            found = min(found, tried, key=lambda point: point.objective)
        return found

    def relative(self, theta: Parameters) -> Floats:
        """Ln theta relative to the fit's, (14,)."""
        return np.asarray(np.log(theta.vector()[FREE] / self._nuisance.subject.parameters.vector()[FREE]))

    def stable(self, at: _Point) -> tuple[_Point, Floats]:
        """The first of this point and weaker ones that is stable in the events for choosing, and its residual there.

        residual_square (w,): by window. Without an effect a weaker point has a smaller change of theta. This point if
        none is stable, or all weaker ones fit worse than no effect.
        """
        square = self._residual_square(at)
        if square.max() < RUNAWAY_MPS2**2:
            return at, square
        for tried in self._weaker_points(at):
            found = self._residual_square(tried)
            if found.max() < RUNAWAY_MPS2**2:
                return tried, found
        return at, square

    def _residual_square(self, at: _Point) -> Floats:
        """The residual of a point in the events for choosing, by window (w,)."""
        return simulated_products(self._nuisance.choose, at.subject).residual_square(at.b)

    def _weaker_points(self, at: _Point) -> Iterator[_Point]:
        """Points with a smaller strength of the effect, as long as they fit better than no effect.

        Without an effect, points with a smaller change of theta, down to the fitted subject itself.
        """
        if self._template is None:
            yield from (self.at(share * at.delta, at.psi) for share in (*self._settings.weaker_ends, 0.0))
        for share in self._settings.weaker_ends if self._has_strength else ():
            tried = self.at(at.delta, self._weaker(self.applied(at.psi), share), at.slopes)
            if tried.objective < self._without:
                yield tried

    def step(self, at: _Point, slopes: Sequence[Floats]) -> tuple[Floats, Floats]:
        """The Gauss-Newton solution from here: delta (14,) and psi (p,)."""
        data, right = self._system(at, slopes)
        found = np.asarray(np.linalg.solve(data + np.diag(self._prior(self._nuisance.prior_scale, at.psi)), right))
        return found[:N_THETA], np.asarray(at.psi + found[len(self._normal) :])

    def nuisance_square(self, at: _Point) -> float:
        """Sum of squared nuisance parameters, in typical spreads."""
        return float(self._nuisance.unit_precision[N_THETA:] @ at.b[N_THETA:] ** 2)

    def most_probable(self, at: _Point) -> tuple[float, float]:
        """The prior scale with the largest evidence, all else refitted to first order, and the penalty at this one."""
        data, right = self._system(at, at.slopes or self.by_psi(at))
        square = float(self._nuisance.weight @ at.products.square)
        square += float(at.delta @ (2.0 * right[:N_THETA] - data[:N_THETA, :N_THETA] @ at.delta))
        found = []
        for scale in self._settings.prior_scales:
            prior = self._prior(scale, at.psi)
            x = np.linalg.solve(data + np.diag(prior), right)
            own = slice(N_THETA, len(prior) - at.psi.size)
            volume = np.linalg.slogdet((data + np.diag(prior))[own, own])[1] - np.log(prior[own]).sum()
            penalty = float(prior[: own.stop] @ x[: own.stop] ** 2 + volume)
            found.append((square - 2.0 * float(right @ x) + float(x @ data @ x) + penalty, scale, penalty))
        return min(found)[1], next(penalty for _, scale, penalty in found if scale == self._nuisance.prior_scale)

    def intervals(self, at: _Point) -> tuple[tuple[float, float], ...]:
        """95 % intervals of the effect's parameters, all else fitted as well."""
        if at.psi.size == 0:
            return ()
        data, _ = self._system(at, self.by_psi(at))
        prior = np.diag(self._prior(self._nuisance.prior_scale, at.psi))
        variance = np.diag(np.linalg.inv(data + prior))[len(self._normal) :]
        half = 1.96 * np.sqrt(np.maximum(variance, 0.0))
        low, high = (self._ranges.bounded(at.psi + sign * half) for sign in (-1.0, 1.0))
        return tuple(zip(low.tolist(), high.tolist(), strict=True))

    def at_bound(self, psi: Floats) -> tuple[str, ...]:
        """The effect's parameters that lie on a bound of their range."""
        if self._template is None:
            return ()
        values = self.applied(psi).values
        return tuple(p.name for p in self._template.effect.parameters if p.on_bound(values[p.name]))

    def applied(self, psi: Floats) -> AppliedEffect:
        """The effect with its parameters."""
        assert self._template is not None
        fitted = dict(zip(self._names, self._ranges.bounded(psi).tolist(), strict=True))
        return dataclasses.replace(self._template, values={**self._template.values, **fitted})

    def unbounded(self, start: AppliedEffect | None) -> Floats:
        """The values, moved inside their ranges, on the real line (p,)."""
        if start is None or not self._names:
            return np.empty(0)
        return self._ranges.unbounded(np.array([start.values[name] for name in self._names]), self._inside)

    def _weaker(self, applied: AppliedEffect | None, share: float) -> Floats:
        """The values with a share of every strength, on the real line (p,)."""
        assert applied is not None
        strengths = applied.effect.strengths
        values = [applied.values[name] * (share if name in strengths else 1.0) for name in self._names]
        return self._ranges.unbounded(np.array(values), self._settings.least_share)

    def _subject(self, delta: Floats, psi: Floats) -> Subject:
        """The fitted subject, moved by delta (14,), with the effect."""
        theta = self._nuisance.subject.parameters.vector()
        theta[FREE] = np.clip(theta[FREE] * np.exp(delta), LOWER[FREE], UPPER[FREE])
        found = dataclasses.replace(self._nuisance.subject, parameters=Parameters.from_vector(theta))
        if self._template is None:
            return found
        return dataclasses.replace(found, effects=(*found.effects, self.applied(psi)))

    def _prior(self, prior_scale: float, psi: Floats) -> Floats:
        """The precision of all unknowns: theta and nuisance parameters (k,), then the effect's (p,)."""
        of_psi = np.full(psi.size, 1.0 / self._settings.psi_spread**2)
        return np.concatenate([self._nuisance.precision_at(prior_scale), of_psi])

    def _system(self, at: _Point, slopes: Sequence[Floats]) -> tuple[Floats, Floats]:
        """The normal equations of all unknowns, without the prior: theta and nuisance (k,), the effect's (p,)."""
        weight, train = self._nuisance.weight, self._nuisance.train
        columns = self._normal - np.diag(self._nuisance.precision)
        right = weight @ at.products.cross + columns[:, :N_THETA] @ at.delta  # theta's prior is centred at the fit
        if at.psi.size == 0:
            return columns, right
        known = zip(train.known, slopes, strict=True)
        cross = np.einsum("w,wip->ip", weight, np.concatenate([np.matmul(k.transpose(0, 2, 1), o) for k, o in known]))
        own = np.einsum("w,wpq->pq", weight, np.concatenate([np.matmul(o.transpose(0, 2, 1), o) for o in slopes]))
        pairs = zip(slopes, at.residuals, strict=True)
        match = weight @ np.concatenate([np.einsum("wrp,wr->wp", o, y) for o, y in pairs])
        return np.block([[columns, cross], [cross.T, own]]), np.concatenate(
            [right, match + cross[:N_THETA].T @ at.delta]
        )

    def by_psi(self, at: _Point) -> list[Floats]:
        """Derivatives (w, r, p) of the rows of each event for fitting by psi."""
        if at.psi.size == 0:
            return []
        slopes = zip(*(self._slopes(at, step) for step in PSI_STEP * np.eye(at.psi.size)), strict=True)
        all_rows = zip(self._nuisance.train.rows, slopes, strict=True)
        return [rows.of_decimated(np.stack(of_case, axis=2)) for rows, of_case in all_rows]

    def _slopes(self, at: _Point, step: Floats) -> list[Floats]:
        """Derivatives (m, 5) of the decimated answers along a step; backward if the forward simulation is unstable."""
        for signed in (step, -step):
            stepped = self._answers(at, at.psi + signed)
            if all(np.abs(one).max() < RUNAWAY_MPS2 for one in stepped):
                break
        each = zip(self._nuisance.train.rows, stepped, at.answers, strict=True)
        return [(rows.decimated(one) - rows.decimated(plain)) / signed.sum() for rows, one, plain in each]

    def _answers(self, at: _Point, psi: Floats) -> list[Floats]:
        """Answers (n, 5) in each event for fitting, for other parameters of the effect."""
        assert self._template is not None
        subject, cases = self._subject(at.delta, psi), self._nuisance.train.cases
        # An effect on a sensor does not change the motion.
        return sensed(subject, cases, at.accel) if self._template.effect.place == "sensor" else answers(subject, cases)
