"""One event as it happens to a person: the seat's motion and rotation, and how the segments sway and nod with it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world import seats
from world.seats import RATE_HZ, Case, Motion, Origin

Floats = NDArray[np.float64]

HELD_HZ: Final = 0.5 * RATE_HZ
"""At which the bodies' answers are kept and sensors feel them."""

REST_S: Final = (2.5, 1.5)
"""At rest before and after."""

ANGLE_RAD: Final = (0.004, 0.012)
"""Rms roll and pitch of a seat on the road: 0.2 to 0.7 degrees."""

SWAY_HZ: Final = np.array([0.0, 9.0, 7.0, 5.5, 4.5, 4.0, 3.5])
"""Above which segments no longer follow the seat sideways, from the seat (which does) to the head."""

SWAY_DAMPING: Final = 0.35
NOD_RAD_PER_MPS2: Final = np.array([0.0, 0.004, 0.007, 0.010, 0.015, 0.030, 0.060])
"""Lean of segments per sideways acceleration."""

PEAK_HZ: Final = 100.0
"""Below which the peak of an event counts: rails have more above, which no body follows."""

FARTHEST_RAD: Final = np.array([0.5, 0.15, 0.2, 0.25, 0.3, 0.4, 0.6])
"""How far they can lean: the spine and the neck end there."""


@dataclass(frozen=True, eq=False)
class Event:
    """A seat's accelerations (n, 3) forward, left, up and roll and pitch (n, 2) at `RATE_HZ`, from rest to rest.

    begin_s: when it begins, since the first of the sitting did; whole_s: how long the sitting takes. motion_s: how
    long it moves after `REST_S[0]`. sway: how much slower or faster this person sways than `SWAY_HZ` says.
    """

    case: Case
    origin: str
    begin_s: float
    accel_mps2: Floats
    angle_rad: Floats
    motion_s: float
    sway: float = 1.0
    whole_s: float = 600.0

    @property
    def time_s(self) -> Floats:
        """Since it began, (n,)."""
        return np.arange(len(self.accel_mps2)) / RATE_HZ

    @property
    def moving(self) -> Floats:
        """0 at rest, 1 in motion, (n,), with the edges of the motion."""
        whole = np.zeros(len(self.accel_mps2))
        begin, count = round(REST_S[0] * RATE_HZ), round(self.motion_s * RATE_HZ)
        whole[begin : begin + count] = seats.edges(count, RATE_HZ)
        return whole

    @property
    def peak_mps2(self) -> float:
        """The largest vertical acceleration of the seat below `PEAK_HZ`, either way."""
        below = signal.sosfiltfilt(signal.butter(4, PEAK_HZ, fs=RATE_HZ, output="sos"), self.accel_mps2[:, 2])
        return float(np.abs(below).max())

    def cut(self, seconds: float) -> Event:
        """The event up to so many seconds of motion."""
        kept = min(seconds, self.motion_s)
        count = round((REST_S[0] + kept) * RATE_HZ)
        return dataclasses.replace(
            self, accel_mps2=self.accel_mps2[:count], angle_rad=self.angle_rad[:count], motion_s=kept
        )

    def at_level(self, level: float) -> Event:
        """The event with so many times the motion."""
        return dataclasses.replace(self, accel_mps2=level * self.accel_mps2, angle_rad=level * self.angle_rad)

    def aside_mps2(self, sensor: int) -> Floats:
        """Forward and left accelerations of the seat (0) or a segment (1-6), (n, 2): a resonance each."""
        sideways = self.accel_mps2[:, :2]
        if sensor == 0:
            return sideways
        top, bottom = following(float(SWAY_HZ[sensor]) * self.sway, SWAY_DAMPING, RATE_HZ)
        return signal.lfilter(top, bottom, sideways, axis=0)

    def leaning_rad(self, sensor: int) -> Floats:
        """Roll and pitch of the seat or a segment, (n, 2): of the seat, and a part from horizontal acceleration."""
        forward, left = self.aside_mps2(sensor).T
        angle = NOD_RAD_PER_MPS2[sensor] * np.column_stack([-left, forward]) / FARTHEST_RAD[sensor]
        return self.angle_rad + FARTHEST_RAD[sensor] * angle / np.sqrt(1.0 + angle**2)

    def spin_radps(self, sensor: int) -> Floats:
        """Rates of roll and pitch, (n, 2)."""
        return np.gradient(self.leaning_rad(sensor), 1.0 / RATE_HZ, axis=0)


# Cached, because every sensor needs it in every event, and SciPy takes 1.6 ms for it.
@cache
def following(frequency_hz: float, damping: float, rate_hz: float) -> tuple[Floats, Floats]:
    """A mass behind a spring and a damper, as a digital filter."""
    w = 2.0 * np.pi * frequency_hz
    loss = 2.0 * damping * w
    top, bottom = signal.bilinear([loss, w * w], [1.0, loss, w * w], rate_hz)
    return top, bottom


def drawn(case: Case, origin: Origin, seconds: float, begin_s: float, sway: float, rng: np.random.Generator) -> Event:
    """An event of a case, `seconds` of motion between two rests."""
    motion = seats.motion(case, origin, seconds, rng)
    before, after = (np.zeros((round(s * RATE_HZ), 3)) for s in REST_S)
    accel = np.concatenate([before, motion.accel_mps2, after])
    angle = np.concatenate([before[:, :2], _rocking(motion, rng), after[:, :2]])
    return Event(case, motion.origin, begin_s, accel, angle, seconds, sway)


def _rocking(motion: Motion, rng: np.random.Generator) -> Floats:
    """Roll and pitch (n, 2), 0.6 to 5 Hz, half of it with the vertical and half of its own."""
    sos = signal.butter(2, [0.6, 5.0], "bandpass", fs=RATE_HZ, output="sos")
    count = len(motion.accel_mps2)
    own = signal.sosfilt(sos, rng.standard_normal((count, 2)), axis=0)
    shared = signal.sosfilt(sos, motion.accel_mps2[:, 2])[:, None]
    angle = own / own.std(axis=0) + shared / shared.std() * rng.choice((-0.7, 0.7), 2)
    window = seats.edges(count, RATE_HZ)[:, None]
    return window * angle / angle.std(axis=0) * rng.uniform(*ANGLE_RAD, 2)
