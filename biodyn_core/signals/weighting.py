"""Frequency weightings of ISO 2631-1 / ISO 8041: the analog curves, and second-order sections that follow them.

A plain bilinear transform of Wk errs by 2.65 % at 1129.3 Hz below 80 Hz. So only sections far below the rate are
transformed in this way; low-pass and transition get their exact poles and a numerator fitted to the whole curve.
Weight at the native rate, before any low-pass or down-sampling: the band limits are part of the curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from biodyn_core.base.arrays import Complexes, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.sampling_rate import MIN_RATE_HZ, RATE_TOLERANCE
from biodyn_core.base.suggestions import known_are

Quotient = tuple[tuple[float, float, float], tuple[float, float, float]]
WeightingName = Literal["Wk", "Wd", "Wf", "Wc", "We", "Wj", "Wb"]

_FIT_BAND_HZ: Final = (0.4, 90.0)
_BILINEAR_FROM: Final = 200.0
"""Rate per low-pass frequency from which the bilinear transform of all sections errs by less than 0.01 %."""

_LAG_SAMPLES: Final = 0.5
"""At the lowest rates a low-pass alone (Wj) lags more than sections can; half a sample of delay changes no dose."""


@dataclass(frozen=True)
class Curve:
    """One weighting's analog constants (ISO 8041-1): band limits f1, f2; transition f3, f4, Q4; step f5, Q5, f6, Q6.

    f3 is infinite for a transition without a zero, f4 without a transition; gain: above the step.
    """

    f1_hz: float
    f2_hz: float
    f3_hz: float
    f4_hz: float
    q4: float
    step: tuple[float, float, float, float] | None = None
    gain: float = 1.0


CURVES: Final[dict[WeightingName, Curve]] = {
    "Wk": Curve(0.4, 100.0, 12.5, 12.5, 0.63, (2.37, 0.91, 3.35, 0.91)),
    "Wd": Curve(0.4, 100.0, 2.0, 2.0, 0.63),
    "Wf": Curve(0.08, 0.63, math.inf, 0.25, 0.86, (0.0625, 0.8, 0.1, 0.8)),
    "Wc": Curve(0.4, 100.0, 8.0, 8.0, 0.63),
    "We": Curve(0.4, 100.0, 1.0, 1.0, 0.63),
    "Wj": Curve(0.4, 100.0, math.inf, math.inf, 1.0, (3.75, 0.91, 5.32, 0.91)),
    "Wb": Curve(0.4, 100.0, 16.0, 16.0, 0.55, (2.5, 0.9, 4.0, 0.95), 1.024),
}


def analog_sections(name: WeightingName) -> list[Quotient]:
    """The curve as quotients of polynomials in s, highest power first: high-pass, step, low-pass, transition."""
    c = CURVES[name]
    w1, w2, w3, w4 = (2.0 * math.pi * f for f in (c.f1_hz, c.f2_hz, c.f3_hz, c.f4_hz))
    root = math.sqrt(2.0)
    sections: list[Quotient] = [((c.gain, 0.0, 0.0), (1.0, root * w1, w1**2))]
    if c.step is not None:
        f5, q5, f6, q6 = c.step
        w5, w6 = 2.0 * math.pi * f5, 2.0 * math.pi * f6
        sections.append(((1.0, w5 / q5, w5**2), (1.0, w6 / q6, w6**2)))
    sections.append(((0.0, 0.0, w2**2), (1.0, root * w2, w2**2)))
    if math.isfinite(w4):
        sections.append(((0.0, w4**2 / w3, w4**2), (1.0, w4 / c.q4, w4**2)))
    return sections


def analog_response(name: WeightingName, frequency_hz: ArrayLike) -> Complexes:
    """Complex gain of the standard's curve at frequencies (n,), the reference of every filter here."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)
    gain = np.ones_like(s)
    for numerator, denominator in analog_sections(name):
        gain = gain * np.polyval(numerator, s) / np.polyval(denominator, s)
    return gain


@lru_cache(maxsize=64)
def _design(name: WeightingName, rate_hz: float) -> tuple[tuple[float, ...], ...]:
    sections = analog_sections(name)
    slow = 1 if CURVES[name].step is None else 2
    if rate_hz > _BILINEAR_FROM * CURVES[name].f2_hz:
        slow = len(sections)
    sos = np.array([_bilinear(*section, rate_hz) for section in sections[:slow]])
    if slow < len(sections):
        # The roots of a real quadratic are a pair; its first represents both.
        poles = np.concatenate([np.roots(denominator) for _, denominator in sections[slow:]])
        sos = np.vstack([sos, _matched(name, rate_hz, sos, poles)])
    return tuple(map(tuple, sos.tolist()))


def _bilinear(numerator: tuple[float, ...], denominator: tuple[float, ...], rate_hz: float) -> Floats:
    """Written out, because a high-pass must keep its two zeros exactly at 0 Hz."""
    k = 2.0 * rate_hz
    b, a = (
        np.array([p2 * k**2 + p1 * k + p0, 2.0 * (p0 - p2 * k**2), p2 * k**2 - p1 * k + p0])
        for p2, p1, p0 in (numerator, denominator)
    )
    return np.concatenate([b, a]) / a[0]


def _matched(name: WeightingName, rate_hz: float, before: Floats, poles: Complexes) -> Floats:
    """Sections (m, 6) with the analog poles (2 m,) that complete the sections `before` to the whole curve.

    The numerator is a polynomial in u = 1 - 1/z, exact at 0 Hz and least squares in the relative complex gain.
    """
    frequency = np.geomspace(*_FIT_BAND_HZ, 400)
    omega = 2.0 * np.pi * frequency / rate_hz
    lag = _LAG_SAMPLES if poles.size == 2 else 0.0
    u = 1.0 - np.exp(-1j * omega)
    share = _response(before, omega) * np.exp(1j * omega * lag) / analog_response(name, frequency)
    below = -np.expm1(poles / rate_hz)  # 1 - p, without cancellation
    for p in below:
        share = share * p / (p + (1.0 - p) * u)
    columns = share[:, None] * u[:, None] ** np.arange(1, poles.size + 1)
    matrix = np.vstack([columns.real, columns.imag])
    scale = np.linalg.norm(matrix, axis=0)
    fitted = np.linalg.lstsq(matrix / scale, np.concatenate([1.0 - share.real, -share.imag]), rcond=None)[0] / scale
    zeros = np.roots([1.0, *fitted])  # of 1 + c1 u + ... = (1 - v1 u) (1 - v2 u) ...
    zeros = zeros[np.argsort(np.abs(zeros.imag), kind="stable")]  # real ones in twos, then conjugate pairs
    pairs = zip(below[::2].tolist(), zeros[::2].tolist(), zeros[1::2].tolist(), strict=True)
    return np.array([_section(p, (v, w)) for p, v, w in pairs])


def _response(sections: Floats, omega: Floats) -> Complexes:
    z1 = np.exp(-1j * omega)[:, None] ** np.arange(3)
    gain: Complexes = np.prod([(z1 @ section[:3]) / (z1 @ section[3:]) for section in sections], axis=0)
    return gain


def _section(below: complex, zeros: tuple[complex, complex]) -> Floats:
    """A section of gain 1 at 0 Hz: poles 1 - `below` and its conjugate, numerator (1 - v1 u) (1 - v2 u)."""
    total, product = (zeros[0] + zeros[1]).real, (zeros[0] * zeros[1]).real
    b = abs(below) ** 2 * np.array([1.0 - total + product, total - 2.0 * product, product])
    return np.array([*b, 1.0, -2.0 * (1.0 - below.real), abs(1.0 - below) ** 2])


def weighting_sections(name: WeightingName, rate_hz: float) -> Floats:
    """Second-order sections (s, 6) of a weighting at a sampling rate, high-pass first; InputError below 250 Hz.

    Designed for the rate rounded to 0.1 Hz, an error below 0.02 %, so that sensors of one kind share one design.
    """
    if name not in CURVES:
        raise InputError(f"weighting {name!r} is unknown, {known_are(name, CURVES)}")
    if not rate_hz >= MIN_RATE_HZ * (1.0 - RATE_TOLERANCE):
        raise InputError(f"a rate of {rate_hz:g} Hz is too low for {name}: at least {MIN_RATE_HZ:g} Hz is needed")
    return np.array(_design(name, round(float(rate_hz), 1)))
