"""Nuisance model: the part of a residual that theta and the nuisance parameters explain.

Ridge regression with the typical spreads as its prior, which equals generalised least squares with a covariance that
follows the input. Theta has a prior around its fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer, answers
from biodyn_core.tracing.nuisance_parameters import (
    NuisanceParameter,
    changes_by,
    nonlinear_force_n,
    nuisance_parameters,
)
from biodyn_core.tracing.rows import Products, Rows
from biodyn_core.tracing.settings import NuisanceSettings

FREE: Final = np.array([p.group != "mass_scale" for p in PARAMETERS])
"""The fitted ones of theta's 15 parameters: m_scale cancels from accelerations."""

N_THETA: Final = int(FREE.sum())
"""Their number, which is the number of theta's columns."""


@dataclass(frozen=True, eq=False)
class EventSet:
    """Events with one use (fitting or choosing): their rows, the known columns (w, r, k) of each, and products."""

    cases: tuple[Case, ...]
    rows: tuple[Rows, ...]
    known: tuple[Floats, ...]
    products: Products

    def residuals(self, subject: Subject) -> list[Floats]:
        """The residual rows (w, r) of a subject in each event."""
        return [rows.residual(one) for rows, one in zip(self.rows, answers(subject, self.cases), strict=True)]

    def products_of(self, residuals: Sequence[Floats]) -> Products:
        """The products for other residuals."""
        pairs = list(zip(self.known, residuals, strict=True))
        return dataclasses.replace(
            self.products,
            cross=np.concatenate([np.einsum("wri,wr->wi", known, y, optimize=True) for known, y in pairs]),
            square=np.concatenate([np.einsum("wr,wr->w", y, y) for y in residuals]),
        )


@dataclass(frozen=True, eq=False)
class NuisanceModel:
    """The known columns, theta's first, with their prior precision (k,) at scale 1, for both sets of events.

    weight (w,) of the windows for fitting: one over the variance of their event, times the independent share.
    prior_scale: spread of the nuisance parameters in multiples of the typical spread.
    """

    subject: Subject
    parameters: tuple[NuisanceParameter, ...]
    unit_precision: Floats
    train: EventSet
    choose: EventSet
    weight: Floats
    independent: float
    prior_scale: float = 1.0

    @classmethod
    def of(
        cls, subject: Subject, train: Sequence[Case], choose: Sequence[Case], settings: NuisanceSettings | None = None,
        parallel: ParallelMap = serial_map,
    ) -> NuisanceModel:  # fmt: skip
        """Linearise the answers of a fitted subject in all events around its theta."""
        s = settings or NuisanceSettings()
        parameters = tuple(nuisance_parameters(subject, train, s.typical))
        spread = np.concatenate([np.full(N_THETA, s.theta_spread), np.ones(len(parameters) + 2)])
        shared = (subject, parameters, s)
        events = list(parallel("linearising", _linearised, shared, [*train, *choose]))
        independent, parts = s.weights.independent, ((train, events[: len(train)]), (choose, events[len(train) :]))
        sets = [_event_set(*each, s.weights.least_samples) for each in parts]
        weight = np.full(sets[0].products.square.size, independent)
        found = cls(subject, parameters, 1.0 / spread**2, sets[0], sets[1], weight, independent)
        return found.reweighted(s.weights.reweightings)

    @property
    def precision(self) -> Floats:
        """The prior precision (k,) at this model's prior scale, theta's first."""
        return self.precision_at(self.prior_scale)

    def precision_at(self, prior_scale: float) -> Floats:
        """The prior precision (k,) at a prior scale."""
        least = np.array([*(one.least_scale for one in self.parameters), 0.0, 0.0])  # the seat's gain and clock
        own = self.unit_precision[N_THETA:] / np.maximum(prior_scale, least) ** 2
        return np.concatenate([self.unit_precision[:N_THETA], own])

    @property
    def independent_samples(self) -> float:
        """The number of independent samples for fitting."""
        return self.independent * float(self.train.products.samples.sum())

    def at_scale(self, prior_scale: float) -> NuisanceModel:
        """The same model with another prior scale."""
        return dataclasses.replace(self, prior_scale=prior_scale)

    def typical_multiple(self, applied: AppliedEffect) -> float:
        """The size of an effect in spreads of the typical deviation at its site; inf if there is none like it.

        An effect with nuisance parameters of its own law is compared with these. Another static law is compared by its
        force at the reach of the joint: a soft stop equals a typical asymmetry.
        """
        here = [one for one in self.parameters if one.applied is not None and one.site == applied.site]
        own = [one for one in here if one.applied is not None and one.applied.effect is applied.effect]
        if own:
            sizes = [applied.values[name] / (one.spread * size) for one in own for name, size in one.strengths.items()]
            sizes += [applied.values[name] / spread for one in own for name, spread in one.other_spreads.items()]
            return float(np.linalg.norm(sizes))
        if not applied.effect.static:
            return np.inf
        chain = Chain.of(dataclasses.replace(self.subject, effects=()))
        laws = [(one.applied, one.spread, one.reach_m) for one in here if one.applied is not None and one.reach_m]
        forces = [(spread * nonlinear_force_n(chain, law, reach_m), reach_m) for law, spread, reach_m in laws]
        return max(
            (nonlinear_force_n(chain, applied, reach_m) / one for one, reach_m in forces if one > 0.0), default=np.inf
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The nuisance parameters in the order of their columns."""
        return (*(one.name for one in self.parameters), "gain of seat", "clock of seat")

    def reweighted(self, times: int) -> NuisanceModel:
        """Every event weighted by one over the variance of its residual, so that no shock dominates.

        times: variances and coefficients are computed in turn so many times.
        """
        weight, p = self.weight, self.train.products
        for _ in range(times):
            square = p.residual_square(self.solution(p, weight))
            variance = np.array(
                [square[p.event == e].sum() / max(p.samples[p.event == e].sum(), 1.0) for e in np.unique(p.event)]
            )
            weight = self.independent / np.maximum(variance, 1e-9)[p.event]
        return dataclasses.replace(self, weight=weight)

    def normal(self, weight: Floats | None = None) -> Floats:
        """The normal matrix (k, k) of the events for fitting, prior included."""
        w = self.weight if weight is None else weight
        return np.asarray(np.einsum("w,wij->ij", w, self.train.products.columns) + np.diag(self.precision))

    def solution(self, products: Products, weight: Floats | None = None) -> Floats:
        """The coefficients (k,) of all columns for products of the events for fitting."""
        w = self.weight if weight is None else weight
        return np.asarray(np.linalg.solve(self.normal(w), w @ products.cross))


def _event_set(cases: Sequence[Case], events: Sequence[tuple[Rows, Floats, Floats]], least_samples: int) -> EventSet:
    rows, known, residuals = zip(*events, strict=True) if events else ((), (), ())
    products = Products.of(known, residuals, [one.samples for one in rows], least_samples)
    return EventSet(tuple(cases), rows, known, products)


def _linearised(
    shared: tuple[Subject, Sequence[NuisanceParameter], NuisanceSettings], case: Case
) -> tuple[Rows, Floats, Floats]:
    """Rows of an event, its known columns (w, r, k) and its residual (w, r)."""
    subject, parameters, s = shared
    plain = answer(subject, case)
    rows = Rows(case, plain, s.weights, s.typical)
    slope = np.gradient(plain, 1.0 / case.rate_hz, axis=0)
    theta = _by_theta(subject, case)
    seat = (s.typical.usual_gain * plain, -s.typical.usual_clock_s * slope)
    changes = [*changes_by(subject, case, plain, parameters, rows.decimated), *map(rows.decimated, seat)]
    known = rows.of_decimated(np.concatenate([rows.decimated(theta), np.stack(changes, axis=2)], axis=2))
    return rows, known, rows.residual(plain)


def _by_theta(subject: Subject, case: Case) -> Floats:
    """Derivatives (n, 5, 14) of the answer by ln theta."""
    theta = subject.parameters.vector()
    return TimeDomain([case], subject, RegularizationTerm(theta, 0.0)).slopes(0, theta, FREE)
