"""Mean squares by octave band of short windows."""

from __future__ import annotations

import functools
import itertools
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.signals.weighting import WeightingName, analog_response

EDGES_HZ: Final = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Octaves between these; the first band begins at 0, the last one ends at half the sampling rate."""

N_BANDS: Final = len(EDGES_HZ) + 1
BAND_NAMES: Final = (
    f"below_{EDGES_HZ[0]:g}_hz",
    *(f"{low:g}_to_{high:g}_hz" for low, high in itertools.pairwise(EDGES_HZ)),
    f"above_{EDGES_HZ[-1]:g}_hz",
)

TAPER: Final = 0.25
"""Share of a window in its tapers (Tukey): without them slow motion leaks into the higher bands."""


@functools.lru_cache(maxsize=32)
def _taper(size: int) -> Floats:
    taper = np.asarray(scipy.signal.windows.tukey(size, TAPER))
    return taper / np.sqrt(np.mean(taper**2))


@functools.lru_cache(maxsize=64)
def _gains(size: int, rate_hz: float, weighting: WeightingName | None) -> tuple[Floats, Integers]:
    """Factors (f, 1) that turn squared magnitudes of a spectrum into mean squares, and where each band begins (6,)."""
    padded = scipy.fft.next_fast_len(size, real=True)
    frequency_hz = scipy.fft.rfftfreq(padded, 1.0 / rate_hz)
    squares = np.full(frequency_hz.size, 2.0 / (size * padded))
    squares[0] *= 0.5
    if padded % 2 == 0:
        squares[-1] *= 0.5
    if weighting is not None:
        gain = np.zeros(frequency_hz.size)
        gain[1:] = np.abs(analog_response(weighting, frequency_hz[1:]))
        squares *= gain**2
    return squares[:, None], np.searchsorted(frequency_hz, [0.0, *EDGES_HZ])


def octave_squares(values: Floats, rate_hz: float, weighting: WeightingName | None = None) -> Floats:
    """Mean squares (6, c) by band of a window (n, c); their sum is about its mean square, weighted if asked."""
    size = len(values)
    spectrum = scipy.fft.rfft(values * _taper(size)[:, None], scipy.fft.next_fast_len(size, real=True), axis=0)
    squares, begins = _gains(size, rate_hz, weighting)
    return np.add.reduceat(squares * (spectrum.real**2 + spectrum.imag**2), begins, axis=0)
