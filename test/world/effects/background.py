"""Background misfit that follows the input: joints, masses and sensors differ slightly from those of the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world.effects.effect import Person
from world.effects.event import HELD_HZ, Event

Floats = NDArray[np.float64]

MASS: Final = 0.06
STRETCHED: Final = 0.10
"""Rms share of the linear force that each law adds far beyond a joint's reach, and half of it there."""

GAIN: Final = 0.012
LATE_S: Final = 0.00025
LEAN_RAD: Final = 0.02
SKIN_HZ: Final = (250.0, 500.0)
"""Rms, at level 1, for every sensor; skins are poles of first order, and farther off at lower levels."""


@dataclass(frozen=True, eq=False)
class Background:
    """Laws of the joints and factors of the masses (6,), and errors of the sensors (7,) by `ride.SENSORS`.

    F = k s (bent u + cubic u^2) / (1 + u^2) + b v squared w / (1 + w) + friction v / sqrt(v^2 + w0^2), u = s / reach_m,
    w = |v| / speed_mps, w0 = 0.15 speed_mps: bounded shares, so that no joint turns unstable far out. skin_hz may be
    infinite; lean_rad is there in motion only.
    """

    mass: Floats
    bent: Floats
    cubic: Floats
    squared: Floats
    friction_n: Floats
    reach_m: Floats
    speed_mps: Floats
    gain: Floats
    late_s: Floats
    lean_rad: Floats
    skin_hz: Floats

    def sensor_acceleration(self, sensor: int, accel_mps2: Floats) -> Floats:
        """Acceleration of a sensor for accelerations (n, 3) of its segment."""
        through = (1.0 + self.gain[sensor]) * accel_mps2
        if np.isinf(self.skin_hz[sensor]):
            return through
        w = 2.0 * np.pi * self.skin_hz[sensor]
        return signal.lfilter(*signal.bilinear([w], [1.0, w], HELD_HZ), through, axis=0)

    def leaning_rad(self, sensor: int, event: Event) -> Floats:
        """Roll and pitch of a sensor beyond its segment's, (n, 2)."""
        return self.lean_rad[sensor] * event.moving[:, None]


NOTHING: Final = Background(
    mass=np.ones(6),
    bent=np.zeros(6),
    cubic=np.zeros(6),
    squared=np.zeros(6),
    friction_n=np.zeros(6),
    reach_m=np.ones(6),
    speed_mps=np.ones(6),
    gain=np.zeros(7),
    late_s=np.zeros(7),
    lean_rad=np.zeros((7, 2)),
    skin_hz=np.full(7, np.inf),
)


def drawn(person: Person, level: float, rng: np.random.Generator) -> Background:
    """A background of a level, 1 being the paper's own; the laws are scaled by how far this person's joints go."""

    def some(size: int | tuple[int, ...], rms: float) -> Floats:
        return level * rms * rng.standard_normal(size)

    rate = person.rate_mps
    return Background(
        mass=np.exp(some(6, MASS)),
        bent=some(6, STRETCHED),
        cubic=some(6, STRETCHED),
        squared=some(6, STRETCHED),
        friction_n=np.abs(some(6, STRETCHED)) * person.damping_ns_per_m * rate,
        reach_m=person.reach_m,
        speed_mps=2.0 * rate,
        gain=some(7, GAIN),
        late_s=some(7, LATE_S),
        lean_rad=some((7, 2), LEAN_RAD),
        skin_hz=rng.uniform(*SKIN_HZ, 7) / level if level else np.full(7, np.inf),
    )
