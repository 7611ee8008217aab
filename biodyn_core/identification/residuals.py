"""What a fit leaves over: whether it is noise, or still follows the seat."""

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
"""Whiteness is judged to lags so long."""


@dataclass(frozen=True, eq=False)
class Leftover:
    """Residual of one case by measured segment (5,), NaN for a segment left out or too short to tell.

    coherent: share of its power in the band that goes linearly with the seat, weighted by power; chance: what unrelated
    signals reach one time in twenty. coloured: share of its autocorrelations beyond the 95 % band of white noise, 0.05
    where it is white.
    """

    name: str
    case: str
    coherent: Floats
    chance: Floats
    coloured: Floats


def leftovers(
    fit: Fit, cases: Sequence[Case], spectrum: SpectrumSettings | None = None, cutoff_hz: float = DEFAULT_CUTOFF_HZ
) -> list[Leftover]:
    """Judge what a fit leaves over in each of its cases; cutoff_hz is the low-pass's that they are behind."""
    problem, theta = fit.unpulled(cases), fit.subject.parameters.vector()
    return [_leftover(case, problem.residuals(number, theta), spectrum, cutoff_hz) for number, case in enumerate(cases)]


def _leftover(case: Case, residual: Floats, spectrum: SpectrumSettings | None, cutoff_hz: float) -> Leftover:
    try:
        spectra = cross_spectra([(case.seat_mps2, residual)], case.rate_hz, spectrum)
        told = spectra.segments > 1
        power = np.where(told, spectra.output_psd, 1.0)
        coherent = np.where(told, (np.where(told, spectra.coherence, 0.0) * power).sum(0) / power.sum(0), np.nan)
        chance = np.where(told, spectra.chance_coherence, np.nan)
    except InputError:  # shorter than a window
        coherent = chance = np.full(residual.shape[1], np.nan)
    coloured = np.array([_coloured(column, case.rate_hz, cutoff_hz) for column in residual.T])
    return Leftover(case.name, case.case, coherent, chance, coloured)


def _coloured(residual: Floats, rate_hz: float, cutoff_hz: float) -> float:
    """The share of one segment's autocorrelations that lie beyond white noise's 95 % band; residual (n,).

    At twice the cut-off: what lies closer together is coloured by the filter alone.
    """
    begin, end = max(stretches(~np.isnan(residual)), key=lambda s: s[1] - s[0], default=(0, 0))
    apart = max(1, round(0.5 * rate_hz / cutoff_hz))
    values = residual[begin:end:apart]
    lags = round(LAGS_S * rate_hz / apart)
    if values.size < 4 * lags:
        return float("nan")
    values = values - values.mean()
    by_lag = np.array([values[lag:] @ values[: values.size - lag] for lag in range(1, lags + 1)]) / (values @ values)
    return float(np.mean(np.abs(by_lag) > 1.96 / np.sqrt(values.size)))
