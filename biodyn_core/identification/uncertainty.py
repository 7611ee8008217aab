"""Uncertainty of a fit: intervals of every parameter, and identifiability.

Residuals are coloured, correlated with the input, and common to all sensors where the seat's sensor has an error. The
assumption of white noise would give intervals several times too short (sandwich: White 1982; lags: Newey and West
1987). A few shocks determine most of stiffening and the fit adapts to them, so each window is left out in turn
(moving-block jackknife: Kuensch 1989). Sensor errors that last a whole recording do not average out and are added.
A regularization, or a descent that ends early, holds theta off the minimum of the misfit: that distance is added too.
Model error is not included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import UncertaintySettings

Identifiability = Literal["identifiable", "weakly identifiable", "not identifiable", "from the prior"]

FROM_PRIOR: Final = 0.5
"""A parameter is from the prior if the recordings reduce the variance of the prior by less than this share."""

LEAK_DELAYS_S: Final = np.linspace(0.0, 0.1, 6)
"""Possible delays of horizontal motion behind the vertical: one axle after the other, a body after its seat."""

WINDOW_STEPS: Final = 10
"""Number of windows that begin within the length of one window."""

WEAK_PRIOR_SPREAD: Final = 100.0
"""Standard deviation of ln theta of a parameter of which the recordings say nothing: far beyond all of Table 1."""

LOG_RANGE: Final = np.log(UPPER / LOWER)
"""Log range of each parameter in Table 1, (15,)."""


@dataclass(frozen=True)
class Estimate:
    """One parameter with its 95 % interval, clipped to Table 1; half_width is of ln theta, infinite if unknown.

    A parameter on a bound has no interval; the intervals of the others assume that it stays there.
    """

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    half_width: float
    identifiability: Identifiability
    at_bound: bool


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Estimates of the fitted parameters, and covariance (p, p) of ln theta of those off the bounds, by `names`.

    least_known: the combination of ln theta, over the log range of Table 1, with the largest variance, as shares of at
    least 0.3 by name, and its half width in those units.
    """

    estimates: tuple[Estimate, ...]
    names: tuple[str, ...]
    covariance: Floats
    least_known: dict[str, float]
    least_known_half_width: float

    @property
    def correlation(self) -> Floats:
        """Correlation (p, p) of the estimates of ln theta, by `names`."""
        spread = np.sqrt(np.diag(self.covariance))
        return np.asarray(np.clip(self.covariance / np.outer(spread, spread), -1.0, 1.0))


def uncertainty(fit: Fit, cases: Sequence[Case], settings: UncertaintySettings | None = None) -> Uncertainty:
    """Intervals of a fit from its cases, by the sandwich H^-1 B H^-1 with H = J'J."""
    s = settings or UncertaintySettings()
    theta = fit.subject.parameters.vector()
    inside = off_bounds(fit)
    problem = fit.objective(cases)
    covariance, inverse = covariance_of(problem, theta, inside, s)
    residual, slopes = problem.linearised(theta, inside)
    to_minimum = inverse @ (slopes.T @ residual)  # one Gauss-Newton step, without the regularization
    covariance += np.outer(to_minimum, to_minimum)
    half, learned = np.full(theta.size, math.inf), np.ones(theta.size)
    half[inside] = NORMAL_95 * np.sqrt(np.diag(covariance))
    if fit.prior:
        learned[inside] = 1.0 - np.diag(covariance) / fit.prior.variances(theta)[inside]
    estimates = tuple(
        _estimate(int(i), theta[i], half[i], float(learned[i]), not inside[i], s)
        for i in np.flatnonzero(fit.settings.free)
    )
    names = tuple(PARAMETERS[i].name for i in np.flatnonzero(inside))
    scale = LOG_RANGE[inside]
    squares, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    worst = {name: float(share) for name, share in zip(names, vectors[:, -1], strict=True) if abs(share) >= 0.3}
    return Uncertainty(estimates, names, covariance, worst, NORMAL_95 * math.sqrt(squares[-1]))


def off_bounds(fit: Fit) -> Flags:
    """The fitted parameters that are not on a bound, (15,)."""
    on_bound = np.array([parameter.name in fit.at_bound for parameter in PARAMETERS])
    return np.asarray(fit.settings.free & ~on_bound)


def _estimate(
    index: int, value: float, half_width: float, learned: float, on_bound: bool, settings: UncertaintySettings
) -> Estimate:
    """learned: share of the prior's variance that the recordings remove."""
    parameter, share = PARAMETERS[index], half_width / LOG_RANGE[index]
    identifiability: Identifiability = "not identifiable"
    if learned < FROM_PRIOR:
        identifiability = "from the prior"
    elif share <= settings.identifiable:
        identifiability = "identifiable"
    elif share <= settings.weakly:
        identifiability = "weakly identifiable"
    spread = math.exp(min(half_width, 100.0))
    lower, upper = max(parameter.lower, value / spread), min(parameter.upper, value * spread)
    return Estimate(
        parameter.name, parameter.unit, float(value), lower, upper, float(half_width), identifiability, on_bound
    )


def covariance_of(
    problem: TimeDomain, theta: Floats, inside: Flags, settings: UncertaintySettings
) -> tuple[Floats, Floats]:
    """Covariance of ln theta of the parameters inside, (p, p), and (J'J)^-1 beside it; a prior is part of both."""
    count = int(inside.sum())
    information, lasting = np.zeros((count, count)), dict[object, Floats]()
    windows = []
    for number, case in enumerate(problem.cases):
        rows = problem.rows(number, theta, inside)
        slopes, residual = rows[:, :, :-1], rows[:, :, -1]
        flat = slopes.reshape(-1, count)
        information += flat.T @ flat
        windows.append(overlapping_windows(slopes, residual, round(settings.window_s * case.rate_hz)))
        answers = problem.accelerations(number, theta)
        for key, shape in _lasting_errors(case, answers, settings):
            # Same person and mounting: the error is the same in every case.
            seen = np.einsum("nsp,ns->p", slopes, shape[case.begin :] * np.sqrt(case.weight[case.begin :]))
            lasting[key] = lasting.get(key, np.zeros(count)) + seen
    term = problem.term_slopes(theta, inside)
    penalty, nothing = term.T @ term, np.zeros((count, count))
    weak, of_weak = weak_prior(information, sum((jackknifed(*seen, nothing) for seen in windows), nothing))
    inverse = inverse_of(information + penalty + weak)
    scatter = problem.term.variance * penalty + of_weak
    scatter += sum((jackknifed(*seen, inverse) for seen in windows), nothing)
    scatter += sum((np.outer(seen, seen) for seen in lasting.values()), nothing)
    return sandwich(inverse, scatter), inverse


def weak_prior(information: Floats, scatter: Floats) -> tuple[Floats, Floats]:
    """Information and scatter, (p, p), of a prior with the standard deviation `WEAK_PRIOR_SPREAD` of each ln theta.

    Both change nothing that the recordings say. A parameter of which they say nothing, such as a free mass scale, gets
    that deviation. Without the prior it has a variance of 1e11 or more, whose rounding falsifies the small variances.
    """
    seen = np.diag(information) > 0.0
    noise = float(np.median(np.diag(scatter)[seen] / np.diag(information)[seen])) if seen.any() else 0.0
    weak = noise / WEAK_PRIOR_SPREAD**2 * np.eye(len(information))
    return weak, noise * weak


def sandwich(inverse: Floats, scatter: Floats) -> Floats:
    """H^-1 B H^-1, (p, p), of H^-1 = inverse and B = scatter, computed in units of each parameter's deviation."""
    scale = np.sqrt(np.diag(inverse))
    unit = inverse / np.outer(scale, scale)
    return np.asarray(unit @ (scatter * np.outer(scale, scale)) @ unit * np.outer(scale, scale))


def inverse_of(information: Floats) -> Floats:
    """Inverse of J'J; a parameter without information gets a very large variance instead of an error."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-200))
    squares, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = np.maximum(squares, 1e-14)
    return np.asarray((vectors / kept) @ vectors.T / np.outer(scale, scale))


def overlapping_windows(slopes: Floats, residual: Floats, length: int) -> tuple[Floats, Floats]:
    """Scores (w, p) and J'J (w, p, p) of all windows of `length` samples that overlap a record.

    Slopes (n, 5, p), residual (n, 5). `WINDOW_STEPS` windows begin per length. Sums of products of the scores are those
    of samples, weighted by Bartlett's triangle, times WINDOW_STEPS.
    """
    step, p = max(1, length // WINDOW_STEPS), slopes.shape[2]
    count = -(-len(slopes) // step)
    padded = np.concatenate([slopes, np.zeros((count * step - len(slopes), *slopes.shape[1:]))])
    rests = np.concatenate([residual, np.zeros((len(padded) - len(residual), residual.shape[1]))])
    parts, seen = padded.reshape(count, -1, p), rests.reshape(count, -1, 1)
    turned = parts.transpose(0, 2, 1)
    sums = np.cumsum(np.concatenate([np.zeros((1, p, p + 1)), turned @ np.concatenate([parts, seen], axis=2)]), axis=0)
    ends = np.arange(1, count + WINDOW_STEPS)
    found = sums[np.minimum(ends, count)] - sums[np.maximum(ends - WINDOW_STEPS, 0)]
    return found[:, :, -1], found[:, :, :-1]


def jackknifed(scores: Floats, products: Floats, inverse: Floats) -> Floats:
    """Scatter (p, p) of scores (w, p), each for a fit without its window (Kuensch 1989).

    A fit adapts to the few shocks that determine stiffening, so residuals are smaller there than elsewhere.
    """
    # A window over the whole of a short record has zero score and zero remainder: 0 / 0 becomes 0.
    rest = (1.0 + 1e-6) * np.eye(len(inverse)) - products @ inverse
    unseen = np.linalg.solve(rest, scores[:, :, None])[:, :, 0]
    return np.asarray(unseen.T @ unseen / WINDOW_STEPS)


def _lasting_errors(case: Case, answers: Floats, settings: UncertaintySettings) -> Iterator[tuple[object, Floats]]:
    """Changes (n, 5) of the residual by lasting sensor errors of one standard deviation, each with its own key."""
    share = settings.cross_axis / math.sqrt(LEAK_DELAYS_S.size)
    for delay_s in LEAK_DELAYS_S:
        late = round(delay_s * case.rate_hz)
        # In the seat's sensor, and so in the whole response of the model; or in one of the others.
        yield ("seat", delay_s), share * _delayed(answers, late)
        horizontal = _delayed(case.seat_mps2[:, None], late)
        for s, name in enumerate(MEASURED_SEGMENTS):
            yield (name, delay_s), share * horizontal * (np.arange(len(MEASURED_SEGMENTS)) == s)
    yield "seat gain", settings.gain_error * answers
    for s, name in enumerate(MEASURED_SEGMENTS):
        yield f"{name} gain", settings.gain_error * answers * (np.arange(len(MEASURED_SEGMENTS)) == s)


def _delayed(values: Floats, samples: int) -> Floats:
    """Values (n, c) delayed by some samples, with zeros before."""
    return np.concatenate([np.zeros((samples, values.shape[1])), values[: len(values) - samples]])
