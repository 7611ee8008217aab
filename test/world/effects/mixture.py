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
from world.effects.unseen_mechanisms import Breathing, FluidFlow, PowerLaw, Sampling, SoftTissue, TwoJointTissue

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
"""The kinds for training; also in the study."""

UNSEEN_MECHANISMS: Final[Mapping[str, type[Mechanism]]] = {
    "two_joints": TwoJointTissue,
    "breathing": Breathing,
    "power_law": PowerLaw,
    "fluid_flow": FluidFlow,
    "soft_tissue": SoftTissue,
    "sampling": Sampling,
}
UNSEEN: Final = tuple(UNSEEN_MECHANISMS)
"""The kinds for the study alone: a background that nothing is trained or adjusted on."""

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
    "two_joints": (0.05, 0.50),
    "breathing": (0.03, 0.30),
    "power_law": (0.08, 0.60),
    "fluid_flow": (0.06, 0.45),
    "soft_tissue": (0.01, 0.15),
    "sampling": (0.01, 0.10),
}
"""Rms change of the vertical accelerations over their rms, median of bodies at scale 1. A refit absorbs most of it in
joints and nothing in sensors: 3 to 20 % are left."""

MOST_SHARE: Final = 0.4
"""A kind with a larger share of the squares would not be a background: it is an effect of ratio 0.8 beside the rest."""

LEVELS: Final = (0.15, 2.0)
"""The level of a background is log-uniform between these; at 1 it has the size of the paper's kind."""


def scales(kinds: Sequence[str], rng: np.random.Generator, bare: float = 0.0) -> dict[str, float]:
    """Draw the scale of each kind, 0 if absent; `PAPER` alone is not drawn, but 1. ValueError for an unknown kind.

    Every count of kinds is equally likely. The squares of their scales are shares of the square of the level
    (Dirichlet, evenly), because the changes of unlike mechanisms add up in squares. Both are drawn until no share
    exceeds `MOST_SHARE`, or twice an even share of few kinds. bare: probability that a body has no background at all.
    """
    for kind in kinds:
        if kind not in (known := (*KINDS, *UNSEEN)):
            raise ValueError(f"background {kind!r} is unknown, known are {', '.join(known)}")
    if tuple(kinds) == (PAPER,):
        return {PAPER: 1.0}
    shares, most = {kinds[0]: np.inf}, max(MOST_SHARE, 2.0 / len(kinds))
    while max(shares.values()) > most:
        count = int(rng.integers(1, len(kinds), endpoint=True))
        shares = dict(zip(rng.permutation(kinds)[:count].tolist(), rng.dirichlet(np.ones(count)), strict=True))
    level = float(np.exp(rng.uniform(*np.log(LEVELS)))) * float(rng.uniform() >= bare)
    return {kind: level * float(np.sqrt(shares.get(kind, 0.0))) for kind in kinds}


def mechanisms(person: Person, of: Mapping[str, float], seed: Sequence[int]) -> tuple[Mechanism, ...]:
    """The mechanisms of a body by the scale of each kind: each by (seed, kind) alone, and without those of scale 0."""
    known = {**MECHANISMS, **UNSEEN_MECHANISMS}
    return tuple(
        known[kind].of(person, scale, np.random.default_rng([*seed, zlib.crc32(kind.encode())]))
        for kind, scale in of.items()
        if kind != PAPER and scale > 0.0
    )
