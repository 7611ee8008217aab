"""Rides: the output of six IMUs on several people, each person on a separate seat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from world import body, sensors
from world.seats import RATE_HZ, Case, Motion

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Streams = dict[str, tuple[Integers, Floats]]

SENSORS: Final = ("seat", "pelvis", "lower_torso", "central_torso", "upper_torso", "neck", "head")
"""The seat, and the segments upwards; the central torso carries no sensor."""

WORN: Final = tuple(name for name in SENSORS if name != "central_torso")
REST_S: Final = (2.5, 1.5)
"""Rest before and after the motion: gravity is estimated in the first, the body settles in the second."""


@dataclass(frozen=True, eq=False)
class Ride:
    """One event of one person: streams by sensor, and the truth at `RATE_HZ`, up, (n, 7) by `SENSORS`."""

    case: Case
    origin: str
    streams: Streams
    truth_mps2: Floats


def wear(rng: np.random.Generator) -> dict[str, sensors.Imu]:
    """Six sensors put on a person for a day."""
    return {name: sensors.drawn(rng) for name in WORN}


def rides(
    people: body.People, worn: Sequence[dict[str, sensors.Imu]], motions: Sequence[Motion], rng: np.random.Generator
) -> list[Ride]:
    """Move everyone at once; all motions are of one length."""
    before, after = (np.zeros((round(s * RATE_HZ), 3)) for s in REST_S)
    seats = [np.concatenate([before, motion.accel_mps2, after]) for motion in motions]
    answers = body.accelerations(people, RATE_HZ, np.column_stack([seat[:, 2] for seat in seats]))
    found = []
    for motion, seat, answer, imus in zip(motions, seats, answers, worn, strict=True):
        up = np.column_stack([seat[:, 2], answer])
        streams = {}
        for name, imu in imus.items():
            # Sideways a seated person goes with the seat.
            truth = np.column_stack([seat[:, :2], up[:, SENSORS.index(name)]])
            streams[name] = imu.stream(truth, RATE_HZ, rng)
        found.append(Ride(motion.case, motion.origin, streams, up))
    return found
