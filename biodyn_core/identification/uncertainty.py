"""How sure a fit is of every parameter: intervals, and what the data cannot tell.

What a fit leaves over is coloured, follows the input, and is common to all sensors where the seat's errs: taken for
white it gives intervals several times too short (sandwich: White 1982; lags: Newey and West 1987). A few shocks tell
most of stiffening and the fit bends to them, so each window is left out in turn (moving-block jackknife: Kuensch 1989).
Errors of sensors that last a whole recording do not average out at all, and are added. What is wrong with the model
itself is in neither.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import TimeDomain
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import UncertaintySettings

Call = Literal["identifiable", "weakly identifiable", "not identifiable"]

NORMAL_95: Final = 1.959964
"""Half width of a 95 % interval in standard errors."""

LEAK_DELAYS_S: Final = np.linspace(0.0, 0.1, 6)
"""How late sideways motion follows the vertical: an axle after the other, a body after its seat; which, is unknown."""

WINDOW_STEPS: Final = 10
"""Windows of residuals begin so many times in each length of theirs."""

LOG_RANGE: Final = np.log(UPPER / LOWER)
"""Of each parameter, by Table 1, (15,)."""


@dataclass(frozen=True)
class Estimate:
    """One parameter with its 95 % interval, cut at Table 1; half_width is of ln theta, infinite where nothing is known.

    A parameter on a bound has no interval of its own: the others' hold while it stays there.
    """

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    half_width: float
    call: Call
    at_bound: bool


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Estimates of the fitted parameters, the covariance (p, p) of ln theta of those off the bounds, by `names`.

    least_known: the combination of ln theta, over the log range of Table 1, that the data constrain least, by name
    with a share of at least 0.3, and its half width in those units.
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
    """Intervals of a fit from the cases it was made of, by the sandwich H^-1 B H^-1 with H = J'J."""
    s = settings or UncertaintySettings()
    theta = fit.subject.parameters.vector()
    inside = off_bounds(fit)
    covariance, _ = covariance_of(fit.unpulled(cases), theta, inside, s)
    half = np.full(theta.size, math.inf)
    half[inside] = NORMAL_95 * np.sqrt(np.diag(covariance))
    estimates = tuple(_estimate(int(i), theta[i], half[i], not inside[i], s) for i in np.flatnonzero(fit.settings.free))
    names = tuple(PARAMETERS[i].name for i in np.flatnonzero(inside))
    scale = LOG_RANGE[inside]
    squares, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    worst = {name: float(share) for name, share in zip(names, vectors[:, -1], strict=True) if abs(share) >= 0.3}
    return Uncertainty(estimates, names, covariance, worst, NORMAL_95 * math.sqrt(squares[-1]))


def off_bounds(fit: Fit) -> Flags:
    """The fitted parameters that are not on a bound, (15,)."""
    pinned = np.array([parameter.name in fit.at_bound for parameter in PARAMETERS])
    return np.asarray(fit.settings.free & ~pinned)


def _estimate(index: int, value: float, half_width: float, pinned: bool, settings: UncertaintySettings) -> Estimate:
    parameter, share = PARAMETERS[index], half_width / LOG_RANGE[index]
    call: Call = "not identifiable"
    if share <= settings.identifiable:
        call = "identifiable"
    elif share <= settings.weakly:
        call = "weakly identifiable"
    spread = math.exp(min(half_width, 100.0))
    lower, upper = max(parameter.lower, value / spread), min(parameter.upper, value * spread)
    return Estimate(parameter.name, parameter.unit, float(value), lower, upper, float(half_width), call, pinned)


def covariance_of(
    problem: TimeDomain, theta: Floats, inside: Flags, settings: UncertaintySettings
) -> tuple[Floats, Floats]:
    """Covariance of ln theta of the parameters inside, (p, p), and (J'J)^-1 beside it."""
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
            # One person, one sitting, the same mounting: the error is the same in every case.
            seen = np.einsum("nsp,ns->p", slopes, shape[case.begin :] * np.sqrt(case.weight[case.begin :]))
            lasting[key] = lasting.get(key, np.zeros(count)) + seen
    inverse = inverse_of(information)
    scatter = sum((jackknifed(*seen, inverse) for seen in windows), np.zeros((count, count)))
    scatter += sum((np.outer(seen, seen) for seen in lasting.values()), np.zeros((count, count)))
    return inverse @ scatter @ inverse, inverse


def inverse_of(information: Floats) -> Floats:
    """Inverse of J'J; what is not seen at all gets a variance that is enormous, not an error."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-200))
    squares, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = np.maximum(squares, 1e-14)
    return np.asarray((vectors / kept) @ vectors.T / np.outer(scale, scale))


def overlapping_windows(slopes: Floats, residual: Floats, length: int) -> tuple[Floats, Floats]:
    """Scores (w, p) and J'J (w, p, p) of all windows of so many samples that touch a record, `WINDOW_STEPS` in each.

    Slopes (n, 5, p), residual (n, 5). Products of the scores add up to those of samples, weighted by Bartlett's
    triangle, times WINDOW_STEPS.
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
    """Scatter (p, p) of scores (w, p), each as it would be had the fit not seen its window (Kuensch 1989).

    A fit bends to the few shocks that tell it of stiffening, and leaves less over there than elsewhere.
    """
    # A window that is the whole of a short record leaves nothing over: 0 / 0 is 0 here.
    rest = (1.0 + 1e-6) * np.eye(len(inverse)) - products @ inverse
    unseen = np.linalg.solve(rest, scores[:, :, None])[:, :, 0]
    return np.asarray(unseen.T @ unseen / WINDOW_STEPS)


def _lasting_errors(case: Case, answers: Floats, settings: UncertaintySettings) -> Iterator[tuple[object, Floats]]:
    """What lasting errors of one standard deviation would add to the residual, (n, 5), each under its own key."""
    share = settings.cross_axis / math.sqrt(LEAK_DELAYS_S.size)
    for delay_s in LEAK_DELAYS_S:
        late = round(delay_s * case.rate_hz)
        # Into the seat's sensor, and through it into everything the model answers; or into one of the others.
        yield ("seat", delay_s), share * _later(answers, late)
        sideways = _later(case.seat_mps2[:, None], late)
        for s, name in enumerate(MEASURED_SEGMENTS):
            yield (name, delay_s), share * sideways * (np.arange(len(MEASURED_SEGMENTS)) == s)
    yield "seat gain", settings.gain_error * answers
    for s, name in enumerate(MEASURED_SEGMENTS):
        yield f"{name} gain", settings.gain_error * answers * (np.arange(len(MEASURED_SEGMENTS)) == s)


def _later(values: Floats, samples: int) -> Floats:
    """Values (n, c) so many samples later, zeros before."""
    return np.concatenate([np.zeros((samples, values.shape[1])), values[: len(values) - samples]])
