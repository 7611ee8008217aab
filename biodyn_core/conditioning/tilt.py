"""Tilt: the direction of gravity in a sensor's axes, and the rotation of that direction to the vertical."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2

Vector = tuple[float, float, float]

LEAST_GRAVITY_MPS2: Final = 0.5 * STANDARD_GRAVITY_MPS2
GRAVITY_TOLERANCE: Final = 0.05
"""Largest relative difference of a sensor's gravity from the standard one."""

UP: Final = (0.0, 0.0, 1.0)

MAX_COSINE: Final = 0.9
"""A first axis within 26 degrees of the vertical, by its cosine, has no certain direction in the horizontal plane."""

MAX_YAW_COSINE: Final = 0.985
"""A yaw is given to the first axis as long as it is more than 10 degrees from the vertical, by its cosine.

Nearer to it 1 degree of tilt would turn its projection by 6 degrees and more.
"""


def is_gravity(mean_mps2: float) -> bool:
    """Whether the mean reading of a sensor can be gravity."""
    return abs(mean_mps2 / STANDARD_GRAVITY_MPS2 - 1.0) <= GRAVITY_TOLERANCE


def gravity_and_vertical(mean_mps2: Vector, given: Vector | None) -> tuple[float, Vector | None]:
    """Gravity (m/s^2) and vertical (unit vector, None with too little gravity) of a sensor's mean at rest.

    With a given vertical, gravity is the mean's component along it, also where a driver has subtracted gravity.
    """
    if given is not None:
        size = math.hypot(*given)
        x, y, z = (v / size for v in given)
        return mean_mps2[0] * x + mean_mps2[1] * y + mean_mps2[2] * z, (x, y, z)
    norm = math.sqrt(sum(v * v for v in mean_mps2))
    if norm < LEAST_GRAVITY_MPS2:
        return norm, None
    return norm, (mean_mps2[0] / norm, mean_mps2[1] / norm, mean_mps2[2] / norm)


def horizontal_axes(up: Vector, most: float = MAX_COSINE) -> Floats:
    """Horizontal axes x and y and the vertical z as rows, (3, 3), in the axes of a sensor with this direction of up.

    x is the projection of the sensor's first axis; where that is nearly vertical, its cosine `most` or more, y is the
    projection of the second.
    """
    z = np.array(up) / np.linalg.norm(up)
    own = 1 if abs(z[0]) >= most else 0
    level = np.eye(3)[own] - z[own] * z
    level /= np.linalg.norm(level)
    return np.array([level, np.cross(z, level), z] if own == 0 else [np.cross(level, z), level, z])


def first_axis_rad(up: Vector) -> float:
    """Direction of the sensor's own first axis in the horizontal plane, after `rotation_to_vertical`, radians.

    Of one that is nearly vertical, the direction to which the second axis is at right angles. Zero for a sensor that
    lies flat; a tilt about both axes also turns it in the plane.
    """
    x, y, _ = (rotation_to_vertical(np.array(up)) @ horizontal_axes(up, MAX_YAW_COSINE)[0]).tolist()
    return math.atan2(y, x)


def rotation_to_vertical(up: Floats) -> Floats:
    """The smallest rotation, (3, 3), that turns the unit vector `up` onto the third axis (Rodrigues)."""
    x, y, z = up.tolist()
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    rotation: Floats = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation
