"""Simulated IMUs with mounting tilt, bias, noise, 16-bit resolution and a separate clock each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

GRAVITY_MPS2: Final = 9.80665
RATE_HZ: Final = 1129.3
FULL_SCALE_MPS2: Final = 16.0 * GRAVITY_MPS2
TILT_DEG: Final = 12.0
"""Largest angle between a sensor's third axis and the vertical; the rotation about that axis is uniform."""

BIAS_MPS2: Final = 0.05
NOISE_MPS2: Final = 0.05
OFFSET_S: Final = 0.0002
DRIFT: Final = 20e-6
JITTER_S: Final = 0.00002
"""All rms. Clocks are set once before each event, to `OFFSET_S`; a mounting, a bias and a crystal stay as they are."""


@dataclass(frozen=True, eq=False)
class Imu:
    """One sensor on one person for a day: its axes as rows (3, 3), bias (3,) m/s^2, and drift of its clock."""

    axes: Floats
    bias_mps2: Floats
    drift: float

    def stream(self, truth: Floats, truth_rate_hz: float, rng: np.random.Generator) -> tuple[Integers, Floats]:
        """Stamps (n,) ns and specific force (n, 3) for accelerations (m, 3) forward, left, up, without gravity."""
        offset_s = OFFSET_S * rng.standard_normal()
        end_s = (len(truth) - 1) / truth_rate_hz
        own_s = np.arange(1, int((end_s - 0.01) * RATE_HZ)) / RATE_HZ + 0.004
        true_s = (own_s - offset_s) / (1.0 + self.drift)
        motion = interpolate.CubicSpline(np.arange(len(truth)) / truth_rate_hz, truth)(true_s)
        force = (motion + np.array([0.0, 0.0, GRAVITY_MPS2])) @ self.axes.T
        reading = force + self.bias_mps2 + NOISE_MPS2 * rng.standard_normal(force.shape)
        stamps_s = np.sort(own_s + JITTER_S * rng.standard_normal(own_s.size))
        return np.rint(stamps_s * 1e9).astype(np.int64), digits(reading)


def drawn(rng: np.random.Generator) -> Imu:
    """A sensor with random mounting, bias and clock drift."""
    about = rng.uniform(0.0, 2.0 * np.pi)
    lean = np.deg2rad(rng.uniform(0.0, TILT_DEG)) * np.array([np.cos(about), np.sin(about), 0.0])
    turned = Rotation.from_rotvec([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)])
    axes = (turned * Rotation.from_rotvec(lean)).as_matrix()
    return Imu(axes, BIAS_MPS2 * rng.standard_normal(3), DRIFT * rng.standard_normal())


def digits(force_mps2: Floats) -> Floats:
    """Sixteen bits over the full scale, which clips."""
    step = FULL_SCALE_MPS2 / 2**15
    return np.clip(np.rint(force_mps2 / step), -(2**15), 2**15 - 1) * step
