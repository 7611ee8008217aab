"""What to record next: what a verdict lacks, and experiments that separate what one record cannot (tracing, D)."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from typing import Final

from biodyn_core.effects import Effect
from biodyn_core.tracing.findings import Need
from biodyn_core.tracing.settings import FloorSettings

STANDSTILL: Final = "stand still with the engine running for 60 s: a line is then there without the road, a gain is not"
TAP: Final = "tap each sensor with a finger ten times at rest: skin rings, a clock is late, a gain does neither"
SWAP: Final = "put two sensors in each other's place and repeat: a sensor's fault goes with it, the body's stays"
QUIET_LOUD_QUIET: Final = (
    "60 s of smooth road, a rough minute, 60 s of smooth road again: what loosens recovers, a posture does not"
)
LEVELS: Final = "the same road at two speeds: a law of the joint changes with the level, memory and masses do not"
TURNS: Final = (
    "brake and steer on a smooth road: what comes from fore-aft or sideways motion shows without the vertical"
)
BARE: Final = "repeat without backrest, harness or helmet, whichever there is: the difference is its own"
SHOCKS: Final = "three shocks more of 3 g and more: stops, lift-off and asymmetry part where the joint is deepest"
REPEAT: Final = "repeat the same drive unchanged: what is not in the repetition is chance"

_OF_FAMILIES: Final = (
    ({"periodic"}, STANDSTILL),
    ({"sensor"}, TAP),
    ({"state_of_the_body"}, QUIET_LOUD_QUIET),
    ({"horizontal", "bending"}, TURNS),
    ({"backrest", "harness", "added_mass"}, BARE),
    ({"stiffening", "lift_off"}, SHOCKS),
    ({"memory", "quadratic_damping", "dry_friction", "cushion"}, LEVELS),
)


def separating(effects: Collection[Effect]) -> str:
    """The experiment that would separate these effects; a repetition where there is one kind or none."""
    if len({effect.name for effect in effects}) < 2:
        return REPEAT
    if len({effect.place == "sensor" for effect in effects}) == 2:
        return SWAP
    families = {effect.family for effect in effects}
    return "; and ".join([text for some, text in _OF_FAMILIES if some & families][:2]) or LEVELS


def to_record(needs: Sequence[Need], settings: FloorSettings) -> str:
    """All that a verdict lacks as one list: "9 s more road, 2 more shocks of 0.8 g, one of them of 2 g, held out"."""
    return "; ".join(listed(need, settings) for need in needs)


def listed(need: Need, settings: FloorSettings) -> str:
    """What to record for one use."""
    amounts = list(_amounts(need, settings))
    if amounts:
        return ", ".join([*amounts, need.use, *(f"in {how}" for how in need.how)])
    return ", ".join([*need.how, need.use])


def _amounts(need: Need, s: FloorSettings) -> Iterator[str]:
    if need.road_s > 0.0:
        yield f"{math.ceil(need.road_s - 1e-6):d} s more road"
    if need.shocks > 0:
        all_hard = need.hard_shocks == need.shocks
        least_g = s.hard_shock_g if all_hard else s.shock_g
        yield f"{need.shocks} more shock{'' if need.shocks == 1 else 's'} of {least_g:g} g"
        if need.hard_shocks and not all_hard:
            yield f"{_of_them(need.hard_shocks)} of {s.hard_shock_g:g} g"


def _of_them(count: int) -> str:
    return f"{'one' if count == 1 else count} of them"
