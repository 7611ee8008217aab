"""Levelling: where gravity points in a sensor's axes, and the rotation that turns it upright."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2

Vector = tuple[float, float, float]

LEAST_GRAVITY_MPS2: Final = 0.5 * STANDARD_GRAVITY_MPS2
UP: Final = (0.0, 0.0, 1.0)

UPRIGHT: Final = 0.9
"""A first axis whose cosine with the vertical is this or more, 26 degrees, has no direction once it is laid level."""


def gravity_and_vertical(mean_mps2: Vector, given: Vector | None) -> tuple[float, Vector | None]:
    """Gravity (m/s^2) and vertical (unit vector, None where too little gravity shows) of a sensor's mean at rest.

    Along a given vertical, gravity is the mean's part along it: what is left of it where a driver has taken it off.
    """
    if given is not None:
        size = math.hypot(*given)
        x, y, z = (v / size for v in given)
        return mean_mps2[0] * x + mean_mps2[1] * y + mean_mps2[2] * z, (x, y, z)
    norm = math.sqrt(sum(v * v for v in mean_mps2))
    if norm < LEAST_GRAVITY_MPS2:
        return norm, None
    return norm, (mean_mps2[0] / norm, mean_mps2[1] / norm, mean_mps2[2] / norm)


def laid_level(up: Vector) -> Floats:
    """Level axes x, y and z as rows, (3, 3), in those of a sensor that sees up so: x is its first axis, laid level.

    Where the first axis itself stands upright, y is the second, laid level.
    """
    z = np.array(up) / np.linalg.norm(up)
    own = 1 if abs(z[0]) >= UPRIGHT else 0
    level = np.eye(3)[own] - z[own] * z
    level /= np.linalg.norm(level)
    return np.array([level, np.cross(z, level), z] if own == 0 else [np.cross(level, z), level, z])


def first_axis_rad(up: Vector) -> float:
    """Direction of the sensor's own first axis, laid level, in the axes that `rotation_to_vertical` leaves; radians.

    Zero for a sensor that lies flat. One that is tilted about both axes is turned in the plane too.
    """
    x, y, _ = (rotation_to_vertical(np.array(up)) @ laid_level(up)[0]).tolist()
    return math.atan2(y, x)


def rotation_to_vertical(up: Floats) -> Floats:
    """The smallest rotation, (3, 3), that turns the unit vector `up` onto the third axis (Rodrigues)."""
    x, y, z = up.tolist()
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    rotation: Floats = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation
