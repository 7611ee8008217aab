"""Heading: rotation of body sensors about the vertical against the seat's, from their horizontal motion.

A sensor may have any heading, which readings at rest do not show. At low frequencies a person moves sideways with the
seat, and every segment with the one below: two neighbours then measure one motion in two frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Complexes, Floats
from biodyn_core.base.segments import SEAT, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.channels import Channels

SLOW_HZ: Final = (0.2, 3.0)
"""Lower frequencies contain levels and the drift of gyros, higher ones the sway of each segment."""

LEAST_MPS2: Final = 0.05
"""Less slow motion, rms, may be leakage of some hundredths of the vertical, by axes that are not orthogonal."""

MAX_ERROR_RAD: Final = 0.15
"""Largest error of a heading against the next neighbour, 9 deg rms."""

JOINTS: Final = {"neck": "upper_torso", "head": "neck"}
"""Measured segments with a gyro on both sides of their joint, and the segment below."""


def headings_rad(channels: Mapping[str, Channels], rate_hz: float) -> dict[str, float]:
    """Rotation of each body sensor to the left of the seat's, -pi to pi, where it is known.

    Each is measured against the next sensor below with a known heading.
    """
    if SEAT not in channels:
        return {}
    below, found = SEAT, {SEAT: 0.0}
    slow = {name: _slow(channels[name], rate_hz) for name in SENSORS}
    for name in SENSORS[1:]:
        between = _rotation_rad(slow[below], slow[name], rate_hz)
        if between is not None:
            found[name] = math.remainder(found[below] + between, 2.0 * math.pi)
            below = name
    return {name: angle for name, angle in found.items() if name != SEAT}


def bend_rates_radps(channels: Mapping[str, Channels], headings: Mapping[str, float]) -> dict[str, Floats]:
    """Bending rates of the `JOINTS` about the seat's x and y, (n,) each, such as `neck.bend_rate_y`.

    Only where both segments have a gyro and a heading; NaN where either is masked.
    """
    turning = {}
    for name, angle in headings.items():
        rates = channels[name].rates_radps
        if rates is not None:
            turning[name] = np.exp(1j * angle) * (rates[:, 0] + 1j * rates[:, 1])
    found: dict[str, Floats] = {}
    for upper, lower in JOINTS.items():
        if {upper, lower} <= turning.keys():
            bend = turning[upper] - turning[lower]
            found |= {f"{upper}.bend_rate_x": bend.real, f"{upper}.bend_rate_y": bend.imag}
    return found


def _slow(channels: Channels, rate_hz: float) -> Complexes:
    """The slow motion along x and y as x + iy, (n,); NaN where masked.

    A gyro gives the tilt and hence the part of gravity, which exceeds the motion in a nodding head.
    """
    masked = np.isnan(channels.horizontal_mps2).any(axis=1)
    accel = np.where(masked, 0.0, channels.horizontal_mps2[:, 0] + 1j * channels.horizontal_mps2[:, 1])
    if channels.rates_radps is not None:
        x, y, _ = np.nan_to_num(channels.rates_radps).T
        accel = accel + STANDARD_GRAVITY_MPS2 / rate_hz * np.cumsum(y - 1j * x)
    passed = scipy.signal.butter(2, SLOW_HZ, "bandpass", fs=rate_hz, output="sos")
    slow = scipy.signal.sosfiltfilt(passed, accel.real) + 1j * scipy.signal.sosfiltfilt(passed, accel.imag)
    return np.where(masked, np.nan, slow)


def _rotation_rad(one: Complexes, other: Complexes, rate_hz: float) -> float | None:
    """Rotation of the other's frame to the left of the one's, (n,) each; None where it is unknown.

    The rotation of best fit (Procrustes). Its error is that of so many independent pairs, two numbers each.
    """
    known = ~np.isnan(one + other)
    count = np.count_nonzero(known)
    own, others = (float(np.vdot(slow[known], slow[known]).real) for slow in (one, other))
    if not min(own, others) > count * LEAST_MPS2**2:
        return None
    both = complex(np.vdot(other[known], one[known]))
    alike = abs(both) ** 2
    pairs = 2.0 * (SLOW_HZ[1] - SLOW_HZ[0]) * count / rate_hz
    if own * others - alike > 2.0 * pairs * MAX_ERROR_RAD**2 * alike:
        return None
    return math.atan2(both.imag, both.real)
