"""Background: what theta and the usual departures can take on of a residual, and what they leave.

Ridge regression with the usual spreads as its prior (a generalised least squares whose covariance follows the input).
Theta is one more direction: it may move, but not by any amount.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.objectives import RegularizationTerm, TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer, answers
from biodyn_core.tracing.nuisance_parameters import Direction, bend_n, columns, directions
from biodyn_core.tracing.rows import Products, Rows
from biodyn_core.tracing.settings import BackgroundSettings

FREE: Final = np.array([p.group != "mass_scale" for p in PARAMETERS])
"""m_scale cancels from accelerations."""

N_THETA: Final = int(FREE.sum())


@dataclass(frozen=True, eq=False)
class Side:
    """Events that are fitted to, or that choose: their rows, the known columns (w, r, k) of each, and products."""

    cases: tuple[Case, ...]
    rows: tuple[Rows, ...]
    known: tuple[Floats, ...]
    products: Products

    def missed(self, subject: Subject) -> list[Floats]:
        """The miss (w, r) of a subject in each event."""
        return [rows.missed(one) for rows, one in zip(self.rows, answers(subject, self.cases), strict=True)]

    def of(self, missed: Sequence[Floats]) -> Products:
        """The products for another miss."""
        pairs = list(zip(self.known, missed, strict=True))
        return dataclasses.replace(
            self.products,
            miss=np.concatenate([np.einsum("wri,wr->wi", known, y, optimize=True) for known, y in pairs]),
            square=np.concatenate([np.einsum("wr,wr->w", y, y) for y in missed]),
        )


@dataclass(frozen=True, eq=False)
class Background:
    """The known columns, theta's first, with the precision (k,) of their prior; both sides of the events.

    weight (w,) of the fitted side's windows: one over their event's variance, times what counts as independent. level:
    how far this body and these sensors depart, in multiples of the usual spread; the prior of departures goes by it.
    """

    subject: Subject
    found: tuple[Direction, ...]
    usual: Floats
    train: Side
    choose: Side
    weight: Floats
    independent: float
    level: float = 1.0

    @classmethod
    def of(
        cls, subject: Subject, train: Sequence[Case], choose: Sequence[Case], settings: BackgroundSettings | None = None
    ) -> Background:
        """Linearise a fitted subject's answers to all events, around its theta."""
        s = settings or BackgroundSettings()
        found = tuple(directions(subject, train, s.usual))
        spread = np.concatenate([np.full(N_THETA, s.theta_spread), np.ones(len(found) + 2)])
        sides = [_side(subject, cases, found, s) for cases in (train, choose)]
        independent = s.weights.independent
        weight = np.full(sides[0].products.square.size, independent)
        return cls(subject, found, 1.0 / spread**2, sides[0], sides[1], weight, independent).reweighted()

    @property
    def precision(self) -> Floats:
        """The precision (k,) of the prior: theta's, then that of departures at this level."""
        return self.precision_at(self.level)

    def precision_at(self, level: float) -> Floats:
        """The precision (k,) of the prior at a level."""
        least = np.array([*(direction.least for direction in self.found), 0.0, 0.0])  # the seat's gain and clock
        return np.concatenate([self.usual[:N_THETA], self.usual[N_THETA:] / np.maximum(level, least) ** 2])

    @property
    def counted(self) -> float:
        """How many independent samples the fitted side counts as."""
        return self.independent * float(self.train.products.samples.sum())

    def at_level(self, level: float) -> Background:
        """The same for bodies and sensors that depart by so many times the usual."""
        return dataclasses.replace(self, level=level)

    def spreads(self, applied: AppliedEffect) -> float:
        """How many spreads of the usual departure an effect is, where it sits; inf where there is none like it.

        That is the departure by its own law; of another law of stretch alone, how it bends the joint where that goes
        farthest: a stop that is soft enough is no more than anybody's asymmetry.
        """
        here = [d for d in self.found if d.applied is not None and d.site == applied.site]
        own = [d for d in here if d.applied is not None and d.applied.effect is applied.effect]
        if own:
            sizes = [applied.values[name] / (d.usual * size) for d in own for name, size in d.strengths.items()]
            sizes += [applied.values[name] / spread for d in own for name, spread in d.besides.items()]
            return float(np.linalg.norm(sizes))
        if not applied.effect.static:
            return np.inf
        chain = Chain.of(dataclasses.replace(self.subject, effects=()))
        usual = [(d.usual * bend_n(chain, d.applied, d.reach_m), d.reach_m) for d in here if d.applied and d.reach_m]
        return max((bend_n(chain, applied, reach_m) / one for one, reach_m in usual if one > 0.0), default=np.inf)

    @property
    def names(self) -> tuple[str, ...]:
        """The usual departures, in the order of their columns."""
        return (*(direction.name for direction in self.found), "gain of seat", "clock of seat")

    def reweighted(self) -> Background:
        """Every event as loud as what is left of it, so that no shock rules and none that fails is believed."""
        weight = self.weight
        for _ in range(2):
            left = self.train.products.left(self.solved(self.train.products, weight))
            p = self.train.products
            variance = np.array(
                [left[p.event == e].sum() / max(p.samples[p.event == e].sum(), 1.0) for e in np.unique(p.event)]
            )
            weight = self.independent / np.maximum(variance, 1e-9)[p.event]
        return dataclasses.replace(self, weight=weight)

    def normal(self, weight: Floats | None = None) -> Floats:
        """The normal matrix (k, k) of the fitted side, prior included."""
        w = self.weight if weight is None else weight
        return np.asarray(np.einsum("w,wij->ij", w, self.train.products.columns) + np.diag(self.precision))

    def solved(self, products: Products, weight: Floats | None = None) -> Floats:
        """How much of each column (k,) the fitted side's products ask for."""
        w = self.weight if weight is None else weight
        return np.asarray(np.linalg.solve(self.normal(w), w @ products.miss))


def _side(subject: Subject, cases: Sequence[Case], found: Sequence[Direction], s: BackgroundSettings) -> Side:
    rows, known, missed = [], [], []
    for case in cases:
        plain = answer(subject, case)
        one = Rows(case, plain, s.weights, s.usual)
        rows.append(one)
        slope = np.gradient(plain, 1.0 / case.rate_hz, axis=0)
        seat = np.stack([s.usual.usual_gain * plain, -s.usual.usual_clock_s * slope], axis=2)
        theta = _by_theta(subject, case)
        known.append(one(np.concatenate([theta, columns(subject, case, plain, found), seat], axis=2)))
        missed.append(one.missed(plain))
    return Side(tuple(cases), tuple(rows), tuple(known), Products.of(known, missed, [one.samples for one in rows]))


def _by_theta(subject: Subject, case: Case) -> Floats:
    """Derivatives (n, 5, 14) of the answer by ln theta."""
    theta = subject.parameters.vector()
    return TimeDomain([case], subject, RegularizationTerm(theta, 0.0)).slopes(0, theta, FREE)
