"""Experiments: recordings that are missing for a verdict, and experiments that separate effects."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Final

from biodyn_core.effects import Effect, Experiment
from biodyn_core.tracing.findings import Need
from biodyn_core.tracing.settings import FloorSettings

STANDSTILL: Final = "stand still with the engine running for 60 s: an engine line remains, a gain has no effect"
TAP: Final = (
    "tap each sensor with a finger ten times at rest: a soft mounting rings, a clock is late, a gain does neither"
)
SWAP: Final = "exchange two sensors and repeat: a sensor fault moves with its sensor, a fault of the body stays"
QUIET_LOUD_QUIET: Final = (
    "60 s of smooth road, 60 s of rough road, 60 s of smooth road: a loosened tissue recovers, a new posture stays"
)
LEVELS: Final = "the same road at two speeds: a joint law changes with the level, memory and masses do not"
TURNS: Final = "brake and steer on a smooth road: effects of horizontal motion appear without vertical motion"
BARE: Final = "repeat without backrest, harness or helmet: the difference is the effect of that part"
SHOCKS: Final = "three further shocks of 3 g and more: stops, lift-off and asymmetry differ at the largest stretch"
REPEAT: Final = "repeat the same drive unchanged: differences between both are random"

_TEXTS: Final[Mapping[Experiment, str]] = {
    "standstill": STANDSTILL,
    "tap": TAP,
    "quiet_loud_quiet": QUIET_LOUD_QUIET,
    "turns": TURNS,
    "bare": BARE,
    "shocks": SHOCKS,
    "levels": LEVELS,
}
"""The first two that the effects declare are asked for."""


def separating(effects: Collection[Effect]) -> str:
    """The experiment that separates these effects; a repetition for one effect or none."""
    if len({effect.name for effect in effects}) < 2:
        return REPEAT
    if len({effect.place == "sensor" for effect in effects}) == 2:
        return SWAP
    declared = {effect.separated_by for effect in effects}
    return "; and ".join([text for experiment, text in _TEXTS.items() if experiment in declared][:2])


def to_record(needs: Sequence[Need], settings: FloorSettings) -> str:
    """All missing recordings as one list: "9 s more road, 2 more shocks of 0.8 g, one of them of 2 g, held out"."""
    return "; ".join(listed(need, settings) for need in needs)


def listed(need: Need, settings: FloorSettings) -> str:
    """The recordings of one need."""
    amounts = list(_amounts(need, settings))
    if amounts:
        return ", ".join([*amounts, need.use, *(f"in {condition}" for condition in need.conditions)])
    return ", ".join([*need.conditions, need.use])


def _amounts(need: Need, s: FloorSettings) -> Iterator[str]:
    if need.road_s > 0.0:
        yield f"{math.ceil(need.road_s - 1e-6):d} s more road"
    if need.shocks > 0:
        all_hard = need.hard_shocks == need.shocks
        least_g = s.hard_shock_g if all_hard else s.shock_g
        yield f"{need.shocks} more shock{'' if need.shocks == 1 else 's'} of {least_g:g} g"
        if need.hard_shocks and not all_hard:
            yield f"{'one' if need.hard_shocks == 1 else need.hard_shocks} of them of {s.hard_shock_g:g} g"
