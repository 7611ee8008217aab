"""Levelling: where gravity points in a sensor's axes, and the rotation that turns it upright."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.segments import STANDARD_GRAVITY_MPS2

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]

LEAST_GRAVITY_MPS2: Final = 0.5 * STANDARD_GRAVITY_MPS2
UP: Final = (0.0, 0.0, 1.0)


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


def rotation_to_vertical(up: Floats) -> Floats:
    """The smallest rotation, (3, 3), that turns the unit vector `up` onto the third axis (Rodrigues)."""
    x, y, z = up.tolist()
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    rotation: Floats = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation
