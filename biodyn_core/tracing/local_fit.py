"""Settling: theta, the usual departures and one effect fitted together, from where screening found it (tracing, C).

Gauss and Newton's steps with the derivatives by theta and by the departures kept from the fitted subject: what a small
effect moves, they still point the right way, and a step costs one simulation for each parameter of the effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, Ranges
from biodyn_core.tracing.answers import RUNAWAY_MPS2, answers, moved, sensed
from biodyn_core.tracing.nuisance_model import FREE, N_THETA, Background, Side
from biodyn_core.tracing.rows import Products

STEPS: Final = 12
ENOUGH: Final = 2e-3
"""A step that takes off less than this share of the objective ends settling."""

SHARES: Final = (1.0, 0.5, 0.2, 0.05)
"""Of a step, tried in turn until one takes something off."""

NUDGE: Final = 0.02
"""Step of an effect's parameter for its derivative, on the whole line that its range is mapped to."""

FAR: Final = 6.0
"""How far one step may take it there, as a spread."""

INSIDE: Final = 0.02
"""A start keeps this share of each range from both ends, but for a nuisance: an instant early in a day is no bound."""


LEVELS: Final = (1.0, 0.56, 0.32, 0.18, 0.1)
"""How far a body may depart from the model, in multiples of the usual: the likeliest of these."""


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Where it ended: the subject, with the effect where there is one, and what is left.

    departures (k,): how much of each known column, theta's first; objective: on the fitted side, infinite where the
    chain runs away; stretched: squares of the usual departures in theirs; level: the likeliest of `LEVELS`; away: what
    it costs at the level it was settled at, in twice the log evidence, that theta and departures are not at rest; left
    (w,): squares in each window of the events that choose; intervals: 95 % of each of the effect's parameters; at_bound
    names those that ended on one.
    """

    subject: Subject
    applied: AppliedEffect | None
    departures: Floats
    objective: float
    stretched: float
    level: float
    away: float
    left: Floats
    intervals: tuple[tuple[float, float], ...] = ()
    at_bound: tuple[str, ...] = ()


def settle(
    background: Background, start: AppliedEffect | None, steps: int = STEPS, with_intervals: bool = False,
    enough: float = ENOUGH,
) -> LocalFit:  # fmt: skip
    """Fit theta, the departures and an effect from its start values; without an effect, theta and departures alone.

    A step that takes off less than the share enough ends it. Intervals, which take as long as a step, where they are
    asked for.
    """
    problem = _Problem(background, start)
    at = problem.at(np.zeros(N_THETA), problem.unbounded(start))
    for _ in range(steps):
        better = _descended(problem, at) if np.isfinite(at.objective) else None
        if better is None:
            break
        little = at.objective - better.objective < enough * at.objective
        at = better
        if little:
            break
    ran_away = LocalFit(at.subject, start, at.b, np.inf, 0.0, 1.0, 0.0, background.choose.products.square)
    if not np.isfinite(at.objective):
        return ran_away
    left = predicted(background.choose, at.subject).left(at.b)
    level, away = problem.likeliest(at)
    # It may hold where it was fitted and run away elsewhere, or hold itself and run away with a little more or less.
    if not (left.max() < RUNAWAY_MPS2**2 and np.isfinite(away)):
        return ran_away
    applied = problem.applied(at.psi) if start else None
    intervals = problem.intervals(at) if with_intervals else ()
    return LocalFit(
        at.subject, applied, at.b, at.objective, problem.stretched(at), level, away, left, intervals,
        problem.at_bound(at.psi),
    )  # fmt: skip


def relief(background: Background, without: LocalFit, settled: LocalFit) -> float:
    """By how much likelier the departures become that are left, in twice the log evidence for each counted sample.

    What a departure far beyond the usual would explain as well predicts no better once it is called by its name: a
    clock that is 3 ms late is told from the usual by its size, and a neck that stiffens a little by a body that else
    is as the model has it. Both are to be settled at one level: from one to the next what departures cost falls while
    what they leave grows.
    """
    return (without.away - settled.away) / background.counted


def predicted(side: Side, subject: Subject) -> Products:
    """The products of events that were not fitted to, for a subject."""
    return side.of(side.missed(subject))


def _descended(problem: _Problem, at: _Point) -> _Point | None:
    """A point from which less is left, the first along the step; None where there is none."""
    beside = problem.by_psi(at)
    delta, psi = problem.step(at, beside)
    if not (np.isfinite(delta).all() and np.isfinite(psi).all()):  # beside the point the chain runs away
        return None
    for share in SHARES:
        tried = problem.at(at.delta + share * (delta - at.delta), at.psi + share * (psi - at.psi), beside)
        if tried.objective < at.objective:
            return tried
    return None


@dataclass(frozen=True, eq=False)
class _Point:
    """Theta's logarithm less the fit's (14,), the effect's parameters on the whole line (p,), and what follows.

    moved (n, 6) and answers (n, 5) of each event are the segments' and what sensors show; beside: the derivatives by
    psi that led here, by event, empty at the start.
    """

    delta: Floats
    psi: Floats
    subject: Subject
    moved: list[Floats]
    answers: list[Floats]
    missed: list[Floats]
    products: Products
    b: Floats
    objective: float
    beside: Sequence[Floats]


class _Problem:
    """The objective of the fitted side: squares of what is left, and the prior."""

    def __init__(self, background: Background, template: AppliedEffect | None) -> None:
        self._background, self._template = background, template
        parameters = template.effect.parameters if template else ()
        self._names = [p.name for p in parameters]
        self._ranges = Ranges(parameters)
        self._inside = np.array([1e-6 if p.kind == "nuisance" else INSIDE for p in parameters])
        self._normal = background.normal()
        self._own = np.linalg.inv(self._normal[N_THETA:, N_THETA:])

    def at(self, delta: Floats, psi: Floats, beside: Sequence[Floats] = ()) -> _Point:
        """Simulate a point, with the departures that are best there; its objective is infinite where it runs away."""
        train, weight = self._background.train, self._background.weight
        subject = self._subject(delta, psi)
        moving = moved(subject, train.cases)
        shown = sensed(subject, train.cases, moving)
        missed = [rows.missed(one) for rows, one in zip(train.rows, shown, strict=True)]
        products = train.of(missed)
        if not products.square.max() < RUNAWAY_MPS2**2:  # NaN runs away too
            b = np.zeros(len(self._normal))
            return _Point(delta, psi, subject, moving, shown, missed, products, b, np.inf, beside)
        asked = weight @ products.miss[:, N_THETA:]
        own = self._own @ asked
        prior = float(self._background.precision[:N_THETA] @ delta**2)
        objective = float(weight @ products.square) - float(asked @ own) + prior
        b = np.concatenate([np.zeros(N_THETA), own])
        return _Point(delta, psi, subject, moving, shown, missed, products, b, objective, beside)

    def step(self, at: _Point, beside: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Where Gauss and Newton would go from here: delta (14,) and psi (p,)."""
        data, asked = self._system(at, beside)
        found = np.asarray(np.linalg.solve(data + np.diag(self._prior(self._background.level, at.psi)), asked))
        return found[:N_THETA], np.asarray(at.psi + found[len(self._normal) :])

    def stretched(self, at: _Point) -> float:
        """Squares of the departures in their usual spread."""
        return float(self._background.usual[N_THETA:] @ at.b[N_THETA:] ** 2)

    def likeliest(self, at: _Point) -> tuple[float, float]:
        """The level with the most evidence at a point, all else refitted to first order, and the cost at this one."""
        data, asked = self._system(at, at.beside or self.by_psi(at))
        square = float(self._background.weight @ at.products.square)
        square += float(at.delta @ (2.0 * asked[:N_THETA] - data[:N_THETA, :N_THETA] @ at.delta))
        found = []
        for level in LEVELS:
            prior = self._prior(level, at.psi)
            x = np.linalg.solve(data + np.diag(prior), asked)
            own = slice(N_THETA, len(prior) - at.psi.size)
            volume = np.linalg.slogdet((data + np.diag(prior))[own, own])[1] - np.log(prior[own]).sum()
            away = float(prior[: own.stop] @ x[: own.stop] ** 2 + volume)
            found.append((square - 2.0 * float(asked @ x) + float(x @ data @ x) + away, level, away))
        return min(found)[1], next(cost for _, level, cost in found if level == self._background.level)

    def intervals(self, at: _Point) -> tuple[tuple[float, float], ...]:
        """95 % of each of the effect's parameters, all else fitted beside."""
        if at.psi.size == 0:
            return ()
        data, _ = self._system(at, self.by_psi(at))
        prior = np.diag(self._prior(self._background.level, at.psi))
        variance = np.diag(np.linalg.inv(data + prior))[len(self._normal) :]
        away = 1.96 * np.sqrt(np.maximum(variance, 0.0))
        low, high = (self._ranges.bounded(at.psi + sign * away) for sign in (-1.0, 1.0))
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
        values = self._ranges.bounded(psi).tolist()
        return dataclasses.replace(self._template, values=dict(zip(self._names, values, strict=True)))

    def unbounded(self, start: AppliedEffect | None) -> Floats:
        """Its values, a little inside their ranges, on the whole line (p,)."""
        if start is None or not self._names:
            return np.empty(0)
        return self._ranges.unbounded(np.array([start.values[name] for name in self._names]), self._inside)

    def _subject(self, delta: Floats, psi: Floats) -> Subject:
        """The fitted subject, moved by delta (14,), with the effect."""
        theta = self._background.subject.parameters.vector()
        theta[FREE] = np.clip(theta[FREE] * np.exp(delta), LOWER[FREE], UPPER[FREE])
        found = dataclasses.replace(self._background.subject, parameters=Parameters.from_vector(theta))
        if self._template is None:
            return found
        return dataclasses.replace(found, effects=(*found.effects, self.applied(psi)))

    def _prior(self, level: float, psi: Floats) -> Floats:
        """The precision of all unknowns: theta and departures (k,), then the effect's (p,)."""
        return np.concatenate([self._background.precision_at(level), np.full(psi.size, 1.0 / FAR**2)])

    def _system(self, at: _Point, beside: Sequence[Floats]) -> tuple[Floats, Floats]:
        """The normal equations of all unknowns, without the prior: theta and departures (k,), the effect's (p,)."""
        weight, train = self._background.weight, self._background.train
        columns = self._normal - np.diag(self._background.precision)
        asked = weight @ at.products.miss + columns[:, :N_THETA] @ at.delta  # theta's prior is about the fit, not here
        if at.psi.size == 0:
            return columns, asked
        known = zip(train.known, beside, strict=True)
        cross = np.einsum("w,wip->ip", weight, np.concatenate([np.matmul(k.transpose(0, 2, 1), o) for k, o in known]))
        own = np.einsum("w,wpq->pq", weight, np.concatenate([np.matmul(o.transpose(0, 2, 1), o) for o in beside]))
        missed = zip(beside, at.missed, strict=True)
        match = weight @ np.concatenate([np.einsum("wrp,wr->wp", o, y) for o, y in missed])
        return np.block([[columns, cross], [cross.T, own]]), np.concatenate(
            [asked, match + cross[:N_THETA].T @ at.delta]
        )

    def by_psi(self, at: _Point) -> list[Floats]:
        """Derivatives (w, r, p) of each fitted event's rows by psi."""
        if at.psi.size == 0:
            return []
        slopes = zip(*(self._slopes(at, nudge) for nudge in NUDGE * np.eye(at.psi.size)), strict=True)
        return [
            rows(np.stack(of_case, axis=2)) for rows, of_case in zip(self._background.train.rows, slopes, strict=True)
        ]

    def _slopes(self, at: _Point, nudge: Floats) -> list[Floats]:
        """Derivatives (n, 5) of what each fitted event shows along a nudge; from behind where it runs away ahead."""
        for step in (nudge, -nudge):
            stepped = self._answers(at, at.psi + step)
            if all(np.abs(one).max() < RUNAWAY_MPS2 for one in stepped):
                break
        return [(one - plain) / step.sum() for one, plain in zip(stepped, at.answers, strict=True)]

    def _answers(self, at: _Point, psi: Floats) -> list[Floats]:
        """What sensors show (n, 5) in each fitted event, for other parameters of the effect."""
        assert self._template is not None
        subject, cases = self._subject(at.delta, psi), self._background.train.cases
        # What is on a sensor moves nobody.
        return sensed(subject, cases, at.moved) if self._template.effect.place == "sensor" else answers(subject, cases)
