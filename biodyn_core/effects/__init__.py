"""The catalogue: every module of this package that has an `EFFECT` is one entry, and nothing else need know of it."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from biodyn_core.effects.arrays import felt, needs_channels, shown
from biodyn_core.effects.effect import AppliedEffect, Effect, EffectParameter, Joint
from biodyn_core.effects.ranges import Ranges, logistic


def _catalogue() -> Mapping[str, Effect]:
    modules = (importlib.import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__))
    effects = [module.EFFECT for module in modules if hasattr(module, "EFFECT")]
    return MappingProxyType({effect.name: effect for effect in effects})


CATALOGUE: Final = _catalogue()
"""Every effect by its name."""

__all__ = [
    "CATALOGUE", "AppliedEffect", "Effect", "EffectParameter", "Joint", "Ranges", "felt", "logistic", "needs_channels",
    "shown",
]  # fmt: skip
