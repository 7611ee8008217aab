"""What to record next: experiments that would separate what one record cannot (tracing, D)."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from biodyn_core.effects import Effect

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
    if len({effect.measured is None for effect in effects}) == 2:
        return SWAP
    families = {effect.family for effect in effects}
    return "; and ".join([text for some, text in _OF_FAMILIES if some & families][:2]) or LEVELS
