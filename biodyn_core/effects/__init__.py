"""The catalogue of effects: every module of this package that defines `EFFECT` is one entry; no list names them."""

from __future__ import annotations

import copyreg
import importlib
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from biodyn_core.effects.effect import (
    AppliedEffect,
    ChainEffect,
    Effect,
    EffectParameter,
    Experiment,
    Joint,
    JointForce,
    JointLimit,
    SegmentForce,
    SensorTransform,
    StepBounds,
)
from biodyn_core.effects.ranges import Ranges, logistic
from biodyn_core.effects.transforms import active, apply_to_seat, apply_to_sensors, beyond_vertical, needs_channels


def _catalogue() -> Mapping[str, Effect]:
    modules = (importlib.import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__))
    effects = [module.EFFECT for module in modules if hasattr(module, "EFFECT")]
    return MappingProxyType({effect.name: effect for effect in effects})


CATALOGUE: Final = _catalogue()
"""Every effect by its name."""


PROTOCOL: Final = 4
"""Protocol of the copies between processes: the default of Python 3.12."""


def _catalogued(name: str) -> Effect:
    return CATALOGUE[name]


def _reduced(effect: Effect) -> Any:
    """An effect of the catalogue is pickled by its name, so that every process has one object of it."""
    known = CATALOGUE.get(effect.name) is effect
    return (_catalogued, (effect.name,)) if known else object.__reduce_ex__(effect, PROTOCOL)


for _kind in {type(effect) for effect in CATALOGUE.values()}:
    copyreg.pickle(_kind, _reduced)

__all__ = [
    "CATALOGUE", "AppliedEffect", "ChainEffect", "Effect", "EffectParameter", "Experiment", "Joint", "JointForce",
    "JointLimit", "Ranges", "SegmentForce", "SensorTransform", "StepBounds", "active", "apply_to_seat",
    "apply_to_sensors", "beyond_vertical", "logistic", "needs_channels",
]  # fmt: skip
