"""Maximum a posteriori: a joint fit with published groups of people as prior, for few or weak recordings.

The data objective is -2 ln of the likelihood times the variance of an independent residual, so the prior is weighted
by that variance. A person may be unlike the group, whose spread is largely assumed: the prior is Student's t, a normal
distribution of unknown scale, whose maximum is found by reweighting (Lange, Little and Taylor 1989).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import STIFFENING
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.objectives import PriorTerm, TimeDomain
from biodyn_core.identification.phase2 import FIRST_STIFFENING, interior, least_squares
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from biodyn_core.population.distribution import SPREAD, Distribution, theta_of
from biodyn_core.population.population import SOFTENS, population

DEGREES: Final = 4.0
"""Degrees of freedom of Student's t, as Lange, Little and Taylor use where they are not estimated."""

ROUNDS: Final = 8
SETTLED: Final = 0.05
"""Relative change of the weight that ends the rounds."""

LONGEST_LAG_S: Final = 1.0
"""Of autocorrelations of the residual; chains decay in 0.3 s."""


def prior_of(subject: Subject, settings: FitSettings) -> Distribution | None:
    """The prior of a fit, None without one; raises InputError for a subject or a result that cannot have it."""
    if settings.prior == "none":
        return None
    if subject.mass_matrix != "segment":
        raise InputError(
            f"--prior {settings.prior}: its parameters are those of mass_matrix segment, {subject.name} has"
            f" {subject.mass_matrix}; change it in the subject's file, or fit without prior"
        )
    if settings.result != "joint":
        raise InputError(f"--prior {settings.prior}: only the joint result has a prior, not {settings.result}")
    found = population().distribution_for(subject.effects)
    if found is None:
        raise InputError(
            f"--prior {settings.prior}: its parameters are those with the {SOFTENS} of biodyn subject new, or none,"
            f" {subject.name} has another; remove the effect from the subject's file, or fit without prior"
        )
    return found


def maximum_a_posteriori(alone: Fit, cases: Sequence[Case], prior: Distribution) -> Fit:
    """The joint fit to the same cases with a prior, from the fit without one.

    The first descents begin at both the fit and the mean of the prior, because few data leave several minima.
    """
    data, free, theta = alone.objective(cases), alone.settings.free, alone.refined.theta
    starts = [theta, _mean(prior, theta)]
    term, known, evaluations = PriorTerm(prior, 0.0, 0.0), float(free.sum()), 0
    ends: list[tuple[Floats, float]] = []
    for _ in range(ROUNDS):
        previous, term = term, PriorTerm(prior, data_variance(data, theta, known), scale_of(prior, theta))
        if abs(term.weight - previous.weight) <= SETTLED * term.weight:
            break
        problem = TimeDomain(cases, alone.subject, term, alone.settings.clocks)
        ends = [least_squares(problem, interior(start, free), free, alone.settings.evaluations) for start in starts]
        theta = min(ends, key=lambda end: end[1])[0]
        known = parameters_known(problem, theta, free)
        starts, evaluations = [end for end, _ in ends], evaluations + problem.evaluations
    refined = dataclasses.replace(
        alone.refined,
        theta=theta,
        objective=min(objective for _, objective in ends),
        costs=np.sort([objective for _, objective in ends]),
        evaluations=alone.refined.evaluations + evaluations + data.evaluations,
    )
    return Fit.of(refined, cases, alone.subject, alone.settings, term)


def _mean(prior: Distribution, theta: Floats) -> Floats:
    """The mean of the prior (15,), with m_scale of theta and stiffening as all fits begin with."""
    mean = theta.copy()
    mean[SPREAD], mean[STIFFENING] = theta_of(prior.mean)[SPREAD], FIRST_STIFFENING
    return mean


def scale_of(prior: Distribution, theta: Floats) -> float:
    """Expectation of the precision of Student's t at theta (15,), relative to the normal distribution."""
    deviations = prior.standardized(theta)
    return float((DEGREES + deviations.size) / (DEGREES + deviations @ deviations))


def data_variance(data: TimeDomain, theta: Floats, known: float) -> float:
    """Variance of an independent residual at theta (15,), of which the data determine `known` parameters.

    The sum of squares over the number of independent samples (`independent_samples`) less the known parameters.
    """
    squares, samples = 0.0, 0.0
    for number, case in enumerate(data.cases):
        residuals, longest = data.residuals(number, theta), round(LONGEST_LAG_S * case.rate_hz)
        for column in np.flatnonzero(case.energy > 0.0):
            residual = residuals[case.compared[:, column], column]
            squares += float(residual @ residual) / float(case.energy[column])
            samples += independent_samples(residual, longest)
    return squares / max(samples - known, 1.0)


def independent_samples(values: Floats, longest: int) -> float:
    """Independent samples with the same variance of a mean square: n / sum rho_k^2 (Bayley and Hammersley 1946).

    values (n,); lags up to `longest` samples.
    """
    count = len(values)
    spectrum = np.fft.rfft(values, 2 * count)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: min(longest, count)]
    if not covariance[0] > 0.0:
        return float(count)
    correlation = covariance[1:] / covariance[0]
    return count / float(1.0 + 2.0 * correlation @ correlation)


def parameters_known(problem: TimeDomain, theta: Floats, free: Flags) -> float:
    """How many parameters the data determine beside the prior: the trace of H (H + P)^-1 (Rodgers 2000, 2.4)."""
    slopes = problem.linearised(theta, free)[1]
    term = problem.term_slopes(theta, free)
    whole, penalty = slopes.T @ slopes, term.T @ term
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-200))
    shares = np.linalg.lstsq(whole / np.outer(scale, scale), penalty / np.outer(scale, scale), rcond=1e-14)[0]
    return float(np.clip(len(whole) - np.trace(shares), 0.0, len(whole)))
