"""Raw streams of one sensor for tests of conditioning, and the joined output."""

from __future__ import annotations

import naive
import numpy as np

from biodyn_core.conditioning.conditioner import Conditioner

RATE_HZ = 1129.3
START_NS = 1_767_225_600 * 10**9
REST_S = 0.8
ROUNDING = 1e-9
HOUR_NS = 3600 * 10**9


def stamps(count: int, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Even header stamps, ns."""
    return START_NS + np.rint(np.arange(count) * 1e9 / rate_hz).astype(np.int64)


def ride(seconds: float, rate_hz: float = RATE_HZ, frequency_hz: float = 5.0, size: float = 2.0) -> np.ndarray:
    """A second at rest, then a sine up and down with smaller ones sideways; acceleration (n, 3), up last."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    swing = np.where(time > 1.0, np.sin(2.0 * np.pi * frequency_hz * (time - 1.0)), 0.0)
    return size * swing[:, None] * [0.3, -0.2, 1.0]


def raw(accel: np.ndarray, mounting: np.ndarray | None = None) -> np.ndarray:
    """The specific force that a sensor of this mounting measures, (n, 3)."""
    force = accel + np.array([0.0, 0.0, naive.GRAVITY])
    return force if mounting is None else force @ mounting.T


class Conditioned:
    """One conditioner's blocks, joined."""

    def __init__(
        self, stamps_ns, samples, cuts=(), conditioning=None, mode="causal", vertical=None, gravity=None
    ) -> None:
        self.conditioner = Conditioner("seat", conditioning, mode, vertical, gravity)
        parts = zip(np.split(stamps_ns, cuts), np.split(samples, cuts), strict=True)
        self.blocks = [block for s, x in parts for block in self.conditioner.push(s, x)] + self.conditioner.finish()
        self.status = self.conditioner.status()
        self.stamps_ns = np.concatenate([b.stamps_ns for b in self.blocks] or [np.empty(0, dtype=np.int64)])
        self.time_s = np.concatenate([b.time_s for b in self.blocks] or [np.empty(0)])
        self.levelled = np.concatenate([b.levelled_mps2 for b in self.blocks] or [np.empty((0, 3))])
        self.low_passed = np.concatenate([b.low_passed_mps2 for b in self.blocks] or [np.empty(0)])
        begins = [np.arange(b.time_s.size) == 0 if b.begins_run else np.zeros(b.time_s.size, bool) for b in self.blocks]
        self.begins = np.flatnonzero(np.concatenate(begins or [np.empty(0, dtype=bool)]))


STILL = raw(np.zeros((20_000, 3)))
"""Readings at rest."""
