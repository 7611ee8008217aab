"""Synthesis: seat motions of the paper's load cases, and the six IMU streams of a subject for one of them.

For demos, players and tests of the software. The truth is this package's own model, so a small residual on such a
recording proves nothing about the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.base.suggestions import known_are
from biodyn_core.body.model import predict
from biodyn_core.body.subject import Subject
from biodyn_core.body.synthesis_settings import CASES, NATIVE_RATE_HZ, SensorSettings
from biodyn_core.effects import apply_to_sensors

MOTION_S: Final = (2.0, 3600.0)
"""Shortest motion, and longest drawn case."""

TRUTH_RATE_HZ: Final = 4.0 * NATIVE_RATE_HZ
FADE_S: Final = 0.25
"""Duration of the change between rest and motion."""

MARGIN_S: Final = 0.1
"""Truth beyond both ends, for sensors with fast or slow clocks."""


@dataclass(frozen=True)
class SeatMotion:
    """Motion of the seat: accel_mps2 (n, 3) forward, left, up, no gravity; pitch_rate_radps (n,), nose down."""

    rate_hz: float
    accel_mps2: Floats
    pitch_rate_radps: Floats

    @property
    def seconds(self) -> float:
        """Length of the motion."""
        return len(self.accel_mps2) / self.rate_hz

    def first(self, seconds: float | None) -> SeatMotion:
        """The first `seconds` of it, or all; raises InputError for less than MOTION_S[0]."""
        if seconds is not None and not seconds >= MOTION_S[0]:
            raise InputError(f"{seconds:g} s of a motion are not used, at least {MOTION_S[0]:g} s are needed")
        end = None if seconds is None else round(min(seconds, self.seconds) * self.rate_hz)
        return SeatMotion(self.rate_hz, self.accel_mps2[:end], self.pitch_rate_radps[:end])

    def from_rest(self) -> SeatMotion:
        """The whole motion between two additions of FADE_S, in which its end values rise from zero and return to it.

        The additions keep a record that begins or ends in motion from becoming a step, which excites all frequencies.
        """
        rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(round(FADE_S * self.rate_hz)) / round(FADE_S * self.rate_hz))
        state = np.column_stack([self.accel_mps2, self.pitch_rate_radps])
        state = np.concatenate([rise[:, None] * state[0], state, rise[::-1, None] * state[-1]])
        return SeatMotion(self.rate_hz, state[:, :3], state[:, 3])


@dataclass(frozen=True)
class ImuStream:
    """Data of one sensor: stamps_ns (n,), specific force (n, 3) m/s^2, angular velocity (n, 3) rad/s."""

    sensor: str
    stamps_ns: Integers
    accel_mps2: Floats
    gyro_radps: Floats


def load_case(name: str, seconds: float, rng: np.random.Generator, rate_hz: float = TRUTH_RATE_HZ) -> SeatMotion:
    """Draw a seat motion of one of the paper's load cases (5.3): road, pothole (1-3 g) or rail (3-8 g).

    It contains fore-aft, lateral and pitch motion too. Raises InputError for an unknown case or less than two seconds.
    """
    if name not in _CASES:
        raise InputError(f"case {name!r} is unknown, {known_are(name, _CASES)}")
    if not MOTION_S[0] <= seconds <= MOTION_S[1]:
        raise InputError(f"a case of {seconds:g} s is not made, {MOTION_S[0]:g} to {MOTION_S[1]:g} s are allowed")
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    up = _CASES[name](time, rate_hz, rng)
    forward = 0.3 * _delayed(up, 0.03, rate_hz) + 0.15 * _shaped_noise(time, rate_hz, rng, 3.0)
    left = 0.15 * _shaped_noise(time, rate_hz, rng, 3.0)
    # The axles pass a bump one after the other, which pitches the vehicle: about 0.02 rad/s per m/s^2 below 5 Hz.
    slow = scipy.signal.sosfiltfilt(scipy.signal.butter(2, 5.0, fs=rate_hz, output="sos"), _delayed(up, 0.05, rate_hz))
    fade = _fade(time, seconds)
    return SeatMotion(rate_hz, np.column_stack([forward, left, up]) * fade[:, None], 0.02 * slow * fade)


def imu_streams(
    subject: Subject, motion: SeatMotion, rng: np.random.Generator, sensors: SensorSettings | None = None,
    start_ns: int = 0, quiet_s: float = 1.0,
) -> list[ImuStream]:  # fmt: skip
    """Streams of six IMUs on a subject for a seat motion, with `quiet_s` of rest before and after it.

    A measured motion needs `from_rest` first; drawn cases begin and end at rest.
    """
    settings = sensors or SensorSettings()
    time, accel, pitch = _with_quiet(motion, quiet_s)
    channels = _channels(accel, pitch)
    segments = predict(subject, accel[:, 2], TRUTH_RATE_HZ, channels).accel_mps2
    segments = apply_to_sensors(subject.effects, segments, TRUTH_RATE_HZ, channels)
    streams = []
    for name in SENSORS:
        up = accel[:, 2] if name == SEAT else segments[:, SEGMENTS.index(name)]
        truth = scipy.interpolate.CubicSpline(time, np.column_stack([accel[:, :2], up, pitch]), axis=0)
        streams.append(_sensor(name, truth, float(time[-1]), settings, rng, start_ns))
    return streams


def _channels(accel_mps2: Floats, pitch_rate_radps: Floats) -> dict[str, Floats]:
    """Further inputs of effects: all sensors move fore-aft, sideways and in pitch as the seat, so no joint bends."""
    none = np.zeros_like(pitch_rate_radps)
    motion = {
        "x": accel_mps2[:, 0], "y": accel_mps2[:, 1], "rate_x": none, "rate_y": pitch_rate_radps, "rate_z": none,
        "bend_rate_x": none, "bend_rate_y": none,
    }  # fmt: skip
    return {f"{sensor}.{name}": values for sensor in SENSORS for name, values in motion.items()}


def _sensor(
    name: str,
    truth: Callable[[Floats], Floats],
    end_s: float,
    settings: SensorSettings,
    rng: np.random.Generator,
    start_ns: int,
) -> ImuStream:
    """One sensor with its errors of clock, mounting and electronics."""
    count = int((end_s - 2.0 * MARGIN_S) * settings.rate_hz)
    own_s = MARGIN_S + np.arange(count) / settings.rate_hz
    drift, offset_s = (
        1e-6 * settings.clock_drift_ppm * rng.standard_normal(),
        1e-3 * settings.clock_offset_ms * rng.standard_normal(),
    )
    state = truth((own_s - offset_s) / (1.0 + drift))
    tilt_deg = settings.tilt_deg * rng.standard_normal(3)
    mounting = scipy.spatial.transform.Rotation.from_euler("xyz", tilt_deg, degrees=True).as_matrix()
    force = state[:, :3] + [0.0, 0.0, STANDARD_GRAVITY_MPS2]
    spin = np.zeros((count, 3))
    spin[:, 1] = state[:, 3]
    bias = settings.bias_mps2 * rng.standard_normal(3)
    accel = force @ mounting + bias + settings.noise_mps2 * rng.standard_normal((count, 3))
    gyro = spin @ mounting + settings.gyro_noise_radps * rng.standard_normal((count, 3))
    jitter_s = 1e-3 * settings.jitter_ms * rng.standard_normal(count)
    stamps_s = np.maximum.accumulate(own_s + jitter_s)
    return ImuStream(
        name,
        start_ns + np.rint(stamps_s * 1e9).astype(np.int64),
        _sixteen_bits(accel, settings.range_g * STANDARD_GRAVITY_MPS2),
        _sixteen_bits(gyro, np.deg2rad(2000.0)),
    )


def _sixteen_bits(values: Floats, full_scale: float) -> Floats:
    step = full_scale / 32768.0
    digits: Floats = np.clip(np.rint(values / step), -32768.0, 32767.0)
    return digits * step


def _with_quiet(motion: SeatMotion, quiet_s: float) -> tuple[Floats, Floats, Floats]:
    """Time, acceleration (n, 3) and pitch rate (n,) at the truth's rate, with rest on both sides."""
    edge = np.zeros((round((quiet_s + MARGIN_S) * TRUTH_RATE_HZ), 4))
    state = np.column_stack([motion.accel_mps2, motion.pitch_rate_radps])
    if motion.rate_hz != TRUTH_RATE_HZ:
        old = np.arange(len(state)) / motion.rate_hz
        new = np.arange(int(old[-1] * TRUTH_RATE_HZ)) / TRUTH_RATE_HZ
        state = scipy.interpolate.CubicSpline(old, state, axis=0)(new)
    state = np.concatenate([edge, state, edge])
    return np.arange(len(state)) / TRUTH_RATE_HZ, state[:, :3], state[:, 3]


def _road(time: Floats, rate_hz: float, rng: np.random.Generator) -> Floats:
    """Continuous roughness: body bounce at 1.4 Hz, wheel hop at 11 Hz and a broad floor, 1.3 m/s^2 rms."""
    mix = _resonance(1.4, 0.3, time, rate_hz, rng) + 0.8 * _resonance(11.0, 0.2, time, rate_hz, rng)
    mix = mix + 0.35 * _shaped_noise(time, rate_hz, rng, 40.0)
    return 1.3 * mix / mix.std()


def _pothole(time: Floats, rate_hz: float, rng: np.random.Generator) -> Floats:
    """A drop and an impact of 1 to 3 g every few seconds, ringing at wheel hop, on a smoother road."""
    up = 0.3 * _road(time, rate_hz, rng)
    begin = 0.5
    while begin < time[-1] - 0.8:
        peak = STANDARD_GRAVITY_MPS2 * rng.uniform(1.0, 3.0)
        up = up + _impact(time - begin, peak, rng.uniform(9.0, 13.0), 0.09)
        begin += rng.uniform(2.0, 3.5)
    return up


def _rail(time: Floats, rate_hz: float, rng: np.random.Generator) -> Floats:
    """Two rails under two axles: four sharp impacts of 3 to 8 g, every few seconds, on a smoother road."""
    up = 0.3 * _road(time, rate_hz, rng)
    begin = 0.5
    while begin < time[-1] - 1.0:
        strongest = STANDARD_GRAVITY_MPS2 * rng.uniform(3.0, 8.0)
        for late, share in ((0.0, 1.0), (0.13, 0.8), (0.35, 0.9), (0.48, 0.7)):
            up = up + _impact(time - begin - late, share * strongest, rng.uniform(22.0, 32.0), 0.025)
        begin += rng.uniform(2.5, 4.0)
    return up


_CASES: Final[dict[str, Callable[[Floats, float, np.random.Generator], Floats]]] = dict(
    zip(CASES, (_road, _pothole, _rail), strict=True)
)


def _impact(since_s: Floats, peak_mps2: float, frequency_hz: float, decay_s: float) -> Floats:
    """A smooth burst that starts from rest, down first, with its largest absolute value at `peak_mps2`."""
    s = np.maximum(since_s, 0.0)
    shape = -np.sin(2.0 * np.pi * frequency_hz * s) * (s / decay_s) * np.exp(-s / decay_s)
    largest = np.abs(shape).max()
    return shape * (peak_mps2 / largest) if largest > 0.0 else shape


def _resonance(frequency_hz: float, zeta: float, time: Floats, rate_hz: float, rng: np.random.Generator) -> Floats:
    omega = 2.0 * np.pi * frequency_hz
    system = scipy.signal.bilinear([2.0 * zeta * omega, 0.0], [1.0, 2.0 * zeta * omega, omega**2], rate_hz)
    ringing: Floats = scipy.signal.lfilter(*system, rng.standard_normal(time.size))
    return ringing / ringing.std()


def _shaped_noise(time: Floats, rate_hz: float, rng: np.random.Generator, top_hz: float) -> Floats:
    """White noise between 0.5 Hz and `top_hz`, unit rms."""
    sos = scipy.signal.butter(2, [0.5, top_hz], "bandpass", fs=rate_hz, output="sos")
    noise: Floats = scipy.signal.sosfilt(sos, rng.standard_normal(time.size))
    return noise / noise.std()


def _delayed(values: Floats, seconds: float, rate_hz: float) -> Floats:
    shift = round(seconds * rate_hz)
    return np.concatenate([np.zeros(shift), values[: values.size - shift]])


def _fade(time: Floats, seconds: float) -> Floats:
    """Rise from 0 to 1 and back over FADE_S at both ends, so that rest turns into motion smoothly."""
    edge = np.minimum(time, seconds - time) / FADE_S
    fade: Floats = 0.5 - 0.5 * np.cos(np.pi * np.clip(edge, 0.0, 1.0))
    return fade


def joined(motions: list[SeatMotion]) -> SeatMotion:
    """Motions of one rate, one after the other; each begins and ends at rest."""
    return SeatMotion(
        motions[0].rate_hz,
        np.concatenate([motion.accel_mps2 for motion in motions]),
        np.concatenate([motion.pitch_rate_radps for motion in motions]),
    )
