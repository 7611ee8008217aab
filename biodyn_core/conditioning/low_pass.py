"""Low-pass: the Butterworth filter of the model's input and of comparisons (Zaman et al., 5.2)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats
from biodyn_core.kernels.sensor import SECTIONS

FILTER_ORDER: Final = 2 * SECTIONS
"""Applied forward and backward it has -6 dB at the cut-off."""


def low_pass_sections(cutoff_hz: float, rate_hz: float) -> Floats:
    """Second-order sections, (SECTIONS, 6)."""
    sections: Floats = scipy.signal.butter(FILTER_ORDER, cutoff_hz, fs=rate_hz, output="sos")
    return sections


def zero_phase(sections: Floats, values: Floats) -> Floats:
    """Filter a whole run (n, ...) forward and backward."""
    padding = min(3 * (FILTER_ORDER + 1), len(values) - 1)
    filtered: Floats = np.ascontiguousarray(scipy.signal.sosfiltfilt(sections, values, axis=0, padlen=padding))
    return filtered


def group_delay_s(sections: Floats, rate_hz: float) -> float:
    """Group delay at 0 Hz, seconds."""
    delay = 0.0
    for b0, b1, b2, a0, a1, a2 in sections.tolist():
        delay += (b1 + 2.0 * b2) / (b0 + b1 + b2) - (a1 + 2.0 * a2) / (a0 + a1 + a2)
    return delay / rate_hz


def reach(sections: Floats, share: float) -> int:
    """Number of samples after which the slowest pole of the sections (s, 6) has decayed to a share."""
    radius = max(float(np.abs(np.roots(section[3:])).max()) for section in sections)
    return math.ceil(math.log(share) / math.log(radius))
