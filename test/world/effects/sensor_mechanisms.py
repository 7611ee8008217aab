"""Mechanisms of the background in the sensors on the body; the sensor of the seat (0) is the input and exact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal

from world import sensors
from world.effects.effect import Person
from world.effects.event import HELD_HZ, Event, following
from world.effects.mechanism import Mechanism
from world.seats import RATE_HZ

if TYPE_CHECKING:
    from typing_extensions import Self

Floats = NDArray[np.float64]

COHERENT: Final = 0.08
"""Rms gain from the seat, 1 to 30 Hz."""

TAP_S, DECAY_S, COUNT = 1.0 / 225.0, 0.05, 56
"""Spacing of the random values of an impulse response, its decay, and their number: 0.25 s."""

NOISE_MPS2: Final = 0.2
NOISE_HZ: Final = (3.0, 40.0)
"""Noise in motion: movements of the person, and cables. A sixth of a road's vertical acceleration."""

LEAN_RAD: Final = 0.06
MOST_LEAN_RAD: Final = 0.25
SHAKEN_MPS2: Final = 2.0
"""Lean of a strapped sensor in strong vibration, its limit, and the vibration of three quarters of it."""

CROSS: Final = 0.04
"""Cross-axis sensitivity: data sheets of MEMS accelerometers state 1 to 2 %, a soft mounting doubles it."""

MOUNTING_HZ: Final = (40.0, 100.0)
"""Resonance of a strapped or taped sensor at scale 1; higher at lower scales, so that its error is proportional."""


@dataclass(frozen=True, eq=False)
class CoherentFilter(Mechanism):
    """A random FIR filter of the seat's vertical acceleration is added to every sensor: coherent with the input."""

    taps: Floats

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Taps (7, t) at `HELD_HZ`, zero for the seat."""
        coarse_s = np.arange(COUNT + 1) * TAP_S
        values = rng.standard_normal((7, COUNT + 1)) * np.exp(-coarse_s / DECAY_S)
        values[:, [0, -1]] = 0.0
        time_s = np.arange(round(coarse_s[-1] * HELD_HZ)) / HELD_HZ
        taps = interpolate.CubicSpline(coarse_s, values, axis=1)(time_s)
        response = np.exp(-2j * np.pi * np.linspace(1.0, 30.0, 60)[:, None] * time_s) @ taps.T
        gain = np.sqrt((np.abs(response) ** 2).mean(axis=0))
        size = scale * COHERENT * np.abs(rng.standard_normal(7))
        size[0] = 0.0
        return cls(taps * (size / gain)[:, None])

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Add the filtered motion of the seat to the vertical."""
        seat = event.accel_mps2[::2, 2]
        added = signal.oaconvolve(seat, self.taps[sensor])[: len(seat)]
        return accel_mps2 + np.column_stack([np.zeros((len(seat), 2)), added])


@dataclass(frozen=True, eq=False)
class ColouredNoise(Mechanism):
    """Noise in motion that does not follow the input, of another colour and size in every sensor."""

    rms_mps2: Floats
    corner_hz: Floats
    grain: int

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Sizes log-normal."""
        rms = scale * NOISE_MPS2 * np.exp(0.5 * rng.standard_normal(7))
        rms[0] = 0.0
        return cls(rms, np.exp(rng.uniform(*np.log(NOISE_HZ), 7)), int(rng.integers(2**31)))

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Add the noise to every axis."""
        if not self.rms_mps2[sensor]:
            return accel_mps2
        sos = signal.butter(2, self.corner_hz[sensor], fs=HELD_HZ, output="sos")
        noise = signal.sosfilt(sos, white(self.grain, sensor, event, accel_mps2.shape), axis=0)
        moving = event.moving[::2, None]
        return accel_mps2 + self.rms_mps2[sensor] * moving * noise / noise.std(axis=0)


@dataclass(frozen=True, eq=False)
class Mounting(Mechanism):
    """Every sensor leans while it is shaken, mixes its axes, and rings on its mounting (ISO 5348: resonance)."""

    lean_most_rad: Floats
    memory_s: Floats
    cross: Floats
    frequency_hz: Floats
    damping: Floats

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """lean_most_rad (7, 2) by roll and pitch; cross (7, 3, 3), zero on its diagonal."""
        lean = np.clip(scale * LEAN_RAD * rng.standard_normal((7, 2)), -MOST_LEAN_RAD, MOST_LEAN_RAD)
        cross = scale * CROSS * rng.standard_normal((7, 3, 3)) * (1.0 - np.eye(3))
        hz = rng.uniform(*MOUNTING_HZ, 7) / np.sqrt(scale)
        return cls(lean, rng.uniform(0.3, 2.0, 7), cross, hz, rng.uniform(0.2, 0.5, 7))

    def lean_rad(self, sensor: int, event: Event) -> Floats | None:
        """By the smoothed vertical acceleration of the seat."""
        if sensor == 0:
            return None
        decay = np.exp(-1.0 / (self.memory_s[sensor] * RATE_HZ))
        shaken = signal.lfilter([1.0 - decay], [1.0, -decay], np.abs(event.accel_mps2[:, 2]))
        return np.tanh(shaken / SHAKEN_MPS2)[:, None] * self.lean_most_rad[sensor]

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Through the mounting, then mixed; gravity is in neither, because sensors are levelled at rest."""
        if sensor == 0:
            return accel_mps2
        behind = following(self.frequency_hz[sensor], self.damping[sensor], HELD_HZ)
        through = signal.lfilter(*behind, accel_mps2, axis=0)
        return through + through @ self.cross[sensor].T


@dataclass(frozen=True, eq=False)
class SensorNoise(Mechanism):
    """White noise of all sensors, the seat's included, at rest and in motion, beyond `sensors.NOISE_MPS2`."""

    added_mps2: float
    grain: int

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """The noise of all sensors is about scale >= 1 times the typical noise."""
        added = sensors.NOISE_MPS2 * np.sqrt(max(scale**2 - 1.0, 0.0))
        return cls(float(added), int(rng.integers(2**31)))

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Add the noise to every axis."""
        return accel_mps2 + self.added_mps2 * white(self.grain, sensor, event, accel_mps2.shape)


def white(grain: int, sensor: int, event: Event, shape: tuple[int, ...]) -> Floats:
    """Noise of rms 1, the same whenever it is asked for the same sensor in the same event."""
    return np.random.default_rng([grain, round(1e3 * event.begin_s), sensor]).standard_normal(shape)
