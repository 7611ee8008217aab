"""Where a chain that is integrated has left the range in which it means anything."""

from __future__ import annotations

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.kernels.compiling import compiled


@compiled
def first_lost(accel: Floats, motion: Floats, most_m: float) -> int:
    """The first sample at which a joint is stretched by more than most_m, or is no number; n where there is none.

    accel (n, 6) m/s^2; motion (n, 12) = displacements relative to the seat, velocities.
    """
    for n in range(accel.shape[0]):
        below = 0.0
        for j in range(6):
            stretch = motion[n, j] - below
            below = motion[n, j]
            # NaN compares as false, so the range is asked for, not what lies beyond it.
            if not (-most_m <= stretch <= most_m and -np.inf < accel[n, j] < np.inf):
                return n
    return accel.shape[0]
