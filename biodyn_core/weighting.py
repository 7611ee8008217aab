"""Frequency weightings of ISO 2631-1 / ISO 8041: the analog curves, and second-order sections that follow them.

A plain bilinear transform of Wk is wrong by 2.65 % at 1129.3 Hz below 80 Hz, so one correction section is fitted to
what it leaves. Weight at the native rate, before any low-pass or down-sampling: the band limits are part of the curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, signal

from biodyn_core.errors import InputError

Floats = NDArray[np.float64]
WeightingName = Literal["Wk", "Wd"]

MIN_RATE_HZ: Final = 250.0
"""Below this no sampled filter follows Wk to 80 Hz: the error there is 4.7 % up to 300 Hz, 0.5 % from 500 Hz."""

RATE_TOLERANCE: Final = 0.001
"""A clock may run slow by this before a sensor of the lowest rate is refused."""

_FIT_BAND_HZ: Final = (0.4, 100.0)
_HIGHEST_SHARE: Final = 0.45


@dataclass(frozen=True)
class Curve:
    """One weighting's analog constants (ISO 8041-1): band limits f1, f2; transition f3, f4, Q4; step f5, Q5, f6, Q6."""

    f1_hz: float
    f2_hz: float
    f3_hz: float
    f4_hz: float
    q4: float
    step: tuple[float, float, float, float] | None = None


CURVES: Final[dict[WeightingName, Curve]] = {
    "Wk": Curve(0.4, 100.0, 12.5, 12.5, 0.63, (2.37, 0.91, 3.35, 0.91)),
    "Wd": Curve(0.4, 100.0, 2.0, 2.0, 0.63),
}


def analog_sections(name: WeightingName) -> list[tuple[list[float], list[float]]]:
    """The curve as quotients of polynomials in s, highest power first: high-pass, low-pass, transition, step."""
    c = CURVES[name]
    w1, w2, w3, w4 = (2.0 * math.pi * f for f in (c.f1_hz, c.f2_hz, c.f3_hz, c.f4_hz))
    root = math.sqrt(2.0)
    sections = [
        ([1.0, 0.0, 0.0], [1.0, root * w1, w1**2]),
        ([w2**2], [1.0, root * w2, w2**2]),
        ([w4**2 / w3, w4**2], [1.0, w4 / c.q4, w4**2]),
    ]
    if c.step is not None:
        f5, q5, f6, q6 = c.step
        w5, w6 = 2.0 * math.pi * f5, 2.0 * math.pi * f6
        sections.append(([1.0, w5 / q5, w5**2], [1.0, w6 / q6, w6**2]))
    return sections


def analog_response(name: WeightingName, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
    """Complex gain of the standard's curve at frequencies (n,), the reference every filter here is tested against."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    gain = np.ones_like(s)
    for numerator, denominator in analog_sections(name):
        gain = gain * np.polyval(numerator, s) / np.polyval(denominator, s)
    return gain


@lru_cache(maxsize=64)
def _design(name: WeightingName, rate_hz: float) -> tuple[tuple[float, ...], ...]:
    sos = np.array([_bilinear(num, den, rate_hz) for num, den in analog_sections(name)])
    top = min(_FIT_BAND_HZ[1], _HIGHEST_SHARE * rate_hz)
    frequency = np.geomspace(_FIT_BAND_HZ[0], top, 200)
    wanted = analog_response(name, frequency) / signal.sosfreqz(sos, frequency, fs=rate_hz)[1]
    return tuple(map(tuple, np.vstack([sos, _fit_section(wanted, 2.0 * np.pi * frequency / rate_hz)]).tolist()))


def _bilinear(numerator: list[float], denominator: list[float], rate_hz: float) -> Floats:
    b, a = signal.bilinear(numerator, denominator, rate_hz)
    section = np.zeros(6)
    section[: len(b)], section[3 : 3 + len(a)] = b, a
    return section


def _fit_section(wanted: NDArray[np.complex128], omega: Floats) -> Floats:
    """One biquad of unit gain at 0 Hz whose complex response follows `wanted` in relative terms; poles well inside."""
    z1 = np.exp(-1j * omega)

    def section(p: Floats) -> Floats:
        # Poles: radius below 0.95 whatever p is (tanh), as the coefficient triangle of a stable biquad.
        a2 = 0.9 * math.tanh(p[0])
        a1 = (1.0 + a2) * 0.95 * math.tanh(p[1])
        b = np.array([1.0 + p[2], p[3], 0.0])
        b[2] = 1.0 + a1 + a2 - b[0] - b[1]
        return np.array([*b, 1.0, a1, a2])

    def error(p: Floats) -> Floats:
        b0, b1, b2, _, a1, a2 = section(p)
        left = np.log((b0 + b1 * z1 + b2 * z1**2) / (1.0 + a1 * z1 + a2 * z1**2) / wanted)
        # The standard judges the magnitude; phase counts a little so that transients keep their shape.
        return np.concatenate([left.real, 0.1 * left.imag])

    fit = optimize.least_squares(error, np.array([0.01, 0.01, 0.0, 0.0]), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return section(fit.x)


def weighting_sections(name: WeightingName, rate_hz: float) -> Floats:
    """Second-order sections (s, 6) of a weighting at a sampling rate; raises InputError below 250 Hz.

    Designed for the rate rounded to 0.1 Hz, an error below 0.02 %, so that sensors of one kind share one design.
    """
    if name not in CURVES:
        raise InputError(f"weighting {name!r} is unknown, known are {', '.join(CURVES)}")
    if not rate_hz >= MIN_RATE_HZ * (1.0 - RATE_TOLERANCE):
        raise InputError(
            f"a rate of {rate_hz:g} Hz does not carry {name} to 80 Hz: at least {MIN_RATE_HZ:g} Hz is needed"
        )
    return np.array(_design(name, round(float(rate_hz), 1)))
