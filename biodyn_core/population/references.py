"""Published measurements of seated people under vertical vibration, with their sources and conditions.

The numbers stand in references.yaml beside this module, with what could not be confirmed.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np
import yaml

from biodyn_core.base.arrays import Complexes, Floats

FILE: Final = "references.yaml"

DRAWS: Final = 2000
"""Curves drawn for standard deviations by frequency; more change no second digit."""


@dataclass(frozen=True)
class AssumedSpread:
    """Standard deviations between people of ln f_n and ln zeta of the apparent mass, and why they are assumed."""

    ln_natural_frequency: float
    ln_damping_ratio: float
    reason: str


@dataclass(frozen=True, eq=False)
class Band:
    """Mean and standard deviation between people of modulus and phase_deg, each (f,)."""

    frequency_hz: Floats
    modulus: Floats
    modulus_sd: Floats
    phase_deg: Floats
    phase_sd_deg: Floats


@dataclass(frozen=True)
class ApparentMass:
    """Mean apparent mass of a group, normalised by its modulus at normalised_at_hz: a mass on a spring and a damper."""

    natural_frequency_hz: float
    damping_ratio: float
    normalised_at_hz: float
    lowest_hz: float
    highest_hz: float
    people: int
    group: str
    conditions: str
    source: str
    read_in: str
    assumed_spread: AssumedSpread

    def mean(self, frequency_hz: Floats) -> Complexes:
        """The mean of the group over frequency (f,)."""
        return self.of(np.array(self.natural_frequency_hz), np.array(self.damping_ratio), frequency_hz)

    def of(self, natural_frequency_hz: Floats, damping_ratio: Floats, frequency_hz: Floats) -> Complexes:
        """The apparent mass (..., f) of people with these natural frequencies and damping ratios (...)."""
        at = np.append(self.normalised_at_hz, frequency_hz)
        r = at / natural_frequency_hz[..., None]
        carried = 1.0 + 2j * damping_ratio[..., None] * r
        found = carried / (carried - r**2)
        return np.asarray(found[..., 1:] / np.abs(found[..., :1]))

    def people_drawn(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
        """Natural frequencies and damping ratios (count,) of people drawn with the assumed spread."""
        spread = self.assumed_spread
        frequency_hz = self.natural_frequency_hz * np.exp(spread.ln_natural_frequency * rng.normal(size=count))
        return frequency_hz, self.damping_ratio * np.exp(spread.ln_damping_ratio * rng.normal(size=count))

    def band(self, frequency_hz: Floats) -> Band:
        """The mean of the group, and the assumed spread between people, over frequency (f,)."""
        mean = self.mean(frequency_hz)
        drawn = self.of(*self.people_drawn(np.random.default_rng(0), DRAWS), frequency_hz)
        phases_deg = np.degrees(np.angle(drawn))
        return Band(
            frequency_hz, np.abs(mean), np.abs(drawn).std(axis=0), np.degrees(np.angle(mean)), phases_deg.std(axis=0)
        )


@dataclass(frozen=True)
class Softening:
    """Resonance of a group's apparent mass, Hz, at the smallest and the largest magnitude, m/s^2 rms."""

    people: int
    magnitudes_mps2: tuple[float, float]
    resonances_hz: tuple[float, float]
    conditions: str
    source: str
    read_in: str

    @property
    def exponent(self) -> float:
        """The exponent n of resonance ~ magnitude^n."""
        return exponent(self.magnitudes_mps2, self.resonances_hz)


def exponent(magnitudes_mps2: tuple[float, float], resonances_hz: tuple[float, float]) -> float:
    """The exponent n of resonance ~ magnitude^n between two magnitudes."""
    return math.log(resonances_hz[1] / resonances_hz[0]) / math.log(magnitudes_mps2[1] / magnitudes_mps2[0])


@dataclass(frozen=True)
class GroupResonance:
    """Resonance of a group's apparent mass at one magnitude."""

    people: int
    magnitude_mps2: float
    resonance_hz: float
    conditions: str
    source: str
    read_in: str


@dataclass(frozen=True)
class HeadPeak:
    """Frequency of the peak of a group's seat-to-head transmissibility; its modulus could not be read."""

    people: int
    peak_hz: float
    magnitudes_mps2: tuple[float, float]
    conditions: str
    source: str
    read_in: str


@dataclass(frozen=True)
class References:
    """All references, and in words what could not be confirmed."""

    apparent_mass: ApparentMass
    softening: tuple[Softening, ...]
    resonances: tuple[GroupResonance, ...]
    head: HeadPeak
    not_confirmed: tuple[str, ...]


@functools.cache
def references() -> References:
    """The references of the package."""
    text = resources.files("biodyn_core.population").joinpath(FILE).read_text(encoding="utf-8")
    stored = yaml.safe_load(text)
    mass = stored["apparent_mass"]
    spread = AssumedSpread(**mass["assumed_spread"])
    return References(
        apparent_mass=ApparentMass(**mass | {"assumed_spread": spread}),
        softening=tuple(Softening(**_tuples(one)) for one in stored["softening"]),
        resonances=tuple(GroupResonance(**one) for one in stored["resonances"]),
        head=HeadPeak(**_tuples(stored["head"])),
        not_confirmed=tuple(stored["not_confirmed"]),
    )


def _tuples(stored: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in stored.items()}
