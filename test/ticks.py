"""Stamps of a sensor's even clock, whole or with samples lost."""

from __future__ import annotations

import numpy as np

RATE_HZ = 1129.3
COUNT = 904
"""Samples of 0.8 s."""


def even_s(count: int = COUNT, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Stamps (n,) of an even clock, seconds."""
    return np.arange(count) / rate_hz


def lost_at_random(share: float, seed: int, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Even stamps without a share of them, but with the first and the last."""
    kept = np.random.default_rng(seed).random(COUNT) >= share
    kept[[0, -1]] = True
    return even_s(rate_hz=rate_hz)[kept]
