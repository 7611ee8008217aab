"""Draws effects by the name of their split; `third` is for scoring only (see the package's docstring)."""

from __future__ import annotations

from collections.abc import Collection
from importlib import import_module
from typing import Final, Literal

import numpy as np

from world.effects.effect import Effect

Split = Literal["development", "second", "earlier", "third"]

SCORING: Final[Split] = "third"

KINDS: Final = (
    "asymmetry", "cubic", "stop", "quadratic_damping", "friction", "hysteresis", "relaxation", "thixotropy", "posture",
    "reflex", "lift_off", "cushion", "viscera", "backrest", "harness", "added_mass", "cross_axis", "pitch", "bending",
    "periodic", "skin", "tilt", "clock", "gain", "saturation",
)  # fmt: skip
"""The classes of the catalogue, and "outside" for effects of no class."""


def forms(split: Split) -> tuple[type[Effect], ...]:
    """All forms of a split; its module is imported only now."""
    found: tuple[type[Effect], ...] = import_module(f"world.effects.{split}_forms").FORMS
    return found


def effect(split: Split, rng: np.random.Generator, kinds: Collection[str] = KINDS) -> Effect:
    """An effect: its class evenly among kinds, then its form, site, shape and strength."""
    available = forms(split)
    kind = str(rng.choice(sorted(kinds)))
    return rng.choice([form for form in available if form.kind == kind]).drawn(rng)  # type: ignore[arg-type]
