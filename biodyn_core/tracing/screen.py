"""Screening: what each candidate effect would take off the residual, once theta has taken what it can (tracing, B).

One simulation a candidate, at a strength at which it acts: a derivative at zero is useless for a stop or for lift-off.
What is measured against is the residual's own scatter over windows of a second, so coloured residuals fool nobody.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.effects import CATALOGUE, AppliedEffect, Effect
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import Pull, TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.parameters import PARAMETERS
from biodyn_core.settings import check_settings, setting

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

RUNAWAY_MPS2: Final = 1e5
"""No body is accelerated so: a joint that a candidate makes softer than nothing has run away."""

UNSEEN: Final = 1e-12
"""A candidate of which theta leaves no more than this share of its square is not seen at all."""


@dataclass(frozen=True)
class ScreenSettings:
    """How candidates are screened."""

    window_s: float = setting(1.0, "windows over which the residual's scatter is taken", "s", 0.1, 10.0)
    replicates: int = setting(2000, "draws of the largest gain where nothing is hidden", "", 100, 1_000_000)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class Candidate:
    """One effect at one site with start values, and by which of its parameters its size is changed, `` for presence."""

    applied: AppliedEffect
    strength: str

    @property
    def name(self) -> str:
        """The effect, its site, and the strength where there are several."""
        several = len(self.applied.effect.strengths) > 1
        return f"{self.applied.effect.name} at {self.applied.site}" + (f" ({self.strength})" if several else "")


@dataclass(frozen=True)
class Screened:
    """What one candidate would do to first order, theta refitted.

    gain: share of the residual's energy that goes; score: its square in standard errors, by windows; p_value: how often
    the best of all candidates gains as much by chance; size: of the strength, in shares of the start value; absorbed:
    share of the effect's own energy that theta takes on itself.
    """

    candidate: Candidate
    gain: float
    score: float
    p_value: float
    size: float
    absorbed: float


def candidates(cases: Sequence[Case]) -> tuple[list[Candidate], list[str]]:
    """Every effect at every site that these cases can show, and the names of those for which a channel is missing."""
    found, untestable = [], []
    for effect in CATALOGUE.values():
        for site in effect.where:
            needed = [name.replace("own.", f"{site}.") for name in effect.channels]
            if not all(name in case.channels for case in cases for name in needed):
                untestable.append(f"{effect.name} at {site}")
                continue
            found += [
                Candidate(AppliedEffect(effect, site, shape | _without(effect, strength)), strength)
                for strength in effect.strengths or ("",)
                for shape in _shapes(effect)
            ]
    return found, untestable


def _without(effect: Effect, strength: str) -> dict[str, float]:
    """The other strengths of an effect, at zero."""
    return {p.name: 0.0 for p in effect.parameters if p.kind == "strength" and p.name != strength}


def _shapes(effect: Effect) -> list[dict[str, float]]:
    """Values at which the effect shows, every combination of those that have a grid."""
    tried = [p.grid or (p.size,) for p in effect.parameters]
    return [dict(zip((p.name for p in effect.parameters), values, strict=True)) for values in itertools.product(*tried)]


def screen(
    fit: Fit, cases: Sequence[Case], tried: Sequence[Candidate], seed: int = 0, settings: ScreenSettings | None = None
) -> list[Screened]:
    """Screen candidates on the cases of a fit, the largest gain first.

    Chance: the signs of whole windows of the residual are drawn anew, so that what is drawn keeps its colour and
    follows the seat as the residual does (wild bootstrap by blocks). It knows no misfit that is alike in every window.
    """
    s = settings or ScreenSettings()
    problem = fit.unpulled(cases)
    free = fit.settings.free & ~np.array([p.name in fit.at_bound for p in PARAMETERS])
    count = int(free.sum())
    stacked = [
        problem.rows(number, fit.subject.parameters.vector(), free, _answers(fit, case, tried)).reshape(
            -1, case.measured_mps2.shape[1], count + len(tried) + 1
        )
        for number, case in enumerate(cases)
    ]
    flat = [rows.reshape(-1, rows.shape[-1]) for rows in stacked]
    products = sum((rows.T @ rows for rows in flat), np.zeros((count + len(tried) + 1,) * 2))
    absorb = np.linalg.lstsq(products[:count, :count], products[:count, count:], rcond=1e-12)[0]
    for rows in flat:
        rows[:, count:] -= rows[:, :count] @ absorb  # what theta can take on itself
    windows = np.concatenate(list(_windows(stacked, cases, count, s.window_s)))
    left = sum((rows[:, count:].T @ rows[:, count:] for rows in flat), np.zeros((len(tried) + 1,) * 2))
    own, energy = np.diag(products)[count:-1], np.diag(left)[:-1]
    seen = np.where(energy > UNSEEN * np.maximum(own, 1e-6), energy, 0.0)  # below is rounding
    largest = largest_by_chance(windows, seen, left[-1, -1], s.replicates, np.random.default_rng(seed))
    found = [
        _screened(candidate, float(own[i]), float(seen[i]), left[i, -1], left[-1, -1], windows[:, i], largest)
        for i, candidate in enumerate(tried)
    ]
    return sorted(found, key=lambda one: -one.gain)


def largest_by_chance(
    windows: Floats, energy: Floats, residual: float, replicates: int, rng: np.random.Generator
) -> Floats:
    """The largest gain of all candidates in each replicate, (r,) ascending.

    windows (w, k) are sums of candidate times residual, energy (k,) the candidates' own, 0 for one that is not seen,
    residual the sum of squares.
    """
    seen = energy > 0.0
    if not seen.any() or residual <= 0.0:
        return np.zeros(replicates)
    signs = rng.choice((-1.0, 1.0), size=(replicates, len(windows)))
    gains = (signs @ windows[:, seen]) ** 2 / (energy[seen] * residual)
    return np.sort(gains.max(axis=1))


def _answers(fit: Fit, case: Case, tried: Sequence[Candidate]) -> Floats:
    """Accelerations (n, 5, k) of the fitted subject with each candidate; without, where it runs away with one."""
    theta, pull = fit.subject.parameters.vector(), Pull(fit.refined.reference, 0.0)
    base = TimeDomain([case], fit.subject, pull).accelerations(0, theta)
    found = []
    for candidate in tried:
        subject = dataclasses.replace(fit.subject, effects=(*fit.subject.effects, candidate.applied))
        accel = TimeDomain([case], subject, pull).accelerations(0, theta)
        found.append(accel if np.abs(accel).max() < RUNAWAY_MPS2 else base)
    return np.stack(found, axis=2)


def _windows(stacked: Sequence[Floats], cases: Sequence[Case], count: int, window_s: float) -> Iterator[Floats]:
    """Sums over windows and segments of each candidate times the residual, (w, k), case by case."""
    for rows, case in zip(stacked, cases, strict=True):
        scores = np.einsum("nsk,ns->nk", rows[:, :, count:-1], rows[:, :, -1])
        length = round(window_s * case.rate_hz)
        whole = max(len(scores) // length, 1) * length
        yield scores[:whole].reshape(-1, min(length, len(scores)), scores.shape[1]).sum(axis=1)


def _screened(
    candidate: Candidate, own: float, energy: float, match: float, residual: float, windows: Floats, largest: Floats
) -> Screened:
    if energy == 0.0:
        return Screened(candidate, 0.0, 0.0, 1.0, 0.0, 1.0)
    scatter = float(windows @ windows)
    gain = float(match**2 / (energy * residual)) if residual > 0.0 else 0.0
    as_large = largest.size - int(np.searchsorted(largest, gain))
    return Screened(
        candidate,
        gain=gain,
        p_value=(1.0 + as_large) / (1.0 + largest.size),
        score=float(windows.sum() ** 2 / scatter) if scatter > 0.0 else 0.0,
        size=float(-match / energy),
        absorbed=float(1.0 - energy / own),
    )
