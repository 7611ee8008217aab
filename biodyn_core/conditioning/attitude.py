"""Upright: the true vertical of a sensor that leans while it moves, by its own gyro.

A reading along the axis that was vertical at rest takes horizontal motion for vertical once the sensor leans: at 10 deg
of lean and 5 m/s^2 fore and aft by 0.9 m/s^2. With rates it is known where up is. The product of lean and motion is
formed from raw samples: behind a low-pass, or with levels taken off, it is another one.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from biodyn_core.base.arrays import Floats
from biodyn_core.conditioning.tilt import UP
from biodyn_core.kernels.attitude import follow_attitude

PULLED_S: Final = 60.0
"""Time constant by which up goes to the mean of what is felt: a bias of 0.0003 rad/s ends 1 deg off, not further.

Within an event of some seconds it changes next to nothing; a vehicle that accelerates for a minute leans it.
"""

STILL_RADPS: Final = 0.05
"""Rates at rest that scatter by more than this, rms, tell no bias: then up cannot be followed."""

BLIND_S: Final = 0.1
"""Nor across a longer gap of the gyro."""

FARTHEST_DEG: Final = 60.0
"""Nobody seated leans farther: such rates are in another unit, or of another sensor."""


class ImplausibleTilt(ValueError):
    """Rates say a lean that nobody seated has: they are of another unit, and so likely are the record's others."""


def estimated_attitude(
    levelled_mps2: Floats, rates_radps: Floats, rate_hz: float, gravity_mps2: float, begin: ArrayLike = UP
) -> Floats:
    """The direction that was up at rest, (n, 3) in a sensor's axes, of a run at whose begin it is known.

    levelled_mps2 (n, 3) and rates_radps (n, 3) in the axes that were level at rest, third up, the first less what was
    read at rest, the second less their bias. Raises ImplausibleTilt where it is none of a person's.
    """
    force = levelled_mps2 + np.array([0.0, 0.0, gravity_mps2])
    up = np.empty_like(force)
    up[0] = begin
    follow_attitude(np.ascontiguousarray(rates_radps), force, 1.0 / rate_hz, 1.0 / (PULLED_S * rate_hz), up)
    farthest_deg = float(np.degrees(np.arccos(np.clip(up[:, 2].min(), -1.0, 1.0))))
    if not farthest_deg < FARTHEST_DEG:
        raise ImplausibleTilt(f"its gyro says that it leans by {farthest_deg:.0f} deg, which nobody seated does")
    return up


def carried_over(up: Floats, before_radps: Floats, behind_radps: Floats, seconds: float) -> Floats:
    """Where up is behind a break, (3,), from where it was before, turned by the mean of the rates on either side."""
    found = np.tile(up, (2, 1))
    follow_attitude(np.array([before_radps, behind_radps]), np.zeros((2, 3)), seconds, 0.0, found)
    return np.asarray(found[1])


def true_vertical_mps2(up: Floats, levelled_mps2: Floats, gravity_mps2: float) -> Floats:
    """Vertical acceleration (n,) without gravity, of readings (n, 3) along where up is, (n, 3)."""
    return np.asarray((up * levelled_mps2).sum(axis=1) + gravity_mps2 * (up[:, 2] - 1.0))
