"""Residual checks of a fit: whether residuals are noise or depend on the seat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.identification.fit import Fit
from biodyn_core.identification.problem import Case
from biodyn_core.recording.flags import stretches
from biodyn_core.signals.response import cross_spectra
from biodyn_core.signals.spectrum_settings import SpectrumSettings

DEFAULT_CUTOFF_HZ: Final = ConditioningSettings().cutoff_hz

LAGS_S: Final = 0.25
"""The longest lag of the test for whiteness."""


@dataclass(frozen=True, eq=False)
class ResidualCheck:
    """Checks of one case's residual by measured segment (5,), NaN for a segment that is excluded or too short.

    coherent: mean coherence with the seat, weighted by the residual's power; chance: 95th percentile of that of
    unrelated signals. coloured: share of autocorrelations beyond the 95 % band of white noise, 0.05 for white noise.
    """

    name: str
    case: str
    coherent: Floats
    chance: Floats
    coloured: Floats


def residual_checks(
    fit: Fit, cases: Sequence[Case], spectrum: SpectrumSettings | None = None, cutoff_hz: float = DEFAULT_CUTOFF_HZ
) -> list[ResidualCheck]:
    """Check the residuals of a fit in each of its cases; cutoff_hz is that of the low-pass of all signals."""
    problem, theta = fit.objective(cases), fit.subject.parameters.vector()
    return [_check(case, problem.residuals(number, theta), spectrum, cutoff_hz) for number, case in enumerate(cases)]


def _check(case: Case, residual: Floats, spectrum: SpectrumSettings | None, cutoff_hz: float) -> ResidualCheck:
    try:
        spectra = cross_spectra([(case.seat_mps2, residual)], case.rate_hz, spectrum)
        known = spectra.segments > 1
        power = np.where(known, spectra.output_psd, 1.0)
        weights = power / power.sum(axis=0)
        coherent = np.where(known, (np.where(known, spectra.coherence, 0.0) * weights).sum(axis=0), np.nan)
        chance = np.where(known, spectra.chance_of_mean(weights), np.nan)
    except InputError:  # shorter than a window
        coherent = chance = np.full(residual.shape[1], np.nan)
    coloured = np.array([_coloured(column, case.rate_hz, cutoff_hz) for column in residual.T])
    return ResidualCheck(case.name, case.case, coherent, chance, coloured)


def _coloured(residual: Floats, rate_hz: float, cutoff_hz: float) -> float:
    """The share of one segment's autocorrelations beyond the 95 % band of white noise; residual (n,).

    Samples are taken at twice the cut-off, because the filter alone correlates closer ones.
    """
    begin, end = max(stretches(~np.isnan(residual)), key=lambda s: s[1] - s[0], default=(0, 0))
    spacing = max(1, round(0.5 * rate_hz / cutoff_hz))
    values = residual[begin:end:spacing]
    lags = round(LAGS_S * rate_hz / spacing)
    if values.size < 4 * lags:
        return float("nan")
    values = values - values.mean()
    by_lag = np.array([values[lag:] @ values[: values.size - lag] for lag in range(1, lags + 1)]) / (values @ values)
    return float(np.mean(np.abs(by_lag) > 1.96 / np.sqrt(values.size)))
