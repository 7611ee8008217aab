"""A subject beside published groups of people: what lies outside two standard deviations, and how it softens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.body.subject import Subject
from biodyn_core.population.curves import Curves, curves
from biodyn_core.population.references import Band, Softening, exponent, references

MAGNITUDE_MPS2: Final = 1.0
"""Of the vibration at which the curves are compared. That of the 60 people could not be read; the choice is ours."""

DEVIATIONS: Final = 2.0
FACTOR: Final = 2.0
"""A softening agrees with a published one if it has its sign and is within this factor."""


@dataclass(frozen=True)
class Softened:
    """The resonances of a subject at the magnitudes of a published group, None without a resonance."""

    published: Softening
    resonances_hz: tuple[float | None, float | None]

    @property
    def exponent(self) -> float | None:
        """The exponent n of resonance ~ magnitude^n of the subject; None without both resonances."""
        low, high = self.resonances_hz
        return None if low is None or high is None else exponent(self.published.magnitudes_mps2, (low, high))

    @property
    def agrees(self) -> bool:
        """Whether the resonance changes with the published sign, and within `FACTOR` of its size."""
        own = self.exponent
        return own is not None and 1.0 / FACTOR <= own / self.published.exponent <= FACTOR


@dataclass(frozen=True)
class Outside:
    """A range of frequencies where modulus or phase lies outside; value and limits are those of its farthest line."""

    quantity: str
    begin_hz: float
    end_hz: float
    at_hz: float
    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class BesidePeople:
    """A subject's curves beside the band of the group, its softening, and what lies outside."""

    subject: Subject
    curves: Curves
    band: Band
    softened: tuple[Softened, ...]
    outside: tuple[Outside, ...]

    def share_within(self, deviations: float) -> tuple[float, float]:
        """Shares of frequencies with modulus and with phase within so many standard deviations of the mean."""
        modulus, phase = (one.away <= deviations for one in _compared(self.curves, self.band))
        return float(np.mean(modulus)), float(np.mean(phase))


def beside_people(subject: Subject, as_printed: bool = False) -> BesidePeople:
    """Compare a subject with the references; raises InputError as `curves`."""
    found = references()
    at_one = curves(subject, MAGNITUDE_MPS2, as_printed)
    band = found.apparent_mass.band(at_one.frequency_hz)
    softened = []
    for published in found.softening:
        low, high = (curves(subject, one, as_printed).resonance_hz for one in published.magnitudes_mps2)
        softened.append(Softened(published, (low, high)))
    return BesidePeople(subject, at_one, band, tuple(softened), tuple(_outside(at_one, band)))


@dataclass(frozen=True, eq=False)
class _Compared:
    """Values of a subject over frequency, beside mean and standard deviation of the group."""

    quantity: str
    frequency_hz: Floats
    value: Floats
    mean: Floats
    sd: Floats

    @property
    def away(self) -> Floats:
        """Distances from the mean in standard deviations."""
        return np.asarray(np.abs(self.value - self.mean) / self.sd)


def _compared(of: Curves, band: Band) -> Iterator[_Compared]:
    """Modulus and phase; without the first line of the modulus, which is 1 for everybody and differs by rounding."""
    modulus = (of.frequency_hz, np.abs(of.apparent_mass), band.modulus, band.modulus_sd)
    yield _Compared("modulus", *(values[1:] for values in modulus))
    phase_deg = np.degrees(np.angle(of.apparent_mass))
    yield _Compared("phase", of.frequency_hz, phase_deg, band.phase_deg, band.phase_sd_deg)


def _outside(of: Curves, band: Band) -> Iterator[Outside]:
    for one in _compared(of, band):
        frequency_hz, sd = one.frequency_hz, one.sd
        for begin, end in _stretches(one.away > DEVIATIONS):
            at = begin + int(np.argmax(one.away[begin:end]))
            yield Outside(
                one.quantity, float(frequency_hz[begin]), float(frequency_hz[end - 1]), float(frequency_hz[at]),
                float(one.value[at]), float(one.mean[at] - DEVIATIONS * sd[at]),
                float(one.mean[at] + DEVIATIONS * sd[at]),
            )  # fmt: skip


def _stretches(flags: Flags) -> list[tuple[int, int]]:
    """Begin and end of every run of flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
