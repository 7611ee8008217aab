"""Phase 2: the full nonlinear chain, refined on the samples (Zaman et al., 6.2.2, Eq. 32-34)."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.parallel import ParallelMap, serial_map
from biodyn_core.base.segments import CENTRAL
from biodyn_core.body.parameters import (
    DAMPINGS,
    FREQUENCIES,
    LOWER,
    MASS_SCALE,
    N_PARAMETERS,
    STIFFENING,
    UPPER,
    from_sigmoid,
    to_sigmoid,
)
from biodyn_core.body.subject import Subject
from biodyn_core.identification.objectives import N_LINEAR, PENALTY, RegularizationTerm, TimeDomain
from biodyn_core.identification.phase1 import Search
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings

Linearised = Callable[[Floats], tuple[Floats, Floats]]

FIRST_STIFFENING: Final = float(np.sqrt(LOWER[STIFFENING] * UPPER[STIFFENING]))
"""Start of s_nl, which phase 1 does not fit: the middle of Table 1 in log space."""

INTERIOR: Final = 0.02
"""Least distance of a start from both bounds, as a share of the range: the sigmoid map has zero slope on a bound."""

EXCHANGE_DIVISOR: Final = 10
"""The descent from exchanged joints has so many times fewer evaluations: a deeper minimum shows early."""

SIMPLEX: Final = 0.5
"""Edge of the first simplex in mapped coordinates, each towards the middle of the range."""

_DUPLICATES: Final = 0.01
"""Starts closer than this in every logarithm are refined once."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Result of phase 2: theta (15,), its objective, and costs (starts,) of every refined start, best first.

    reference (15,) is that of the regularization; evaluations are simulations of a case.
    """

    theta: Floats
    reference: Floats
    objective: float
    costs: Floats
    evaluations: int
    penalties: Counter[str]


def refine(
    cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings,
    parallel: ParallelMap = serial_map,
) -> Refined:  # fmt: skip
    """Phase 2 from the results of phase 1: refine the best starts by Eq. 33 and return the best.

    Raises InputError where the chain diverges from every start.
    """
    starts, ranked = _starts(cases, subject, searches, settings)
    shared = (cases, subject, starts[0], settings)
    ends = list(parallel("refinement", _end, shared, list(starts)))
    best = min(range(len(ends)), key=lambda number: ends[number].objective)
    more = _further(shared, ends[best])
    evaluations = sum(end.evaluations for end in (*ends, *more))
    penalties = sum((end.penalties for end in (*ends, *more)), Counter[str]())
    ends[best] = min((ends[best], *more), key=lambda end: end.objective)
    end = ends[best]
    if end.objective >= PENALTY:
        raise InputError(f"{cases[0].name}: the chain diverges from every start; look for outliers in the recording")
    costs = np.sort([one.objective for one in ends])
    return Refined(end.theta, starts[0], end.objective, costs, evaluations + ranked, penalties)


@dataclass(frozen=True, eq=False)
class _End:
    """The end of one start: theta (15,) and its objective, and the evaluations on the way."""

    theta: Floats
    objective: float
    evaluations: int
    penalties: Counter[str]


def _further(shared: tuple[Sequence[Case], Subject, Floats, FitSettings], best: _End) -> list[_End]:
    """From the best end with two joints exchanged, and again from the better one of both; shared: see `_end`."""
    cases, subject, reference, s = shared
    found = []
    if s.refine == "least-squares":  # the paper's procedure has one start
        few = dataclasses.replace(s, evaluations=max(s.evaluations // EXCHANGE_DIVISOR, 1))
        found.append(_end((cases, subject, reference, few), exchanged(best.theta)))
    better = min((best, *found), key=lambda end: end.objective)
    # Repeat from there, off the bounds: a simplex can collapse, and a step can stop in a corner.
    return [*found, _end(shared, better.theta)]


def exchanged(theta: Floats) -> Floats:
    """Theta (15,) with the two joints of the segment without a sensor exchanged, within Table 1.

    They are in series, and only the segment's own mass tells one from the other, so each minimum may have a second one
    near this theta. All swarms can miss the deeper one.
    """
    below, above = CENTRAL, CENTRAL + 1
    order = np.arange(N_PARAMETERS)
    for group in (FREQUENCIES, DAMPINGS):
        order[[group.start + below, group.start + above]] = group.start + above, group.start + below
    return np.clip(theta[order], LOWER, UPPER)


def _end(shared: tuple[Sequence[Case], Subject, Floats, FitSettings], start: Floats) -> _End:
    """Refine one start; shared: cases, subject, reference of the regularization, settings."""
    cases, subject, reference, s = shared
    problem = TimeDomain(cases, subject, RegularizationTerm(reference, s.lambda_2, s.regularization), s.clocks)
    run = least_squares if s.refine == "least-squares" else nelder_mead
    theta, objective = run(problem, interior(start, s.free), s.free, s.evaluations)
    return _End(theta, objective, problem.evaluations, problem.penalties)


def _starts(
    cases: Sequence[Case], subject: Subject, searches: Sequence[Search], settings: FitSettings
) -> tuple[Floats, int]:
    """Starts (k, 15) with s_nl and m_scale added (Eq. 32), best first, without duplicates; number of simulations."""
    found = np.concatenate([search.theta for search in searches])
    theta = np.empty((len(found), N_PARAMETERS))
    theta[:, :N_LINEAR] = found
    theta[:, STIFFENING], theta[:, MASS_SCALE] = FIRST_STIFFENING, subject.parameters.mass_scale
    data_only = TimeDomain(cases, subject, RegularizationTerm(theta[0], 0.0))
    kept: list[Floats] = []
    for point in theta[np.argsort(data_only.costs(theta), kind="stable")]:
        if all(np.abs(np.log(point / other)).max() > _DUPLICATES for other in kept):
            kept.append(point)
    return np.array(kept[: settings.refined_starts]), data_only.evaluations


def interior(theta: Floats, free: Flags) -> Floats:
    """Theta with its free parameters at a distance of at least `INTERIOR` from both bounds."""
    margin = INTERIOR * (UPPER - LOWER)
    # A fixed parameter may lie on a bound: the fit returns it as it is here.
    return np.where(free, np.clip(theta, LOWER + margin, UPPER - margin), theta)


def nelder_mead(problem: TimeDomain, start: Floats, free: Flags, evaluations: int) -> tuple[Floats, float]:
    """Theta (15,) and Eq. 33 by the Nelder-Mead simplex with the coefficients of Gao and Han (2012).

    The first simplex is given: SciPy's own collapses at a bound before 1.13, and steps of 5 % do not fit a sigmoid.
    """
    theta, phi = mapped(start, free)
    corners = np.repeat(phi[None, :], phi.size + 1, axis=0)
    corners[np.arange(phi.size), np.arange(phi.size)] += np.where(phi > 0.0, -SIMPLEX, SIMPLEX)
    options = {"initial_simplex": corners, "maxfev": evaluations, "maxiter": evaluations}
    found = scipy.optimize.minimize(
        lambda point: problem.cost(theta(point)),
        phi,
        method="Nelder-Mead",
        options={**options, "adaptive": True, "xatol": 1e-4, "fatol": 1e-8},
    )
    return theta(found.x), float(found.fun)


def least_squares(problem: TimeDomain, start: Floats, free: Flags, evaluations: int) -> tuple[Floats, float]:
    """Theta (15,) and objective by SciPy's trust region, with derivatives from one batch of simulations."""
    theta, phi = mapped(start, free)

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        at = theta(point)
        residuals, slopes = problem.linearised(at, free)
        return residuals, slopes * slope_by_phi(at)[free]

    end, objective = trust_region(linearised, phi, evaluations)
    return (start, PENALTY) if objective >= PENALTY else (theta(end), objective)


def trust_region(
    linearised: Linearised, start: Floats, evaluations: int, least_decrease: float = 1e-8
) -> tuple[Floats, float]:
    """The minimum (p,) of a sum of squares, and that sum, from a function that returns residuals and derivatives.

    least_decrease: a step that decreases the sum by a smaller share is the last one. With 1e-10 no parameter of a fit
    changes by more than 1e-6, and it takes a third longer. The sum is `PENALTY` where residuals are not finite at the
    start.
    """
    memory: dict[bytes, tuple[Floats, Floats]] = {}

    def evaluated(point: Floats) -> tuple[Floats, Floats]:
        # The solver requests residuals and derivatives separately.
        key = point.tobytes()
        if key not in memory:
            memory.clear()
            with np.errstate(invalid="ignore"):  # infinite slopes times zero: the solver rejects such a point
                memory[key] = linearised(point)
        return memory[key]

    if not np.isfinite(evaluated(start)[0]).all():
        return start, PENALTY
    found = scipy.optimize.least_squares(
        lambda point: evaluated(point)[0],
        start,
        jac=lambda point: evaluated(point)[1],
        xtol=1e-8,
        ftol=least_decrease,
        gtol=1e-12,
        max_nfev=evaluations // (start.size + 1) + 1,
    )
    return found.x, float(2.0 * found.cost)


def slope_by_phi(theta: Floats) -> Floats:
    """D ln theta / d phi of the sigmoid map, (15,)."""
    return np.asarray((theta - LOWER) * (UPPER - theta) / ((UPPER - LOWER) * theta))


def mapped(start: Floats, free: Flags) -> tuple[Callable[[Floats], Floats], Floats]:
    """The map from phi of the free parameters (p,) to theta (15,), others as in start; and phi of the start."""

    def theta(phi: Floats) -> Floats:
        values = np.zeros(N_PARAMETERS)
        values[free] = phi
        # Rounding must not move a value out of Table 1.
        return np.where(free, np.clip(from_sigmoid(values), LOWER, UPPER), start)

    margin = 1e-6 * (UPPER - LOWER)
    return theta, to_sigmoid(np.clip(start, LOWER + margin, UPPER - margin))[free]
