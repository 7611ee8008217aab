"""Profile likelihood: the rise of a fit's objective when one parameter is fixed and the others are refitted.

Raue et al. 2009.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER
from biodyn_core.identification.fit import Fit, at_bound
from biodyn_core.identification.objectives import PENALTY, TimeDomain
from biodyn_core.identification.phase2 import least_squares
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import UncertaintySettings
from biodyn_core.identification.uncertainty import (
    LOG_RANGE,
    covariance_of,
    off_bounds,
)

REFITS: Final = 12
"""The most refits on each side."""

EVALUATIONS: Final = 600
"""The most simulations of a refit."""

SETTLED: Final = 0.05
"""A fit is at the minimum if a descent from it falls by at most this share of the threshold."""


class Profile(NamedTuple):
    """The rise of the objective when one parameter is fixed and the others are refitted, and its 95 % interval.

    values (k,) ascending; rise (k,) of the objective over its minimum; lower and upper are where it crosses
    `threshold`, None where it does not within Table 1. Identifiable from these data if neither is None.
    """

    name: str
    values: Floats
    rise: Floats
    threshold: float
    lower: float | None
    upper: float | None


def profile(fit: Fit, cases: Sequence[Case], name: str, settings: UncertaintySettings | None = None) -> Profile:
    """Profile likelihood of one parameter, with at most `REFITS` on each side.

    The threshold is that of chi-squared, scaled by the variance of the coloured residual (Chandler and Bate 2007). The
    minimum is that of the recordings, with the prior if there is one: a strong regularization, or a descent that was
    stopped, leaves the fit beside it. Raises InputError for a parameter that was not fitted or lies on a bound.
    """
    inside, s = off_bounds(fit), settings or UncertaintySettings()
    known = [p.name for p in PARAMETERS]
    if name not in known or not inside[known.index(name)]:
        raise InputError(f"{name}: not fitted, or on a bound; profiles are drawn of parameters inside Table 1")
    index, theta = known.index(name), fit.subject.parameters.vector()
    problem = fit.objective(cases)
    free = fit.settings.free.copy()
    free[index] = False
    least = float(np.sum(problem.linearised(theta, free)[0] ** 2))
    lowest, objective = least_squares(problem, theta, fit.settings.free, EVALUATIONS)
    on_bounds = at_bound(lowest, fit.settings.free)
    inside_there = inside & np.array([each == name or each not in on_bounds for each in known])
    # Beside the minimum the threshold is many times too large, so only that at the minimum can judge.
    spread, threshold = _spread_and_threshold(problem, lowest, inside_there, index, s)
    if least - objective > SETTLED * threshold:
        theta, least = lowest, objective
    else:
        spread, threshold = _spread_and_threshold(problem, theta, inside, index, s)
    step = min(NORMAL_95 * spread / 3.0, LOG_RANGE[index] / REFITS)
    down, up = (_side(problem, theta, index, free, direction * step, least, threshold) for direction in (-1, 1))
    points = [*down[::-1], (float(theta[index]), 0.0), *up]
    values, rise = (np.array(column) for column in zip(*points, strict=True))
    at = len(down)
    return Profile(
        name, values, rise, threshold,
        _crossing(values[at::-1], rise[at::-1], threshold), _crossing(values[at:], rise[at:], threshold),
    )  # fmt: skip


def _spread_and_threshold(
    problem: TimeDomain, theta: Floats, inside: Flags, index: int, settings: UncertaintySettings
) -> tuple[float, float]:
    """The standard deviation of the logarithm of one parameter, and the 95 % threshold of the rise."""
    covariance, inverse = covariance_of(problem, theta, inside, settings)
    row = int(inside[:index].sum())
    return math.sqrt(covariance[row, row]), float(NORMAL_95**2 * covariance[row, row] / inverse[row, row])


def _side(
    problem: TimeDomain,
    theta: Floats,
    index: int,
    free: Flags,
    step: float,
    least: float,
    threshold: float,
) -> list[tuple[float, float]]:
    """Values and rises outwards from the fit up to the threshold or the end of Table 1; each step grows by half."""
    points: list[tuple[float, float]] = []
    at = theta
    while len(points) < REFITS:
        value = float(np.clip(at[index] * math.exp(step), LOWER[index], UPPER[index]))
        moved = at.copy()
        moved[index] = value
        at, objective = least_squares(problem, moved, free, EVALUATIONS)
        points.append((value, min(objective, PENALTY) - least))
        if points[-1][1] > threshold or value in (LOWER[index], UPPER[index]):
            break
        step *= 1.5
    return points


def _crossing(values: Floats, rise: Floats, threshold: float) -> float | None:
    """Where the rise crosses the threshold, outwards; its root is nearly linear in the logarithm."""
    above = np.flatnonzero(rise > threshold)
    if not above.size:
        return None
    i = int(above[0])
    before, after = math.sqrt(max(rise[i - 1], 0.0)), math.sqrt(rise[i])
    share = (math.sqrt(threshold) - before) / (after - before)
    return float(math.exp((1.0 - share) * math.log(values[i - 1]) + share * math.log(values[i])))
