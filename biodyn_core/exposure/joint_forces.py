"""Joint forces: peaks and rms of the force that the model predicts in each joint.

A force is vertical, dynamic, and positive in compression: the joint pushes the body above it upwards. The static weight
of the body above is not in it (`static_n` of `joint_weights`). It scales with the assumed mass of the body, and was
never compared with a force measured in people.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.exposure.meters import Meter
from biodyn_core.exposure.tally import Tally

JOINT_NAMES: Final[Mapping[str, str]] = {
    "pelvis": "seat to pelvis",
    "lower_torso": "pelvis to lower torso (lumbar)",
    "central_torso": "lower to central torso",
    "upper_torso": "central to upper torso",
    "neck": "upper torso to neck",
    "head": "neck to head",
}
"""The joint below each segment."""


@dataclass(frozen=True)
class JointForce:
    """The force in one joint, N: largest compression and tension (0 if there was none), rms, and seconds counted."""

    compression_n: float
    tension_n: float
    rms_n: float
    seconds: float


class JointForceMeter(Meter[tuple[JointForce, ...]]):
    """Peaks and rms of the force in each joint: `push` blocks (n, c) of N, compression positive; NaN is missing."""

    _count = 1

    def __init__(self, rate_hz: float, channels: int, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._tally = Tally(rate_hz, channels, 4, 2, window_s)

    def push(self, force_n: Floats, suspect: bool = False) -> None:
        """Count a block."""
        t = self._counting(len(force_n), suspect)
        kernels.peak_forces(force_n, t.bin, t.total, t.ring, t.position, t.length)

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        self._skip(seconds)

    def _figures(self, rows: Floats, rolling: bool) -> tuple[JointForce, ...]:
        return tuple(
            JointForce(compression, tension, math.sqrt(square / max(count, 1.0)), count / self._rate_hz)
            for square, count, compression, tension in rows.tolist()
        )


def joint_weights(segment_mass_kg: Floats) -> dict[str, float]:
    """The weight of the body above each joint, N, from the masses of the segments (6,) with all that hangs on them."""
    carried_kg = np.cumsum(segment_mass_kg[::-1])[::-1]
    return dict(zip(SEGMENTS, (STANDARD_GRAVITY_MPS2 * carried_kg).tolist(), strict=True))
