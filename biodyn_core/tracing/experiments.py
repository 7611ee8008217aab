"""What to record next: experiments that would separate what one record cannot (tracing, D)."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

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

_BY_NAME: Final = (
    ({"periodic"}, STANDSTILL),
    ({"skin", "clock", "gain"}, TAP),
    ({"thixotropy", "posture"}, QUIET_LOUD_QUIET),
    ({"cross_axis", "pitch", "tilt", "bending"}, TURNS),
    ({"backrest", "harness", "added_mass"}, BARE),
    ({"asymmetry", "stop", "cubic", "lift_off"}, SHOCKS),
    ({"relaxation", "viscera", "reflex", "quadratic_damping", "friction", "hysteresis", "cushion"}, LEVELS),
)


def separating(names: Collection[str]) -> str:
    """The experiment that would separate effects of these names; a repetition where there is one or none."""
    if len(names) < 2:
        return REPEAT
    known = [(len(group & set(names)), text) for group, text in _BY_NAME]
    touched = [text for count, text in known if count]
    sensors = set(names) & {"skin", "clock", "gain", "tilt"}
    if sensors and sensors != set(names):
        return SWAP
    return max(known)[1] if len(touched) == 1 else "; and ".join(touched[:2])
