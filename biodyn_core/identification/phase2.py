"""Phase 2: the full nonlinear chain, refined on the samples (Zaman et al., 6.2.2, Eq. 32-34)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import LOWER, MASS_SCALE, N_PARAMETERS, STIFFENING, UPPER, from_sigmoid, to_sigmoid
from biodyn_core.body.subject import Subject
from biodyn_core.identification.objectives import N_LINEAR, PENALTY, Pull, TimeDomain
from biodyn_core.identification.phase1 import Search
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings

Linearised = Callable[[Floats], tuple[Floats, Floats]]

FIRST_STIFFENING: Final = float(np.sqrt(LOWER[STIFFENING] * UPPER[STIFFENING]))
"""Start of s_nl, which phase 1 does not see: the middle of Table 1 in log space."""

INTERIOR: Final = 0.02
"""A start keeps this share of each range from both bounds: on a bound the sigmoid map has no slope to leave it by."""

SIMPLEX: Final = 0.5
"""Edge of the first simplex in the mapped coordinates, each towards the middle of its range."""

_TWINS: Final = 0.01
"""Starts that differ by less than this in every logarithm are refined once."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Where phase 2 ended: theta (15,), its objective, and costs (starts,) of every refined start, best first.

    reference (15,) is where the pull leads to; evaluations are simulations of a case.
    """

    theta: Floats
    reference: Floats
    objective: float
    costs: Floats
    evaluations: int
    penalties: Counter[str]


def refine(cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings) -> Refined:
    """Phase 2 from what phase 1 found: the best starts by Eq. 33, each refined, the best kept.

    Raises InputError where the chain diverges from every start.
    """
    starts, ranked = _starts(cases, subject, searches, settings)
    problem = TimeDomain(cases, subject, Pull(starts[0], settings.lambda_2, settings.regularization), settings.clocks)
    run = least_squares if settings.refine == "least-squares" else nelder_mead
    ends = [run(problem, interior(start), settings.free, settings.evaluations) for start in starts]
    best = min(range(len(ends)), key=lambda number: ends[number][1])
    # Once more from there, off the bounds: a simplex collapses, and a step can be caught in a corner.
    again = run(problem, interior(ends[best][0]), settings.free, settings.evaluations)
    if again[1] < ends[best][1]:
        ends[best] = again
    theta, objective = ends[best]
    if objective >= PENALTY:
        raise InputError(f"{cases[0].name}: the chain diverges from every start; look for outliers in the recording")
    costs = np.sort([cost for _, cost in ends])
    return Refined(theta, starts[0], objective, costs, problem.evaluations + ranked, problem.penalties)


def _starts(
    cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings
) -> tuple[Floats, int]:
    """Starts (k, 15) with s_nl and m_scale added (Eq. 32), best first and no twins; the simulations it took."""
    found = np.concatenate([search.theta for search in searches])
    theta = np.empty((len(found), N_PARAMETERS))
    theta[:, :N_LINEAR] = found
    theta[:, STIFFENING], theta[:, MASS_SCALE] = FIRST_STIFFENING, subject.parameters.mass_scale
    unpulled = TimeDomain(cases, subject, Pull(theta[0], 0.0))
    kept: list[Floats] = []
    for point in theta[np.argsort(unpulled.costs(theta), kind="stable")]:
        if all(np.abs(np.log(point / other)).max() > _TWINS for other in kept):
            kept.append(point)
    return np.array(kept[: settings.refined_starts]), unpulled.evaluations


def interior(theta: Floats) -> Floats:
    """Theta at least `INTERIOR` away from both bounds."""
    margin = INTERIOR * (UPPER - LOWER)
    return np.clip(theta, LOWER + margin, UPPER - margin)


def nelder_mead(problem: TimeDomain, start: Floats, free: Flags, evaluations: int) -> tuple[Floats, float]:
    """Theta (15,) and Eq. 33 by Nelder and Mead's simplex, its coefficients those of Gao and Han (2012).

    The first simplex is ours: SciPy's collapses at a bound before 1.13, and steps of 5 % suit no sigmoid.
    """
    theta, phi = mapped(start, free)
    corners = np.repeat(phi[None, :], phi.size + 1, axis=0)
    corners[np.arange(phi.size), np.arange(phi.size)] += np.where(phi > 0.0, -SIMPLEX, SIMPLEX)
    options = {"initial_simplex": corners, "maxfev": evaluations, "maxiter": evaluations}
    found = optimize.minimize(
        lambda point: problem.cost(theta(point)),
        phi,
        method="Nelder-Mead",
        options={**options, "adaptive": True, "xatol": 1e-4, "fatol": 1e-8},
    )
    return theta(found.x), float(found.fun)


def least_squares(problem: TimeDomain, start: Floats, free: Flags, evaluations: int) -> tuple[Floats, float]:
    """Theta (15,) and objective by SciPy's trust region, with all derivatives from one batch of simulations."""
    theta, phi = mapped(start, free)

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        at = theta(point)
        residuals, slopes = problem.linearised(at, free)
        return residuals, slopes * slope_by_phi(at)[free]

    end, objective = trust_region(linearised, phi, evaluations)
    return (start, PENALTY) if objective >= PENALTY else (theta(end), objective)


def trust_region(linearised: Linearised, start: Floats, evaluations: int) -> tuple[Floats, float]:
    """The point (p,) where a sum of squares is least and that sum, from a function to residuals and their derivatives.

    `PENALTY` where it is not finite at the start.
    """
    memory: dict[bytes, tuple[Floats, Floats]] = {}

    def remembered(point: Floats) -> tuple[Floats, Floats]:
        # The solver asks for one after the other.
        key = point.tobytes()
        if key not in memory:
            memory.clear()
            memory[key] = linearised(point)
        return memory[key]

    if not np.isfinite(remembered(start)[0]).all():
        return start, PENALTY
    found = optimize.least_squares(
        lambda point: remembered(point)[0],
        start,
        jac=lambda point: remembered(point)[1],
        xtol=1e-8,
        ftol=1e-8,  # 1e-10 changes no parameter by more than 1e-6, and takes a third longer
        gtol=1e-12,
        max_nfev=evaluations // (start.size + 1) + 1,
    )
    return found.x, float(2.0 * found.cost)


def slope_by_phi(theta: Floats) -> Floats:
    """D ln theta / d phi of the sigmoid map, (15,)."""
    return np.asarray((theta - LOWER) * (UPPER - theta) / ((UPPER - LOWER) * theta))


def mapped(start: Floats, free: Flags) -> tuple[Callable[[Floats], Floats], Floats]:
    """The map from phi of the free parameters (p,) to theta (15,), the others as at the start; and phi of the start."""

    def theta(phi: Floats) -> Floats:
        everything = np.zeros(N_PARAMETERS)
        everything[free] = phi
        # Rounding must not carry a value out of Table 1.
        return np.where(free, np.clip(from_sigmoid(everything), LOWER, UPPER), start)

    margin = 1e-6 * (UPPER - LOWER)
    return theta, to_sigmoid(np.clip(start, LOWER + margin, UPPER - margin))[free]
