"""Refit: theta and one effect more fitted together to all cases, from where screening says it is (tracing, C)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.fit import AT_BOUND, Fit, at_bound, prediction_errors
from biodyn_core.identification.objectives import Pull, TimeDomain
from biodyn_core.identification.phase2 import interior, mapped, slope_by_phi, trust_region
from biodyn_core.identification.problem import Case, Errors
from biodyn_core.parameters import Parameters
from biodyn_core.subject import Subject
from biodyn_core.tracing.screen import Screened

Floats = NDArray[np.float64]

STEP: Final = 1e-4
"""Step of an effect's parameter for its derivative, as a share of its range."""

INSIDE: Final = 0.02
"""A start keeps this share of each range from both ends, as those of theta do."""


@dataclass(frozen=True, eq=False)
class Refit:
    """A subject with one effect more, the sum of squares it leaves, and what has ended on a bound.

    effect_at_bound names parameters of the effect, moved_onto_bound those of theta that were inside before.
    """

    subject: Subject
    objective: float
    errors: tuple[Errors, ...]
    effect_at_bound: tuple[str, ...]
    moved_onto_bound: tuple[str, ...]

    @property
    def applied(self) -> AppliedEffect:
        """The effect that was added."""
        return self.subject.effects[-1]


def refit(fit: Fit, cases: Sequence[Case], screened: Screened, evaluations: int = 3000) -> Refit:
    """Fit theta and a screened effect together, from the fit's theta and the size that screening says."""
    problem = _Problem(fit, cases, screened.candidate.applied)
    theta, phi = mapped(interior(fit.subject.parameters.vector()), fit.settings.free)
    psi = problem.unbounded(_sized(screened))

    def linearised(point: Floats) -> tuple[Floats, Floats]:
        at, share = theta(point[: phi.size]), _logistic(point[phi.size :])
        residuals, slopes = problem.linearised(at, share)
        slopes[:, : phi.size] *= slope_by_phi(at)[fit.settings.free]
        slopes[:, phi.size :] *= share * (1.0 - share)
        return residuals, slopes

    end, objective = trust_region(linearised, np.concatenate([phi, psi]), evaluations)
    at, share = theta(end[: phi.size]), _logistic(end[phi.size :])
    subject = problem.subject(share, at)
    pinned = (share < AT_BOUND) | (share > 1.0 - AT_BOUND)
    return Refit(
        subject=subject,
        objective=objective,
        errors=prediction_errors(subject, cases),
        effect_at_bound=tuple(name for name, flag in zip(problem.names, pinned, strict=True) if flag),
        moved_onto_bound=tuple(name for name in at_bound(at, fit.settings.free) if name not in fit.at_bound),
    )


class _Problem:
    """The objective of the cases, without any pull, with an effect whose parameters are shares of their ranges (m,)."""

    def __init__(self, fit: Fit, cases: Sequence[Case], applied: AppliedEffect) -> None:
        self._fit, self._cases, self._applied = fit, cases, applied
        parameters = applied.effect.parameters
        self.names = tuple(parameter.name for parameter in parameters)
        self._lower = np.array([parameter.lower for parameter in parameters])
        self._width = np.array([parameter.upper - parameter.lower for parameter in parameters])
        # Chosen once, so that no step of the solver meets an edge.
        self._substeps: tuple[int, ...] | None = None
        self._substeps = self._domain(self._shares(applied.values)).substeps

    def subject(self, share: Floats, theta: Floats | None = None) -> Subject:
        """The fit's subject with the effect, and with theta (15,) where it is given."""
        # Rounding must not carry a value out of its range.
        given = np.clip(self._lower + share * self._width, self._lower, self._lower + self._width)
        applied = dataclasses.replace(self._applied, values=dict(zip(self.names, given.tolist(), strict=True)))
        found = dataclasses.replace(self._fit.subject, effects=(*self._fit.subject.effects, applied))
        return found if theta is None else dataclasses.replace(found, parameters=Parameters.from_vector(theta))

    def linearised(self, theta: Floats, share: Floats) -> tuple[Floats, Floats]:
        """Residuals and their derivatives by ln theta and by the shares, as `TimeDomain.linearised`."""
        if not share.size:
            return self._domain(share).linearised(theta, self._fit.settings.free)
        steps = np.where(share < 0.5, STEP, -STEP)  # inwards
        stepped = [self._domain(share + step) for step in np.diag(steps)]
        others = [
            np.stack([domain.accelerations(number, theta) for domain in stepped], axis=2)
            for number in range(len(self._cases))
        ]
        residuals, slopes = self._domain(share).linearised(theta, self._fit.settings.free, others)
        slopes[:, -share.size :] /= steps
        return residuals, slopes

    def unbounded(self, values: Mapping[str, float]) -> Floats:
        """Values, a little inside their ranges, on the whole line."""
        share = np.clip(self._shares(values), INSIDE, 1.0 - INSIDE)
        return np.asarray(np.log(share / (1.0 - share)))

    def _shares(self, values: Mapping[str, float]) -> Floats:
        given = np.array([values[name] for name in self.names])
        return np.asarray((given - self._lower) / self._width)

    def _domain(self, share: Floats) -> TimeDomain:
        pull = Pull(self._fit.refined.reference, 0.0)
        return TimeDomain(self._cases, self.subject(share), pull, self._fit.settings.clocks, self._substeps)


def _sized(screened: Screened) -> dict[str, float]:
    """The candidate's values with its strength as large as screening has it, within its range."""
    values = dict(screened.candidate.applied.values)
    for parameter in screened.candidate.applied.effect.parameters:
        if parameter.name == screened.candidate.strength:
            value = values[parameter.name] * screened.size
            values[parameter.name] = min(max(value, parameter.lower), parameter.upper)
    return values


def _logistic(point: Floats) -> Floats:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * point)))
