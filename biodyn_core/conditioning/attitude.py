"""Attitude: the true vertical of a sensor that tilts during motion, by its own gyro.

The axis that was vertical at rest measures a part of horizontal motion once the sensor tilts: 0.9 m/s^2 at 10 deg of
tilt and 5 m/s^2 fore and aft. Angular rates give the direction of up. The product of tilt and motion must be formed
from raw samples: after a low-pass, or without their level, it is another one.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from biodyn_core.base.arrays import Floats
from biodyn_core.conditioning.tilt import UP
from biodyn_core.kernels.attitude import follow_attitude

CORRECTION_S: Final = 60.0
"""Time constant of the correction of up towards the mean specific force: a bias of 0.0003 rad/s causes at most 1 deg.

It changes little within an event of some seconds; a vehicle that accelerates for a minute tilts it.
"""

MAX_RATE_SCATTER_RADPS: Final = 0.05
"""With more scatter of the rates at rest, rms, their bias is unknown, and up cannot be integrated."""

MAX_GYRO_GAP_S: Final = 0.1
"""Nor across a longer gap of the gyro."""

MAX_TILT_DEG: Final = 60.0
"""A seated person does not tilt a sensor farther: such rates are in another unit, or of another sensor."""


class ImplausibleTilt(ValueError):
    """The rates give a tilt impossible for a seated person: all rates of the record may have another unit."""


def estimated_attitude(
    levelled_mps2: Floats, rates_radps: Floats, rate_hz: float, gravity_mps2: float, begin: ArrayLike = UP
) -> Floats:
    """The direction of up over a run, (n, 3), in the axes that were level at rest; begin: its direction at the start.

    levelled_mps2 (n, 3), without the reading at rest, and rates_radps (n, 3), without their bias, are in the same axes,
    third up. Raises ImplausibleTilt beyond MAX_TILT_DEG.
    """
    force = levelled_mps2 + np.array([0.0, 0.0, gravity_mps2])
    up = np.empty_like(force)
    up[0] = begin
    follow_attitude(np.ascontiguousarray(rates_radps), force, 1.0 / rate_hz, 1.0 / (CORRECTION_S * rate_hz), up)
    largest_deg = float(np.degrees(np.arccos(np.clip(up[:, 2].min(), -1.0, 1.0))))
    if not largest_deg < MAX_TILT_DEG:
        raise ImplausibleTilt(f"its gyro gives a tilt of {largest_deg:.0f} deg, impossible for a seated person")
    return up


def up_after_break(up: Floats, before_radps: Floats, after_radps: Floats, seconds: float) -> Floats:
    """The direction of up after a break, (3,), rotated from that before by the mean of the rates on either side."""
    found = np.tile(up, (2, 1))
    follow_attitude(np.array([before_radps, after_radps]), np.zeros((2, 3)), seconds, 0.0, found)
    return np.asarray(found[1])


def true_vertical_mps2(up: Floats, levelled_mps2: Floats, gravity_mps2: float) -> Floats:
    """Vertical acceleration (n,) without gravity, from readings (n, 3) and the direction of up (n, 3)."""
    return np.asarray((up * levelled_mps2).sum(axis=1) + gravity_mps2 * (up[:, 2] - 1.0))
