"""References: the standard's curves as poles and zeros, and analog responses by partial fractions.

Independent of the code under test.
"""

from __future__ import annotations

import cmath
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

# The slow reference implementations of HIC and DRI are in the tests, which are no package.
sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))

import naive

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

FINE_S: Final = 2e-5
"""Step of the grid of an analog response; the error of its peak is 2e-5."""

head_injury, dynamic_response, lagrange = naive.head_injury, naive.dynamic_response, naive.lagrange

# ISO 8041-1: f1, f2 | f3, f4, Q4 | f5, Q5, f6, Q6 | gain; None for a missing part of a weighting.
_CONSTANTS: Final = {
    "Wk": (0.4, 100.0, 12.5, 12.5, 0.63, 2.37, 0.91, 3.35, 0.91, 1.0),
    "Wd": (0.4, 100.0, 2.0, 2.0, 0.63, None, None, None, None, 1.0),
    "Wf": (0.08, 0.63, None, 0.25, 0.86, 0.0625, 0.80, 0.1, 0.80, 1.0),
    "Wc": (0.4, 100.0, 8.0, 8.0, 0.63, None, None, None, None, 1.0),
    "We": (0.4, 100.0, 1.0, 1.0, 0.63, None, None, None, None, 1.0),
    "Wj": (0.4, 100.0, None, None, None, 3.75, 0.91, 5.32, 0.91, 1.0),
    "Wb": (0.4, 100.0, 16.0, 16.0, 0.55, 2.5, 0.9, 4.0, 0.95, 1.024),
}
WEIGHTINGS: Final = tuple(_CONSTANTS)


class System(NamedTuple):
    """A linear system gain x prod(s - zeros) / prod(s - poles) with distinct poles."""

    zeros: Complexes
    poles: Complexes
    gain: float

    def at(self, s: ArrayLike) -> Complexes:
        """Transfer function at complex s."""
        s = np.asarray(s, dtype=np.complex128)[..., None]
        return self.gain * np.prod(s - self.zeros, axis=-1) / np.prod(s - self.poles, axis=-1)

    def residues(self) -> Complexes:
        """Residues of the transfer function, one per pole."""
        apart = self.poles[:, None] - self.poles
        np.fill_diagonal(apart, 1.0)
        return self.gain * np.prod(self.poles[:, None] - self.zeros, axis=1) / np.prod(apart, axis=1)


@cache
def weighting(name: str) -> System:
    """A frequency weighting from the constants of ISO 8041-1."""
    f1, f2, f3, f4, q4, f5, q5, f6, q6, gain = _CONSTANTS[name]
    zeros, poles = [0j, 0j], [*_pair(f1, math.sqrt(0.5)), *_pair(f2, math.sqrt(0.5))]
    gain *= (2.0 * math.pi * f2) ** 2
    if f4 is not None:
        poles += _pair(f4, q4)
        gain *= (2.0 * math.pi * f4) ** 2
    if f3 is not None:
        zeros.append(complex(-2.0 * math.pi * f3))
        gain /= 2.0 * math.pi * f3
    if f5 is not None:
        zeros += _pair(f5, q5)
        poles += _pair(f6, q6)
    return System(np.array(zeros), np.array(poles), gain)


def _pair(frequency_hz: float, q: float) -> list[complex]:
    """Roots of s^2 + w s / Q + w^2."""
    w = 2.0 * math.pi * frequency_hz
    root = cmath.sqrt(1.0 - 4.0 * q * q)
    return [w / (2.0 * q) * (-1.0 + root), w / (2.0 * q) * (-1.0 - root)]


def spinal_oscillator() -> System:
    """Deflection z of the DRI's oscillator per seat acceleration: 52.9 rad/s, damping ratio 0.224 (Eq. 24)."""
    return System(np.array([]), np.array(_pair(52.9 / (2.0 * math.pi), 0.5 / 0.224)), -1.0)


def curve(name: str, frequency_hz: ArrayLike) -> Floats:
    """Gain of a weighting at frequencies (n,)."""
    return np.abs(weighting(name).at(2j * np.pi * np.asarray(frequency_hz)))


def weighted(name: str, accel: Floats, rate_hz: float) -> Floats:
    """A signal (n,) weighted in the frequency domain; zero padding prevents circular wrap-around."""
    size = 2 ** math.ceil(math.log2(3 * accel.size))
    frequency = np.fft.rfftfreq(size, 1.0 / rate_hz)
    return np.fft.irfft(np.fft.rfft(accel, size) * weighting(name).at(2j * np.pi * frequency), size)[: accel.size]


class Mode(NamedTuple):
    """A component of a motion: Re(amplitude exp(exponent (t - begin))) from `begin` on, m/s²."""

    begin_s: float
    exponent: complex
    amplitude: complex


def motion(modes: Sequence[Mode], time_s: Floats) -> Floats:
    """The motion at instants (n,)."""
    total = np.zeros(time_s.shape)
    for mode in modes:
        since = np.maximum(time_s - mode.begin_s, 0.0)
        total += np.where(time_s >= mode.begin_s, (mode.amplitude * np.exp(mode.exponent * since)).real, 0.0)
    return total


def answer(system: System, modes: Sequence[Mode], time_s: Floats) -> Floats:
    """The response of the analog system to the motion at times (n,), in closed form."""
    residues = system.residues()
    total = np.zeros(time_s.shape)
    for mode in modes:
        behind = time_s >= mode.begin_s
        since = time_s[behind] - mode.begin_s
        forced = system.at(mode.exponent) * np.exp(mode.exponent * since)
        free = sum(r / (p - mode.exponent) * np.exp(p * since) for r, p in zip(residues, system.poles, strict=True))
        total[behind] += _real_part_of(mode, forced + free)
    return total


def _real_part_of(mode: Mode, unit: Complexes) -> Floats:
    # The system is real: its response to the real part of an exponential is the real part of its response.
    return (mode.amplitude * unit).real


@dataclass(frozen=True)
class Figures:
    """Exposure of an analog weighted signal, over `seconds`."""

    aw_mps2: float
    vdv_mps175: float
    mtvv_mps2: float
    mtvv_linear_mps2: float
    mtvv_exponential_mps2: float
    peak_mps2: float


def figures(name: str, modes: Sequence[Mode], begin_s: float, end_s: float) -> Figures:
    """Exposure from `begin_s` to `end_s` of a motion weighted by the analog curve; MTVV averages over 1 s."""
    time = np.arange(begin_s, end_s, FINE_S)
    square = answer(weighting(name), modes, time) ** 2
    forget = math.exp(-FINE_S)
    exponential = math.sqrt(float(signal.lfilter([1.0 - forget], [1.0, -forget], square).max()))
    integral = np.concatenate([np.zeros(round(1.0 / FINE_S)), np.cumsum(square) * FINE_S])
    linear = math.sqrt(float((integral[-square.size :] - integral[: square.size]).max()))
    return Figures(
        aw_mps2=math.sqrt(float(square.mean())),
        vdv_mps175=float((square**2).sum() * FINE_S) ** 0.25,
        mtvv_mps2=max(linear, exponential),
        mtvv_linear_mps2=linear,
        mtvv_exponential_mps2=exponential,
        peak_mps2=math.sqrt(float(square.max())),
    )


# --- motions ---------------------------------------------------------------------------------------------------------


def step(height: float, begin_s: float) -> list[Mode]:
    """A step to a level."""
    return [Mode(begin_s, 0j, height)]


def tone(amplitude: float, frequency_hz: float, cycles: float, begin_s: float) -> list[Mode]:
    """A sine that starts at zero and ends after `cycles`; half a cycle is a half-sine shock."""
    w = 2.0 * math.pi * frequency_hz
    on, turn = -1j * amplitude, cmath.exp(2j * math.pi * cycles)
    return [Mode(begin_s, 1j * w, on), Mode(begin_s + cycles / frequency_hz, 1j * w, -on * turn)]


def decay(amplitude: float, frequency_hz: float, tau_s: float, begin_s: float) -> list[Mode]:
    """A decaying sine that starts at zero."""
    return [Mode(begin_s, complex(-1.0 / tau_s, 2.0 * math.pi * frequency_hz), -1j * amplitude)]
