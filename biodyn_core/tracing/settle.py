"""Settling: theta, the usual departures and one effect fitted together, from where screening found it (tracing, C).

Gauss and Newton's steps with the derivatives by theta and by the departures kept from the fitted subject: what a small
effect moves, they still point the right way, and a step costs one simulation for each parameter of the effect.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.effects import AppliedEffect
from biodyn_core.parameters import LOWER, UPPER, Parameters
from biodyn_core.subject import Subject
from biodyn_core.tracing.answers import RUNAWAY_MPS2, answer
from biodyn_core.tracing.background import FREE, N_THETA, Background, Side
from biodyn_core.tracing.rows import Products

Floats = NDArray[np.float64]

STEPS: Final = 12
ENOUGH: Final = 2e-3
"""A step that takes off less than this share ends it."""

SHARES: Final = (1.0, 0.5, 0.2, 0.05)
"""Of a step, tried in turn until one takes something off."""

NUDGE: Final = 0.02
"""Step of an effect's parameter for its derivative, on the whole line that its range is mapped to."""

FAR: Final = 6.0
"""How far one step may take it there, as a spread."""

AT_BOUND: Final = 0.01
"""A parameter closer to an end than this share of its range is on it: the map gets there ever more slowly."""

INSIDE: Final = 0.02
"""A start keeps this share of each range from both ends."""


@dataclass(frozen=True, eq=False)
class Settled:
    """Where it ended: the subject, with the effect where there is one, and what is left.

    departures (k,): how much of each known column, theta's first; objective: on the fitted side, infinite where the
    chain runs away; stretched: the part of it by which usual departures and theta are away from the usual; left (w,):
    squares in each window of the events that choose; intervals: 95 % of each of the effect's parameters; at_bound names
    those that ended on one.
    """

    subject: Subject
    applied: AppliedEffect | None
    departures: Floats
    objective: float
    stretched: float
    left: Floats
    intervals: tuple[tuple[float, float], ...] = ()
    at_bound: tuple[str, ...] = ()


def settle(
    background: Background, start: AppliedEffect | None, steps: int = STEPS, with_intervals: bool = False
) -> Settled:  # fmt: skip
    """Fit theta, the departures and an effect from its start values; without an effect, theta and departures alone.

    Intervals, which take as long as a step, where they are asked for.
    """
    problem = _Problem(background, start)
    at = problem.at(np.zeros(N_THETA), problem.unbounded(start))
    for _ in range(steps):
        better = _descended(problem, at) if np.isfinite(at.objective) else None
        if better is None:
            break
        enough = at.objective - better.objective < ENOUGH * at.objective
        at = better
        if enough:
            break
    if not np.isfinite(at.objective):
        return Settled(at.subject, start, at.b, np.inf, 0.0, background.choose.products.square)
    left = predicted(background.choose, at.subject).left(at.b)
    if not left.max() < RUNAWAY_MPS2**2:  # it holds where it was fitted, and runs away elsewhere
        return Settled(at.subject, start, at.b, np.inf, 0.0, background.choose.products.square)
    applied = problem.applied(at.psi) if start else None
    intervals = problem.intervals(at) if with_intervals else ()
    stretched = problem.stretched(at)
    return Settled(
        at.subject, applied, at.b, at.objective, stretched, left, intervals, problem.at_bound(at.psi)
    )  # fmt: skip


def relief(without: Settled, settled: Settled) -> float:
    """By how much less the usual has to be stretched, in log of the objective.

    What a departure far beyond the usual would explain as well predicts no better once it is called by its name: a
    clock that is 3 ms late is told from the usual by its size alone.
    """
    whole = np.log(without.objective / settled.objective)
    alone = np.log((without.objective - without.stretched) / (settled.objective - settled.stretched))
    return float(whole - alone)


def predicted(side: Side, subject: Subject) -> Products:
    """The products of events that were not fitted to, for a subject."""
    return side.of(side.missed(subject))


def _descended(problem: _Problem, at: _Point) -> _Point | None:
    """A point from which less is left, the first along the step; None where there is none."""
    delta, psi = problem.step(at)
    if not (np.isfinite(delta).all() and np.isfinite(psi).all()):  # beside the point the chain runs away
        return None
    for share in SHARES:
        tried = problem.at(at.delta + share * (delta - at.delta), at.psi + share * (psi - at.psi))
        if tried.objective < at.objective:
            return tried
    return None


@dataclass(frozen=True, eq=False)
class _Point:
    """Theta's logarithm less the fit's (14,), the effect's parameters on the whole line (p,), and what follows."""

    delta: Floats
    psi: Floats
    subject: Subject
    answers: list[Floats]
    missed: list[Floats]
    products: Products
    b: Floats
    objective: float


class _Problem:
    """The objective of the fitted side: squares of what is left, and the prior."""

    def __init__(self, background: Background, template: AppliedEffect | None) -> None:
        self._background, self._template = background, template
        parameters = template.effect.parameters if template else ()
        self._names = [p.name for p in parameters]
        self._lower = np.array([p.lower for p in parameters])
        self._width = np.array([p.upper - p.lower for p in parameters])
        self._normal = background.normal()
        self._own = np.linalg.inv(self._normal[N_THETA:, N_THETA:])

    def at(self, delta: Floats, psi: Floats) -> _Point:
        """Simulate a point, with the departures that are best there; its objective is infinite where it runs away."""
        train, weight = self._background.train, self._background.weight
        subject = self._subject(delta, psi)
        answers = [answer(subject, case) for case in train.cases]
        missed = [rows.missed(one) for rows, one in zip(train.rows, answers, strict=True)]
        products = train.of(missed)
        if not products.square.max() < RUNAWAY_MPS2**2:  # NaN runs away too
            return _Point(delta, psi, subject, answers, missed, products, np.zeros(len(self._normal)), np.inf)
        asked = weight @ products.miss[:, N_THETA:]
        own = self._own @ asked
        moved = float(self._background.precision[:N_THETA] @ delta**2)
        objective = float(weight @ products.square) - float(asked @ own) + moved
        b = np.concatenate([np.zeros(N_THETA), own])
        return _Point(delta, psi, subject, answers, missed, products, b, objective)

    def step(self, at: _Point) -> tuple[Floats, Floats]:
        """Where Gauss and Newton would go from here: delta (14,) and psi (p,)."""
        matrix, asked = self._system(at)
        found = np.asarray(np.linalg.solve(matrix, asked))
        return found[:N_THETA], np.asarray(at.psi + found[len(self._normal) :])

    def stretched(self, at: _Point) -> float:
        """The prior's part of the objective."""
        precision = self._background.precision
        return float(precision @ at.b**2 + precision[:N_THETA] @ at.delta**2)

    def intervals(self, at: _Point) -> tuple[tuple[float, float], ...]:
        """95 % of each of the effect's parameters, all else fitted beside."""
        if at.psi.size == 0:
            return ()
        variance = np.diag(np.linalg.inv(self._system(at)[0]))[len(self._normal) :]
        away = 1.96 * np.sqrt(np.maximum(variance, 0.0))
        low, high = (self._lower + _logistic(at.psi + sign * away) * self._width for sign in (-1.0, 1.0))
        return tuple(zip(low.tolist(), high.tolist(), strict=True))

    def at_bound(self, psi: Floats) -> tuple[str, ...]:
        """The effect's parameters that lie on a bound of their range."""
        share = _logistic(psi)
        pinned = (share < AT_BOUND) | (share > 1.0 - AT_BOUND)
        return tuple(name for name, flag in zip(self._names, pinned, strict=True) if flag)

    def applied(self, psi: Floats) -> AppliedEffect:
        """The effect with its parameters."""
        assert self._template is not None
        values = np.clip(self._lower + _logistic(psi) * self._width, self._lower, self._lower + self._width)
        return dataclasses.replace(self._template, values=dict(zip(self._names, values.tolist(), strict=True)))

    def unbounded(self, start: AppliedEffect | None) -> Floats:
        """Its values, a little inside their ranges, on the whole line (p,)."""
        if start is None or not self._names:
            return np.empty(0)
        values = np.array([start.values[name] for name in self._names])
        share = np.clip((values - self._lower) / self._width, INSIDE, 1.0 - INSIDE)
        return np.asarray(np.log(share / (1.0 - share)))

    def _subject(self, delta: Floats, psi: Floats) -> Subject:
        """The fitted subject, moved by delta (14,), with the effect."""
        theta = self._background.subject.parameters.vector()
        theta[FREE] = np.clip(theta[FREE] * np.exp(delta), LOWER[FREE], UPPER[FREE])
        found = dataclasses.replace(self._background.subject, parameters=Parameters.from_vector(theta))
        if self._template is None:
            return found
        return dataclasses.replace(found, effects=(*found.effects, self.applied(psi)))

    def _system(self, at: _Point) -> tuple[Floats, Floats]:
        """The normal equations of all unknowns: theta and departures (k,), then the effect's (p,)."""
        weight, train = self._background.weight, self._background.train
        asked = weight @ at.products.miss
        # Theta's prior is about the fit, not about here.
        asked += (self._normal - np.diag(self._background.precision))[:, :N_THETA] @ at.delta
        if at.psi.size == 0:
            return self._normal, asked
        beside = self._by_psi(at)
        known = zip(train.known, beside, strict=True)
        cross = np.einsum("w,wip->ip", weight, np.concatenate([np.matmul(k.transpose(0, 2, 1), o) for k, o in known]))
        own = np.einsum("w,wpq->pq", weight, np.concatenate([np.matmul(o.transpose(0, 2, 1), o) for o in beside]))
        missed = zip(beside, at.missed, strict=True)
        match = weight @ np.concatenate([np.einsum("wrp,wr->wp", o, y) for o, y in missed])
        match = match + cross[:N_THETA].T @ at.delta
        matrix = np.block([[self._normal, cross], [cross.T, own + np.eye(at.psi.size) / FAR**2]])
        return matrix, np.concatenate([asked, match])

    def _by_psi(self, at: _Point) -> list[Floats]:
        """Derivatives (w, r, p) of each fitted event's rows by psi."""
        found, train = [], self._background.train
        for rows, case, plain in zip(train.rows, train.cases, at.answers, strict=True):
            stepped = [answer(self._subject(at.delta, at.psi + nudge), case) for nudge in NUDGE * np.eye(at.psi.size)]
            found.append(rows(np.stack([(one - plain) / NUDGE for one in stepped], axis=2)))
        return found


def _logistic(point: Floats) -> Floats:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * point)))
