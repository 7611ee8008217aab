"""Restoring force: the missing force of a joint or segment over stretch and rate, before and after, with its law.

Masri and Caughey, A nonparametric identification technique for nonlinear dynamic problems, J. Appl. Mech. 46, 1979.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, Ranges
from biodyn_core.effects.ranges import FINITE
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.findings import ForceProfile, RestoringForce
from biodyn_core.tracing.inverse_dynamics import (
    Target,
    inertial_force,
    measured_motion,
    missing_force,
    simulated_motion,
)
from biodyn_core.tracing.settings import MissingForceSettings


@dataclass(frozen=True, eq=False)
class FittedEffect:
    """An effect of the subject after; covariance (p, p) of its parameters on the real line, (0, 0) if unknown."""

    applied: AppliedEffect
    covariance: Floats

    @property
    def can_be_drawn(self) -> bool:
        """Whether the covariance is known."""
        return bool(len(self.covariance) == len(self.applied.effect.parameters) and np.isfinite(self.covariance).all())


@dataclass(frozen=True, eq=False)
class _Points:
    """Samples (n,): duration s, stretch m, rate m/s, and forces N: carried; missing before, without and with the law.

    Events of different rates count by their time, so means weight samples by their duration.
    """

    duration_s: Floats
    stretch_m: Floats
    rate_mps: Floats
    carried_n: Floats
    before_n: Floats
    measured_n: Floats
    after_n: Floats


@dataclass(frozen=True, eq=False)
class _Bins:
    """Bins of equal width over the range of a coordinate; one with fewer than least_samples has no mean."""

    edges: Floats
    least_samples: int

    @classmethod
    def over(cls, values: Floats, count: int, least_samples: int) -> _Bins:
        """From the smallest to the largest value."""
        return cls(np.linspace(values.min(), values.max(), count + 1), least_samples)

    @property
    def centres(self) -> Floats:
        return np.asarray(0.5 * (self.edges[1:] + self.edges[:-1]))

    def numbers(self, values: Floats) -> Integers:
        """The bin of each value; -1 below and the number of bins above the range."""
        found = np.searchsorted(self.edges, values, side="right") - 1
        return np.where(values == self.edges[-1], len(self.edges) - 2, found)

    def means(self, at: Floats, values: Floats, duration_s: Floats) -> Floats:
        """Mean over time of values (n,) in each bin of their coordinate, NaN for few."""
        return _means(self.numbers(at), values, duration_s, len(self.edges) - 1, self.least_samples)


@dataclass(frozen=True, eq=False)
class _Law:
    """Samples (n,) of a law in simulation: duration s, stretch m, rate m/s, force N."""

    duration_s: Floats
    stretch_m: Floats
    rate_mps: Floats
    force_n: Floats


_Samples = TypeVar("_Samples", _Points, _Law)


def restoring_force(
    target: Target, before: Subject, after: Subject, found: Sequence[FittedEffect], cases: Sequence[Case], seed: int,
    settings: MissingForceSettings | None = None,
) -> RestoringForce | None:  # fmt: skip
    """The missing force at a target in events; None if they have too few usable samples.

    found: the effects at the target that the subject after has and the one before lacks; without any there is no law.
    """
    s = settings or MissingForceSettings()
    shown = _within(cases, s.longest_s)
    base = _with(after, {_key(one.applied): None for one in found})
    points = _joined([_points(target, before, base, after, case, s) for case in shown])
    if len(points.stretch_m) < s.least_samples:
        return None
    stretches = _Bins.over(points.stretch_m, s.stretch_bins, s.least_samples)
    rates = _Bins.over(points.rate_mps, s.rate_bins, s.least_samples)
    draws = [_law(target, base, subject, shown) for subject in _drawn(after, found, seed, s.draws)] if found else []
    cells = stretches.numbers(points.stretch_m) + s.stretch_bins * rates.numbers(points.rate_mps)
    shape, count = (s.rate_bins, s.stretch_bins), s.rate_bins * s.stretch_bins
    return RestoringForce(
        site=target.site,
        joint=target.joint,
        effects=tuple(one.applied for one in found),
        high_pass_hz=target.high_pass_hz,
        body_mass_kg=after.body_mass_kg,
        events=tuple(case.name for case in shown),
        carried_n=_rms(points.carried_n, points.duration_s),
        missing_before_n=_rms(points.before_n, points.duration_s),
        missing_after_n=_rms(points.after_n, points.duration_s),
        stretch_m=stretches.centres,
        rate_mps=rates.centres,
        samples=np.bincount(cells, minlength=count).reshape(shape),
        before_n=_means(cells, points.before_n, points.duration_s, count, s.least_samples).reshape(shape),
        after_n=_means(cells, points.after_n, points.duration_s, count, s.least_samples).reshape(shape),
        over_stretch=_profile(stretches, "stretch_m", points, draws),
        over_rate=_profile(rates, "rate_mps", points, draws),
    )


def _within(cases: Sequence[Case], longest_s: float) -> list[Case]:
    """The first events that are long enough together, each loading condition in turn."""
    turns = [sum(earlier.case == case.case for earlier in cases[:number]) for number, case in enumerate(cases)]
    ordered = [case for _, case in sorted(zip(turns, cases, strict=True), key=lambda one: one[0])]
    ends = np.cumsum([len(case.seat_mps2) / case.rate_hz for case in ordered])
    return ordered[: int(np.searchsorted(ends, longest_s)) + 1]


def _key(applied: AppliedEffect) -> tuple[str, str]:
    return applied.effect.name, applied.site


def _with(subject: Subject, changed: Mapping[tuple[str, str], AppliedEffect | None]) -> Subject:
    """The subject with effects replaced, or removed."""
    effects = [changed.get(_key(one), one) for one in subject.effects]
    return dataclasses.replace(subject, effects=tuple(one for one in effects if one is not None))


def _points(
    target: Target, before: Subject, base: Subject, after: Subject, case: Case, s: MissingForceSettings
) -> _Points:
    """The usable samples of one event, all of one motion: below the high-pass it is that of the subject after."""
    motion, used = measured_motion(after, case, target.high_pass_hz, s), target.used(case)
    forces = (missing_force(Chain.of(subject), motion, target) for subject in (before, base, after))
    carried = inertial_force(Chain.of(after), motion, target)
    return _Points(*(one[used] for one in (_durations(case), *target.coordinates(motion), carried, *forces)))


def _durations(case: Case) -> Floats:
    """The duration of each sample (n,), s."""
    return np.full(len(case.seat_mps2), 1.0 / case.rate_hz)


def _joined(parts: Sequence[_Samples]) -> _Samples:
    of = type(parts[0])
    names = [field.name for field in dataclasses.fields(of)]
    return of(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _drawn(after: Subject, found: Sequence[FittedEffect], seed: int, draws: int) -> Iterator[Subject]:
    """The subject after, then with the parameters of its effects drawn, if their covariance is known."""
    yield after
    rng = np.random.default_rng(seed)
    for _ in range(draws if all(one.can_be_drawn for one in found) else 0):
        yield _with(after, {_key(one.applied): _draw(one, rng) for one in found})


def _draw(one: FittedEffect, rng: np.random.Generator) -> AppliedEffect:
    parameters = one.applied.effect.parameters
    if not parameters:
        return one.applied
    ranges, names = Ranges(parameters), [p.name for p in parameters]
    centre = ranges.unbounded(np.array([one.applied.values[name] for name in names]), FINITE)
    # An inverse may be asymmetric in its last digits.
    drawn = rng.multivariate_normal(centre, one.covariance, method="eigh", check_valid="ignore")
    values = ranges.bounded(drawn).tolist()
    return dataclasses.replace(one.applied, values=dict(zip(names, values, strict=True)))


def _law(target: Target, base: Subject, subject: Subject, cases: Sequence[Case]) -> _Law:
    """The effects of a subject that its base lacks, in simulation."""
    parts, chain = [], Chain.of(base)
    for case in cases:
        with np.errstate(all="ignore"):
            motion, used = simulated_motion(subject, case), target.used(case)
            force = missing_force(chain, motion, target)
        finite = used & np.isfinite(force)
        parts.append(_Law(*(one[finite] for one in (_durations(case), *target.coordinates(motion), force))))
    return _joined(parts)


def _profile(bins: _Bins, coordinate: str, points: _Points, draws: Sequence[_Law]) -> ForceProfile:
    """Means over one coordinate, an attribute of points and laws; draws: of the subject after, then of the drawn."""

    def means(of: _Points | _Law, values: Floats) -> Floats:
        return bins.means(getattr(of, coordinate), values, of.duration_s)

    laws = np.array([means(law, law.force_n) for law in draws] or [np.full(len(bins.centres), np.nan)])
    drawn = laws[1:]
    visited = np.isfinite(drawn).sum(axis=0) > len(drawn) // 2
    lower, upper = np.full((2, len(visited)), np.nan)
    if visited.any():
        lower[visited], upper[visited] = np.nanquantile(drawn[:, visited], (0.025, 0.975), axis=0)
    number, measured = bins.numbers(getattr(points, coordinate)), means(points, points.measured_n)
    known = np.isfinite(measured[number])
    rest, whole = (
        _variance(force[known], points.duration_s[known])
        for force in (points.measured_n - measured[number], points.measured_n)
    )
    return ForceProfile(
        at=bins.centres,
        samples=np.bincount(number, minlength=len(bins.centres)),
        before_n=means(points, points.before_n),
        after_n=means(points, points.after_n),
        measured_n=measured,
        law_n=laws[0],
        lower_n=lower,
        upper_n=upper,
        explained=1.0 - rest / whole if whole > 0.0 else 0.0,
    )


def _means(cells: Integers, values: Floats, duration_s: Floats, count: int, least_samples: int) -> Floats:
    """Mean over time of values (n,) in each of `count` cells, NaN for few; cells outside are dropped."""
    inside = (cells >= 0) & (cells < count)
    cells, values, duration_s = cells[inside], values[inside], duration_s[inside]
    samples, times = np.bincount(cells, minlength=count), np.bincount(cells, duration_s, minlength=count)
    sums = np.bincount(cells, values * duration_s, minlength=count)
    return np.where(samples >= least_samples, sums / np.where(samples > 0, times, 1.0), np.nan)


def _rms(values: Floats, duration_s: Floats) -> float:
    return float(np.sqrt(np.average(values**2, weights=duration_s)))


def _variance(values: Floats, duration_s: Floats) -> float:
    """Over time; 0 without values."""
    if not values.size:
        return 0.0
    return float(np.average((values - np.average(values, weights=duration_s)) ** 2, weights=duration_s))
