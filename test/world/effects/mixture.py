"""Backgrounds of several kinds: their names, how much of each a body has, and their mechanisms."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from world.effects.body_mechanisms import (
    HorizontalCoupling,
    Hysteresis,
    Relaxation,
    Softening,
    SprungMasses,
    StiffnessDrift,
)  # fmt: skip
from world.effects.effect import Person
from world.effects.mechanism import Mechanism
from world.effects.sensor_mechanisms import CoherentFilter, ColouredNoise, Mounting

PAPER: Final = "paper"
"""The kind in `background.py`, whose scale 1 has the residual of the paper."""

MECHANISMS: Final[Mapping[str, type[Mechanism]]] = {
    "hysteresis": Hysteresis,
    "relaxation": Relaxation,
    "sprung_masses": SprungMasses,
    "horizontal": HorizontalCoupling,
    "softening": Softening,
    "drift": StiffnessDrift,
    "coherent_filter": CoherentFilter,
    "coloured_noise": ColouredNoise,
    "mounting": Mounting,
}
KINDS: Final = (PAPER, *MECHANISMS)

CHANGES: Final[Mapping[str, tuple[float, float]]] = {
    PAPER: (0.03, 0.25),
    "hysteresis": (0.03, 0.30),
    "relaxation": (0.10, 0.60),
    "sprung_masses": (0.03, 0.40),
    "horizontal": (0.01, 0.15),
    "softening": (0.01, 0.30),
    "drift": (0.03, 0.30),
    "coherent_filter": (0.02, 0.25),
    "coloured_noise": (0.005, 0.10),
    "mounting": (0.01, 0.10),
}
"""Rms change of the vertical accelerations over their rms, median of bodies at scale 1. A refit absorbs most of it in
joints and nothing in sensors: 3 to 20 % are left."""

ABSENT: Final = 0.25
"""Probability that a body has none of a kind that is drawn."""

SCALES: Final = (0.1, 2.0)
"""Else the scale is log-uniform between these; at 1 a kind alone has its typical size."""


def scales(kinds: Sequence[str], rng: np.random.Generator, absent: float = ABSENT) -> dict[str, float]:
    """Draw the scale of each kind, 0 for none; `PAPER` alone is not drawn, but 1. ValueError for an unknown kind."""
    for kind in kinds:
        if kind not in KINDS:
            raise ValueError(f"background {kind!r} is unknown, known are {', '.join(KINDS)}")
    if tuple(kinds) == (PAPER,):
        return {PAPER: 1.0}
    sizes = np.exp(rng.uniform(*np.log(SCALES), len(kinds)))
    there = rng.uniform(size=len(kinds)) >= absent
    return {kind: float(size) if on else 0.0 for kind, size, on in zip(kinds, sizes, there, strict=True)}


def mechanisms(person: Person, of: Mapping[str, float], seed: Sequence[int]) -> tuple[Mechanism, ...]:
    """The mechanisms of a body by the scale of each kind: each by (seed, kind) alone, and without those of scale 0."""
    return tuple(
        MECHANISMS[kind].of(person, scale, np.random.default_rng([*seed, zlib.crc32(kind.encode())]))
        for kind, scale in of.items()
        if kind != PAPER and scale > 0.0
    )
