"""Output of six IMUs on a person in an event; they rotate with their segments, and noise repeats with its seed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate

from world import sensors
from world.effects.background import Background
from world.effects.effect import Effect
from world.effects.event import HELD_HZ, Event

Floats = NDArray[np.float64]
Stream = tuple[NDArray[np.int64], Floats, Floats]
"""Stamps (n,) ns since the event began, specific force (n, 3) m/s^2 and angular velocity (n, 3) rad/s."""

GYRO_NOISE_RADPS: Final = 0.002
GYRO_BIAS_RADPS: Final = 0.003
GYRO_STEP_RADPS: Final = np.deg2rad(2000.0) / 2**15


def sensed(
    sensor: int, event: Event, up_mps2: Floats, effects: Sequence[Effect], background: Background
) -> tuple[Floats, Floats]:
    """Specific force (m, 3) and angular velocity (m, 3) at `HELD_HZ` in the axes of an upright, faultless sensor.

    up_mps2 (m,) is the vertical acceleration at the sensor: 0 is the seat, 1-6 are the segments.
    """
    accel = np.column_stack([event.aside_mps2(sensor)[::2], up_mps2])
    lean = event.leaning_rad(sensor)[::2]
    if sensor:
        accel = background.sensor_acceleration(sensor, accel)
        lean = lean + background.leaning_rad(sensor, event)[::2]
    for effect in effects:
        accel = effect.sensor_acceleration(sensor, event, accel)
        beyond = effect.lean_rad(sensor, event)
        lean = lean if beyond is None else lean + beyond[::2]
    force = accel + np.array([0.0, 0.0, sensors.GRAVITY_MPS2])
    (sin_roll, sin_pitch), (cos_roll, cos_pitch) = np.sin(lean).T, np.cos(lean).T
    roll_radps, pitch_radps = np.gradient(lean, 1.0 / HELD_HZ, axis=0).T
    spin = np.column_stack([roll_radps * cos_pitch, pitch_radps, roll_radps * sin_pitch])
    # First about the forward axis by roll, then about the left axis of the sensor, which has rolled, by pitch. SciPy's
    # rotations do the same in ten times the time.
    forward, left, up = force.T
    left, up = cos_roll * left + sin_roll * up, cos_roll * up - sin_roll * left
    forward, up = cos_pitch * forward - sin_pitch * up, sin_pitch * forward + cos_pitch * up
    return np.column_stack([forward, left, up]), spin


def stream(
    sensor: int,
    imu: sensors.Imu,
    event: Event,
    up_mps2: Floats,
    effects: Sequence[Effect],
    background: Background,
    rng: np.random.Generator,
) -> Stream:
    """Output of one sensor."""
    force, spin = sensed(sensor, event, up_mps2, effects, background)
    offset_s = sensors.OFFSET_S * rng.standard_normal()
    end_s = (len(force) - 1) / HELD_HZ
    own_s = np.arange(1, int((end_s - 0.02) * sensors.RATE_HZ)) / sensors.RATE_HZ + 0.01
    late_s = sum((effect.clock_late_s(sensor, event, own_s) for effect in effects), np.zeros(own_s.size))
    late_s = late_s + (background.late_s[sensor] if sensor else 0.0)
    true_s = np.clip((own_s - offset_s - late_s) / (1.0 + imu.drift), 0.0, end_s)
    sampled = interpolate.CubicSpline(np.arange(len(force)) / HELD_HZ, np.hstack([force, spin]))(true_s)
    reading = sampled[:, :3] @ imu.axes.T
    for effect in effects:
        reading = effect.reading(sensor, reading)
    reading = reading + imu.bias_mps2 + sensors.NOISE_MPS2 * rng.standard_normal(reading.shape)
    gyro = sampled[:, 3:] @ imu.axes.T + GYRO_BIAS_RADPS * rng.standard_normal(3)
    gyro = gyro + GYRO_NOISE_RADPS * rng.standard_normal(gyro.shape)
    stamps_s = np.sort(own_s + sensors.JITTER_S * rng.standard_normal(own_s.size))
    return (
        np.rint(stamps_s * 1e9).astype(np.int64),
        sensors.digits(reading),
        np.rint(gyro / GYRO_STEP_RADPS) * GYRO_STEP_RADPS,
    )
