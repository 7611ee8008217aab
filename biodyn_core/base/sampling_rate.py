"""Sampling rates that every path accepts, of measured and of simulated sensors."""

from __future__ import annotations

from typing import Final

MIN_RATE_HZ: Final = 250.0
"""Below this rate no sampled filter follows the weighting curves to 80 Hz.

The largest error is 0.5 % from here on, 0.07 % from 500 Hz, and 0.005 % at 1129.3 Hz; for Wj, which has no transition,
0.93, 0.23 and 0.012 %.
"""

MAX_RATE_HZ: Final = 20_000.0
"""No sensor of vibration samples faster."""

RATE_TOLERANCE: Final = 0.001
"""Relative clock error that is allowed to a sensor of the lowest or highest rate."""
