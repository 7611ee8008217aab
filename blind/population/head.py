"""Head: how little a chain can amplify it where its apparent mass agrees, without and with viscera on the torso."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.base.segments import HEAD, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import MASS_SCALE, STIFFENING
from biodyn_core.effects import CATALOGUE
from biodyn_core.effects.effect import EffectParameter
from biodyn_core.population.population import theta_of
from biodyn_core.population.references import references
from blind.population.deriving import BODY_MASS_KG, FREQUENCY_HZ

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

SITES: Final = (None, "lower_torso", "central_torso", "upper_torso")
WEIGHTS: Final = (0.0, 0.1, 0.3, 1.0)
"""Of an amplification of the head beyond `MOST`, beside the deviation of the apparent mass."""

MOST: Final = 1.5
STARTS: Final = 3
PRIOR: Final = 0.005
VISCERA: Final = ("mass_kg", "natural_frequency_hz", "damping_ratio")


@dataclass(frozen=True)
class HeadRow:
    """One compromise: rms deviation of the normalised apparent mass, and the peak of the head."""

    site: str | None
    weight: float
    deviation: float
    peak: float
    peak_hz: float
    viscera: tuple[float, ...]


def rows() -> list[HeadRow]:
    """The best compromises for every site of the viscera, and for none."""
    return [_row(site, weight) for site in SITES for weight in WEIGHTS]


def responses(theta: Floats, site: str | None, viscera: Floats) -> tuple[Complexes, Complexes]:
    """Normalised apparent mass and transmissibility of the head, (f,), of a linear chain with a mass on a segment."""
    chain = Chain.of_theta(theta, BODY_MASS_KG, "segment")
    mass, damping, stiffness = chain.inertia_kg, chain.C, chain.K
    if site is not None:
        own_kg, frequency_hz, zeta = viscera.tolist()
        omega = 2.0 * np.pi * frequency_hz
        spring = np.zeros(len(SEGMENTS) + 1)
        spring[SEGMENTS.index(site)], spring[-1] = 1.0, -1.0
        coupled = np.outer(spring, spring)
        stiffness = np.pad(stiffness, (0, 1)) + own_kg * omega**2 * coupled
        damping = np.pad(damping, (0, 1)) + 2.0 * zeta * omega * own_kg * coupled
        mass = np.append(mass, own_kg)
    w = 2.0 * np.pi * FREQUENCY_HZ[:, None, None]
    dynamic = -(w**2) * np.diag(mass) + 1j * w * damping + stiffness
    relative = np.linalg.solve(dynamic, np.broadcast_to(-mass[:, None], (len(FREQUENCY_HZ), mass.size, 1)))[:, :, 0]
    transmitted = 1.0 - w[:, :, 0] ** 2 * relative
    apparent_mass = transmitted @ mass
    return apparent_mass / np.abs(apparent_mass[0]), transmitted[:, SEGMENTS.index(HEAD)]


def _row(site: str | None, weight: float) -> HeadRow:
    reference = references().apparent_mass.mean(FREQUENCY_HZ)
    bounds = np.array([(one.lower, one.upper) for one in _ranges()]).T

    def split(places: Floats) -> tuple[Floats, Floats]:
        theta = theta_of(places[:STIFFENING])
        inside = 1.0 / (1.0 + np.exp(-places[STIFFENING:]))
        if site is not None:  # the mass of the viscera is taken from the segments
            theta[MASS_SCALE] = 0.85 + 0.15 * inside[0]
        return theta, bounds[0] + (bounds[1] - bounds[0]) * inside[1:]

    def away(places: Floats) -> Floats:
        theta, viscera = split(places)
        apparent_mass, head = responses(theta, site, viscera)
        missed, beyond = apparent_mass - reference, np.maximum(np.abs(head) - MOST, 0.0)
        return np.concatenate([missed.real, missed.imag, weight * beyond, PRIOR * places])

    size = STIFFENING + 1 + len(VISCERA)
    starts = (np.random.default_rng(seed).normal(size=size) for seed in range(STARTS))
    best = min((optimize.least_squares(away, start) for start in starts), key=lambda one: float(one.cost))
    theta, viscera = split(best.x)
    apparent_mass, head = responses(theta, site, viscera)
    at = int(np.argmax(np.abs(head)))
    deviation = float(np.sqrt(np.mean(np.abs(apparent_mass - reference) ** 2)))
    found = () if site is None else tuple(viscera.tolist())
    return HeadRow(site, weight, deviation, float(np.abs(head[at])), float(FREQUENCY_HZ[at]), found)


def _ranges() -> list[EffectParameter]:
    known = {parameter.name: parameter for parameter in CATALOGUE["viscera"].parameters}
    return [known[name] for name in VISCERA]
