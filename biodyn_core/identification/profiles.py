"""Profiles of the likelihood: how a fit's objective rises when one parameter is moved and all others follow.

Raue et al. 2009.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import PENALTY, TimeDomain
from biodyn_core.identification.phase2 import least_squares
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import UncertaintySettings
from biodyn_core.identification.uncertainty import (
    LOG_RANGE,
    NORMAL_95,
    covariance_of,
    off_bounds,
)

REFITS: Final = 12
"""At most so many to either side."""


class Profile(NamedTuple):
    """How the objective rises when one parameter is moved and all others follow, and where it passes the 95 % mark.

    values (k,) ascending; rise (k,) of the objective over its least; lower and upper are where it passes `threshold`,
    None where it does not within Table 1. Identifiable from these data if neither is None.
    """

    name: str
    values: Floats
    rise: Floats
    threshold: float
    lower: float | None
    upper: float | None


def profile(fit: Fit, cases: Sequence[Case], name: str, settings: UncertaintySettings | None = None) -> Profile:
    """Profile likelihood of one parameter, with at most `REFITS` to either side.

    The mark is chi-squared's, scaled by what the coloured residual makes of the variance (Chandler and Bate 2007).
    Raises InputError for a parameter that was not fitted or lies on a bound.
    """
    inside = off_bounds(fit)
    known = [p.name for p in PARAMETERS]
    if name not in known or not inside[known.index(name)]:
        raise InputError(f"{name}: not fitted, or on a bound; profiles are drawn of parameters inside Table 1")
    index, theta = known.index(name), fit.subject.parameters.vector()
    problem = fit.unpulled(cases)
    covariance, inverse = covariance_of(problem, theta, inside, settings or UncertaintySettings())
    place = int(inside[:index].sum())
    threshold = float(NORMAL_95**2 * covariance[place, place] / inverse[place, place])
    step = min(NORMAL_95 * math.sqrt(covariance[place, place]) / 3.0, LOG_RANGE[index] / REFITS)
    free = fit.settings.free.copy()
    free[index] = False
    least = float(np.sum(problem.linearised(theta, free)[0] ** 2))
    down, up = (_side(problem, theta, index, free, direction * step, least, threshold) for direction in (-1, 1))
    walked = [*down[::-1], (float(theta[index]), 0.0), *up]
    values, rise = (np.array(column) for column in zip(*walked, strict=True))
    at = len(down)
    return Profile(
        name, values, rise, threshold,
        _crossing(values[at::-1], rise[at::-1], threshold), _crossing(values[at:], rise[at:], threshold),
    )  # fmt: skip


def _side(
    problem: TimeDomain,
    theta: Floats,
    index: int,
    free: Flags,
    step: float,
    least: float,
    threshold: float,
) -> list[tuple[float, float]]:
    """Values and rises outwards from the fit until the mark is passed or Table 1 ends; steps grow by half each time."""
    walked: list[tuple[float, float]] = []
    at = theta
    while len(walked) < REFITS:
        value = float(np.clip(at[index] * math.exp(step), LOWER[index], UPPER[index]))
        moved = at.copy()
        moved[index] = value
        at, objective = least_squares(problem, moved, free, 600)
        walked.append((value, min(objective, PENALTY) - least))
        if walked[-1][1] > threshold or value in (LOWER[index], UPPER[index]):
            break
        step *= 1.5
    return walked


def _crossing(values: Floats, rise: Floats, threshold: float) -> float | None:
    """Where the rise passes the mark, walking outwards; its root is nearly straight in the logarithm."""
    above = np.flatnonzero(rise > threshold)
    if not above.size:
        return None
    i = int(above[0])
    before, after = math.sqrt(max(rise[i - 1], 0.0)), math.sqrt(rise[i])
    share = (math.sqrt(threshold) - before) / (after - before)
    return float(math.exp((1.0 - share) * math.log(values[i - 1]) + share * math.log(values[i])))
