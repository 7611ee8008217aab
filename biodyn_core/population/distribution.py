"""Distribution of the parameters of people: normal in the places of ln theta between the bounds of Table 1."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.parameter_spread import ParameterSpread
from biodyn_core.body.parameters import LOWER, N_PARAMETERS, PARAMETERS, STIFFENING, UPPER

SPREAD: Final = slice(0, STIFFENING)
"""The parameters that the population spreads: frequencies, damping ratios and Rayleigh damping.

No reference says anything of the others. Stiffening has its lower bound, because the references soften.
"""

NAMES: Final = tuple(parameter.name for parameter in PARAMETERS[SPREAD])

AT_BOUND: Final = 0.005
"""Places are linear so near to a bound, as a share of the range of the logarithm: so they are finite there."""


@dataclass(frozen=True, eq=False)
class Distribution:
    """Normal distribution of the places of ln theta, with mean (13,) and covariance (13, 13).

    The mean has the mean response of the group.
    """

    mean: Floats
    covariance: Floats

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Theta (count, 15) of people of the distribution."""
        return theta_of(rng.multivariate_normal(self.mean, self.covariance, count))

    def standardized(self, theta: Floats) -> Floats:
        """Deviations (..., 13) of theta (..., 15) from the mean, uncorrelated and of unit variance in the population.

        Their squares add up to the square of the `distance`.
        """
        deviation = places_of(theta) - self.mean
        return np.asarray(deviation @ self._whitening.T)

    def distance(self, theta: Floats) -> float:
        """The Mahalanobis distance of theta (15,) from the mean; that of people of the distribution is about 3.6."""
        return float(np.linalg.norm(self.standardized(theta)))

    @functools.cached_property
    def _whitening(self) -> Floats:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)))

    @property
    def spread(self) -> ParameterSpread:
        """The covariance of ln theta around the mean, to first order."""
        return ParameterSpread(NAMES, self.covariance_at(theta_of(self.mean)))

    def covariance_at(self, theta: Floats) -> Floats:
        """The covariance (13, 13) of ln theta at theta (15,), to first order of `places_of`."""
        _, inside = _shares(theta)
        slope = np.log(UPPER / LOWER)[SPREAD] * inside * (1.0 - inside)
        return np.asarray(self.covariance * np.outer(slope, slope))


def places_of(theta: Floats) -> Floats:
    """The places (..., 13) of theta (..., 15), the inverse of `theta_of`; linear within `AT_BOUND` of a bound."""
    share, inside = _shares(theta)
    return np.asarray(np.log(inside / (1.0 - inside)) + (share - inside) / (inside * (1.0 - inside)))


def _shares(theta: Floats) -> tuple[Floats, Floats]:
    """Shares (..., 13) of the log range of Table 1 below theta (..., 15), then kept `AT_BOUND` off both ends."""
    share = np.log(theta[..., SPREAD] / LOWER[SPREAD]) / np.log(UPPER / LOWER)[SPREAD]
    return share, np.clip(share, AT_BOUND, 1.0 - AT_BOUND)


def theta_of(places: Floats) -> Floats:
    """Theta (..., 15) of places (..., 13): ln theta lies between its bounds as logistic(place) does between 0 and 1."""
    theta = np.broadcast_to(LOWER, (*places.shape[:-1], N_PARAMETERS)).copy()
    theta[..., SPREAD] = LOWER[SPREAD] * (UPPER / LOWER)[SPREAD] ** (1.0 / (1.0 + np.exp(-places)))
    theta[..., STIFFENING + 1] = 1.0
    return theta
