"""Sampling rates that every path takes: of measured and of simulated sensors."""

from __future__ import annotations

from typing import Final

MIN_RATE_HZ: Final = 250.0
"""Below this no sampled filter follows the curves to 80 Hz.

From here on they are off by 0.5 % at most, from 500 Hz by 0.07 %, at 1129.3 Hz by 0.005 %; Wj, whose low-pass has no
transition beside it, by 0.93, 0.23 and 0.012 %.
"""

MAX_RATE_HZ: Final = 20_000.0
"""No sensor of vibration samples faster."""

RATE_TOLERANCE: Final = 0.001
"""A clock may run slow or fast by this before a sensor of the lowest or highest rate is refused."""
