"""Heading: how far sensors on the body are turned about the vertical from the seat's, by how all of them move sideways.

A sensor is mounted at any heading, and nothing that it reads at rest tells which. But slowly a person goes sideways as
the seat does, and every segment as the one below: what two neighbours feel then is one motion in two frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy import signal

from biodyn_core.base.arrays import Complexes, Floats
from biodyn_core.base.segments import SEAT, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.channels import Channels

SLOW_HZ: Final = (0.2, 3.0)
"""Below lie levels and the drift of gyros; above, segments sway by themselves."""

LEAST_MPS2: Final = 0.05
"""Less slow motion than this, rms, may be leaked from the vertical: some hundredths of it, by axes not quite square."""

SURE_RAD: Final = 0.15
"""A heading that is less sure than this from one neighbour to the next, 9 deg rms, is none."""

MEETING: Final = {"neck": "upper_torso", "head": "neck"}
"""Measured segments whose joint bends between two gyros, with the one below."""


def headings_rad(channels: Mapping[str, Channels], rate_hz: float) -> dict[str, float]:
    """How far each sensor on the body is turned to the left of the seat's, -pi to pi; those that can be told.

    Each is told by the next one below that has a heading.
    """
    if SEAT not in channels:
        return {}
    below, found = SEAT, {SEAT: 0.0}
    slow = {name: _slow(channels[name], rate_hz) for name in SENSORS}
    for name in SENSORS[1:]:
        between = _turn_rad(slow[below], slow[name], rate_hz)
        if between is not None:
            found[name] = math.remainder(found[below] + between, 2.0 * math.pi)
            below = name
    return {name: angle for name, angle in found.items() if name != SEAT}


def bend_rates_radps(channels: Mapping[str, Channels], headings: Mapping[str, float]) -> dict[str, Floats]:
    """How fast the joints of `MEETING` bend about the seat's x and y, (n,) each, such as `neck.bend_rate_y`.

    Only where both segments have a gyro and a heading; NaN where either is masked.
    """
    turning = {}
    for name, angle in headings.items():
        rates = channels[name].rates_radps
        if rates is not None:
            turning[name] = np.exp(1j * angle) * (rates[:, 0] + 1j * rates[:, 1])
    found: dict[str, Floats] = {}
    for upper, lower in MEETING.items():
        if {upper, lower} <= turning.keys():
            bend = turning[upper] - turning[lower]
            found |= {f"{upper}.bend_rate_x": bend.real, f"{upper}.bend_rate_y": bend.imag}
    return found


def _slow(channels: Channels, rate_hz: float) -> Complexes:
    """What is slow of the motion along x and y, x + iy, (n,); NaN where masked.

    A gyro tells how the sensor tilts, and so what of it is gravity: a head that nods feels more of that than of motion.
    """
    masked = np.isnan(channels.horizontal_mps2).any(axis=1)
    felt = np.where(masked, 0.0, channels.horizontal_mps2[:, 0] + 1j * channels.horizontal_mps2[:, 1])
    if channels.rates_radps is not None:
        x, y, _ = np.nan_to_num(channels.rates_radps).T
        felt = felt + STANDARD_GRAVITY_MPS2 / rate_hz * np.cumsum(y - 1j * x)
    passed = signal.butter(2, SLOW_HZ, "bandpass", fs=rate_hz, output="sos")
    slow = signal.sosfiltfilt(passed, felt.real) + 1j * signal.sosfiltfilt(passed, felt.imag)
    return np.where(masked, np.nan, slow)


def _turn_rad(one: Complexes, other: Complexes, rate_hz: float) -> float | None:
    """How far the frame of the other is turned to the left of the one's, (n,) each; None where nobody can tell.

    The turn that fits best (Procrustes). Its error is that of so many independent pairs, two numbers each.
    """
    known = ~np.isnan(one + other)
    count = np.count_nonzero(known)
    own, others = (float(np.vdot(slow[known], slow[known]).real) for slow in (one, other))
    if not min(own, others) > count * LEAST_MPS2**2:
        return None
    both = complex(np.vdot(other[known], one[known]))
    alike = abs(both) ** 2
    pairs = 2.0 * (SLOW_HZ[1] - SLOW_HZ[0]) * count / rate_hz
    if own * others - alike > 2.0 * pairs * SURE_RAD**2 * alike:
        return None
    return math.atan2(both.imag, both.real)
