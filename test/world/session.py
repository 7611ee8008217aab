"""Sessions: drives of many minutes with a list of planted shocks, trains of shocks, steady stretches and standstills.

All roads are simulated: the shocks of a recorded road are in no list.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world.seats import GRAVITY_MPS2, RATE_HZ, companions, quarter_car, road

Floats = NDArray[np.float64]
Kind = Literal["pothole", "rail", "road", "standstill"]

ROAD_RMS_MPS2: Final = (0.25, 0.9)
"""A shock of 0.8 g stands out of such a road; on a rougher one it is not a shock."""

PEAKS_G: Final = {"pothole": (0.4, 3.0), "rail": (0.6, 8.0)}
LEAST_G: Final = 0.8
"""Planted shocks below it are no events."""

IDLE_MPS2: Final = 0.12
BETWEEN_S: Final = (0.3, 40.0)
LOW_PASS_HZ: Final = 100.0
"""The peak of a shock is that of the motion below it, as the model's input has."""


@dataclass(frozen=True)
class Planted:
    """A part of a session; a shock or a train has the time and the size of its peak."""

    kind: Kind
    begin_s: float
    end_s: float
    peak_s: float = 0.0
    peak_g: float = 0.0


@dataclass(frozen=True, eq=False)
class SessionMotion:
    """A seat over a session, accelerations (n, 3) forward, left, up at `RATE_HZ`, and what was planted, in order."""

    accel_mps2: Floats
    planted: tuple[Planted, ...]

    @property
    def shocks(self) -> list[Planted]:
        """Shocks and trains of at least `LEAST_G`."""
        return [one for one in self.planted if one.peak_g >= LEAST_G]


def session(minutes: float, rng: np.random.Generator) -> SessionMotion:
    """A session: it begins at rest, then drives and standstills alternate."""
    parts: list[Floats] = []
    planted: list[Planted] = []
    at_s = 0.0
    while at_s < 60.0 * minutes:
        still_s = rng.uniform(5.0, 40.0)
        parts.append(_standstill(still_s, rng, idling=bool(parts) and rng.uniform() < 0.5))
        planted.append(Planted("standstill", at_s, at_s + still_s))
        at_s += still_s
        up, of_drive = _drive(rng.uniform(60.0, 400.0), rng)
        parts.append(np.column_stack([*companions(up, rng), up]))
        planted += [
            Planted(one.kind, at_s + one.begin_s, at_s + one.end_s, at_s + one.peak_s, one.peak_g) for one in of_drive
        ]
        at_s += len(up) / RATE_HZ
    return SessionMotion(np.concatenate(parts), tuple(planted))


def _standstill(seconds: float, rng: np.random.Generator, idling: bool) -> Floats:
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    shake = np.zeros((time_s.size, 3))
    if idling:
        # Two cylinders fire at each turn of the crankshaft: 24 to 30 Hz, and the double.
        phase = 2.0 * np.pi * rng.uniform(24.0, 30.0) * time_s
        shake[:, 2] = IDLE_MPS2 * np.sqrt(2.0) * (np.sin(phase) + 0.3 * np.sin(2.0 * phase + rng.uniform(0.0, 6.0)))
    return shake


def _drive(seconds: float, rng: np.random.Generator) -> tuple[Floats, list[Planted]]:
    """A road (n,) whose level changes, with shocks, and what was planted."""
    count = round(seconds * RATE_HZ)
    time_s = np.arange(count) / RATE_HZ
    knots_s = np.arange(0.0, seconds + 30.0, 25.0)
    level = np.interp(time_s, knots_s, rng.uniform(*ROAD_RMS_MPS2, knots_s.size))
    frequency_hz = np.fft.rfftfreq(count, 1.0 / RATE_HZ)
    up = road(frequency_hz, quarter_car(frequency_hz, rng.uniform(9.5, 12.5)), count, rng) * level
    sos = signal.butter(4, LOW_PASS_HZ, fs=RATE_HZ, output="sos")
    found: list[Planted] = []
    at_s = rng.uniform(4.0, 20.0)
    while at_s < seconds - 6.0:
        kind: Kind = "rail" if rng.uniform() < 0.4 else "pothole"
        shape = _crossing(time_s, at_s, rng) if kind == "rail" else _hole(time_s, at_s, rng)
        up += shape * np.exp(rng.uniform(*np.log(PEAKS_G[kind]))) * GRAVITY_MPS2 / np.abs(shape).max()
        here = slice(round((at_s - 1.0) * RATE_HZ), round((at_s + 2.5) * RATE_HZ))
        size = np.abs(signal.sosfiltfilt(sos, up[here]))
        peak = int(size.argmax())
        felt = np.flatnonzero(size >= 0.3 * size[peak])
        begin_s, end_s, peak_s = (at_s - 1.0 + index / RATE_HZ for index in (felt[0], felt[-1], peak))
        found.append(Planted(kind, begin_s, end_s, peak_s, float(size[peak]) / GRAVITY_MPS2))
        at_s += 1.5 + np.exp(rng.uniform(*np.log(BETWEEN_S)))
    edge = round(1.0 * RATE_HZ)
    rise = np.sin(0.5 * np.pi * np.arange(edge) / edge) ** 2
    up[:edge] *= rise
    up[-edge:] *= rise[::-1]
    edges = [0.0, *(t for one in found for t in (one.begin_s, one.end_s)), seconds]
    steady = [Planted("road", a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 0.0]
    return up, sorted([*found, *steady], key=lambda one: one.begin_s)


def _hole(time_s: Floats, at_s: float, rng: np.random.Generator) -> Floats:
    """A hole of 0.6 to 1.2 m under one axle and the next, through a quarter car (n,)."""
    near = (time_s >= at_s - 1.0) & (time_s < at_s + 3.0)
    local_s = time_s[near] - at_s
    speed_mps, length_m, share = rng.uniform(6.0, 14.0), rng.uniform(0.6, 1.2), rng.uniform(0.3, 0.9)
    height = np.zeros(local_s.size)
    for late_s, part in ((0.0, 1.0), (2.7 / speed_mps, share)):
        along = np.clip((local_s - late_s) * speed_mps / length_m, 0.0, 1.0)
        height -= part * np.sin(np.pi * along) ** 2
    frequency_hz = np.fft.rfftfreq(local_s.size, 1.0 / RATE_HZ)
    spectrum = quarter_car(frequency_hz, rng.uniform(9.5, 12.5)) * np.fft.rfft(height)
    spectrum[0] = 0.0
    shape = np.zeros(time_s.size)
    shape[near] = np.fft.irfft(spectrum, local_s.size) * np.clip(4.0 * (3.0 - local_s), 0.0, 1.0)
    return shape


def _crossing(time_s: Floats, at_s: float, rng: np.random.Generator) -> Floats:
    """Two rails under two axles, or four wheelsets over a joint: four strikes (n,), Ricker's wavelets."""
    frequency_hz = rng.uniform(12.0, 24.0)
    shape = np.zeros(time_s.size)
    near = (time_s >= at_s - 1.0) & (time_s < at_s + 2.5)
    for late_s in np.array([0.0, 0.14, 0.42, 0.56]) * rng.uniform(0.8, 1.6):
        phase = (np.pi * frequency_hz * (time_s[near] - at_s - late_s)) ** 2
        shape[near] += rng.uniform(0.6, 1.0) * (1.0 - 2.0 * phase) * np.exp(-phase)
    return shape
