"""Idealization: fusion of one subject's fits to several cases, with the scatter between cases.

Zaman et al., section 7, Eq. 35-41.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.body.parameters import PARAMETERS, Parameters, from_log, to_log
from biodyn_core.body.subject import Subject

CV_FLAG_PERCENT: Final = 30.0
"""A parameter with more scatter is poorly constrained by the cases (7.2)."""

_PERSON: Final = ("name", "body_mass_kg", "stature_m", "mass_matrix", "effects")
"""Attributes that the cases of one subject share; beside other effects a parameter has another meaning."""


@dataclass(frozen=True)
class FittedCase:
    """One loading condition: the subject with the parameters fitted to it, and the remaining error.

    error_percent is J of Eq. 35: normalised rms in percent, mean over the measured segments (best_err of Tables 2, 3).
    Raises InputError unless it is positive and finite.
    """

    case: str
    subject: Subject
    error_percent: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.error_percent) and self.error_percent > 0.0):
            raise InputError(
                f"{self.case}: the fitting error is {self.error_percent:g} %, expected a positive number;"
                " fit the case again or leave it out"
            )


@dataclass(frozen=True)
class Idealized:
    """The fusion of several cases; `weights` are by case, `cv_percent` and `flagged` by the name of the parameter.

    weighted_error_percent averages the errors of the cases' own fits; it is not the error of the idealized subject.
    cv_percent (Eq. 38) is NaN for a single case. It only measures agreement of the fits: a parameter that was fixed, or
    that is on the same bound in every case, has none and is not therefore well identified.
    """

    subject: Subject
    weights: Mapping[str, float]
    weighted_error_percent: float
    cv_percent: Mapping[str, float]
    flagged: tuple[str, ...]


def idealize(cases: Sequence[FittedCase]) -> Idealized:
    """Fuse the fits of one subject: the geometric mean of each parameter, weighted by 1/J^2 (Eq. 35-38).

    The result does not depend on the order of the cases, to the last bit. Raises InputError for no case, a case given
    twice, cases of different subjects, and a stiffening of zero in some cases only.
    """
    _check(cases)
    cases = sorted(cases, key=lambda fitted: fitted.case)
    names = [fitted.case for fitted in cases]
    errors = np.array([fitted.error_percent for fitted in cases])
    theta = np.array([fitted.subject.parameters.vector() for fitted in cases])
    weights = _weights(errors)
    weighted_error = float(weights @ errors)
    cv = dict(zip((p.name for p in PARAMETERS), _cv_percent(theta).tolist(), strict=True))
    # Origin and errors in the first case's file do not apply to the fused values.
    origin = {"case_error_percent": dict(zip(names, errors.tolist(), strict=True))}
    return Idealized(
        subject=dataclasses.replace(
            cases[0].subject,
            parameters=Parameters.from_vector(_geometric_mean(theta, weights)),
            provenance=origin | {"weighted_error_percent": weighted_error},
        ),
        weights=dict(zip(names, weights.tolist(), strict=True)),
        weighted_error_percent=weighted_error,
        cv_percent=cv,
        flagged=tuple(name for name, percent in cv.items() if percent > CV_FLAG_PERCENT),
    )


def _check(cases: Sequence[FittedCase]) -> None:
    if not cases:
        raise InputError("idealize: there is no fitted case, expected at least one")
    seen: set[str] = set()
    for fitted in cases:
        if fitted.case in seen:
            raise InputError(f"{fitted.case}: the case is given twice; give its representative repetition alone")
        seen.add(fitted.case)
        for key in _PERSON:
            one, other = (of.subject.to_dict()[key] for of in (cases[0], fitted))
            if one != other:
                raise InputError(
                    f"{cases[0].case} and {fitted.case} are of different subjects: {key} is {one!r} and {other!r};"
                    " idealize one subject at a time"
                )
    linear = [fitted.case for fitted in cases if fitted.subject.parameters.stiffening_scale == 0.0]
    if linear and len(linear) < len(cases):
        raise InputError(
            f"{', '.join(linear)}: stiffening_scale is 0, which has no geometric mean with the positive values of the"
            " other cases; fit all cases with the linear chain or all with the nonlinear one"
        )


def _weights(errors: Floats) -> Floats:
    """Eq. 35, (cases,); relative to the smallest error, because its square may underflow."""
    shares = (errors.min() / errors) ** 2
    return np.asarray(shares / shares.sum())


def _geometric_mean(theta: Floats, weights: Floats) -> Floats:
    """Eq. 36 for each parameter: (cases, 15) to (15,)."""
    mean = from_log(weights @ to_log(np.where(theta > 0.0, theta, 1.0)))
    # Rounding must not move a mean out of the range of its cases; a zero in all cases stays zero.
    return np.clip(mean, theta.min(axis=0), theta.max(axis=0))


def _cv_percent(theta: Floats) -> Floats:
    """Eq. 38 for each parameter: (cases, 15) to (15,)."""
    if theta.shape[0] < 2:
        return np.full(theta.shape[1], np.nan)
    mean = theta.mean(axis=0)
    return np.asarray(100.0 * theta.std(axis=0, ddof=1) / np.where(mean > 0.0, mean, 1.0))
