"""Validity of integrated chains."""

from __future__ import annotations

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.kernels.compiling import compiled


@compiled
def first_invalid(accel: Floats, motion: Floats, max_stretch_m: float) -> int:
    """The first sample with a joint stretched by more than max_stretch_m, or with a non-finite value; n if none.

    accel (n, 6) m/s^2; motion (n, 18) = displacements relative to the seat, then velocities and forces.
    """
    for n in range(accel.shape[0]):
        below = 0.0
        for j in range(6):
            stretch = motion[n, j] - below
            below = motion[n, j]
            # Comparisons with NaN are false, so test for inside the range, not for outside.
            if not (-max_stretch_m <= stretch <= max_stretch_m and -np.inf < accel[n, j] < np.inf):
                return n
    return accel.shape[0]
