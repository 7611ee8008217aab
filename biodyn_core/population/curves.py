"""Curves of a subject as laboratories measure them: random vertical vibration of the seat at a given magnitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Complexes, Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import HEAD, SEGMENTS
from biodyn_core.body.model import Chain, Response, predict
from biodyn_core.body.subject import Subject
from biodyn_core.signals.response import cross_spectra
from biodyn_core.signals.spectrum_settings import SpectrumSettings

RATE_HZ: Final = 400.0
BAND_HZ: Final = (0.25, 25.0)
"""The vibration has a flat spectrum of acceleration in this band."""

SECONDS: Final = 100.0
WARM_UP_S: Final = 20.0
"""States that adapt slowly settle first."""

SPECTRA: Final = SpectrumSettings(segment_s=8.0, lowest_hz=0.5, highest_hz=20.0)

RESONANCE_HZ: Final = (1.0, 12.0)
"""The band in which the resonance is searched."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Apparent mass, normalised by its modulus at 0.5 Hz, and seat-to-head transmissibility, complex (f,)."""

    magnitude_mps2: float
    frequency_hz: Floats
    apparent_mass: Complexes
    head: Complexes

    @property
    def resonance_hz(self) -> float | None:
        """Frequency of the largest modulus of the apparent mass; None where that is no peak, but an end of the band."""
        modulus = np.abs(self.apparent_mass)
        return peak_of(self.frequency_hz, modulus)[0] if _is_peak(self.frequency_hz, modulus) else None

    @property
    def head_peak(self) -> tuple[float, float]:
        """Frequency and value of the largest modulus of the transmissibility."""
        return peak_of(self.frequency_hz, np.abs(self.head))


def vibration(seconds: float = SECONDS) -> Floats:
    """A random seat acceleration (n,) of 1 m/s^2 rms with a flat spectrum in `BAND_HZ`, always the same."""
    count = round(seconds * RATE_HZ)
    frequency_hz = np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    lines = np.exp(2j * np.pi * np.random.default_rng(0).random(frequency_hz.size))
    lines[(frequency_hz < BAND_HZ[0]) | (frequency_hz > BAND_HZ[1])] = 0.0
    motion = np.fft.irfft(lines, count)
    return np.asarray(motion / motion.std())


def curves(subject: Subject, magnitude_mps2: float, as_printed: bool = False) -> Curves:
    """The curves of a subject, with its effects, at a magnitude (rms of the seat's acceleration).

    Raises InputError for forces under `cascade`, unless `as_printed`, and for a subject that the vibration breaks.
    """
    seat_mps2 = magnitude_mps2 * vibration()
    names = {name for one in subject.effects for name in one.effect.required_channels(one.site)}
    response = predict(subject, seat_mps2, RATE_HZ, dict.fromkeys(names, np.zeros_like(seat_mps2)))
    force_n = _seat_force_n(Chain.of(subject), response, as_printed)
    answers = np.column_stack([force_n, response.accel_mps2[:, SEGMENTS.index(HEAD)]])
    if not np.isfinite(answers).all():
        raise InputError(f"{subject.name}: the model diverges at {magnitude_mps2:g} m/s^2")
    begin = round(WARM_UP_S * RATE_HZ)
    found = cross_spectra([(seat_mps2[begin:], answers[begin:])], RATE_HZ, SPECTRA)
    apparent_mass_kg, head = found.h1.T
    return Curves(magnitude_mps2, found.frequency_hz, apparent_mass_kg / np.abs(apparent_mass_kg[0]), head)


def _seat_force_n(chain: Chain, response: Response, as_printed: bool) -> Floats:
    """The force of the seat on the body over time, (n,), with the masses that effects add, without the foam's."""
    by_inertia_n = chain.seat_force(response, as_printed=as_printed)
    # The inertia of the segments omits the mass of viscera, and includes what a backrest carries. The joint does not.
    on_segments = any(element.effect.place == "segment" for element in chain.elements)
    return response.joint_force_n[:, 0] if on_segments else by_inertia_n


def _largest(frequency_hz: Floats, modulus: Floats) -> int:
    """The line of the largest modulus in `RESONANCE_HZ`."""
    inside = (frequency_hz >= RESONANCE_HZ[0]) & (frequency_hz <= RESONANCE_HZ[1])
    return int(np.argmax(np.where(inside, modulus, -np.inf)))


def _is_peak(frequency_hz: Floats, modulus: Floats) -> bool:
    """Whether the largest modulus in `RESONANCE_HZ` exceeds both its neighbours, also those outside the band."""
    at = _largest(frequency_hz, modulus)
    return bool(modulus[at] > max(modulus[at - 1], modulus[at + 1]))


def peak_of(frequency_hz: Floats, modulus: Floats) -> tuple[float, float]:
    """Frequency and value of the largest modulus in `RESONANCE_HZ`, by a parabola through three lines.

    At an end of the band it is that line, which need not be a peak.
    """
    at = _largest(frequency_hz, modulus)
    before, here, after = modulus[at - 1 : at + 2].tolist()
    bend = before - 2.0 * here + after
    away = 0.5 * (before - after) / bend if bend < 0.0 and max(before, after) <= here else 0.0
    step_hz = float(frequency_hz[1] - frequency_hz[0])
    return float(frequency_hz[at]) + away * step_hz, here - 0.25 * (before - after) * away
