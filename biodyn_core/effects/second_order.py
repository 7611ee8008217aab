"""Second-order systems: a mass on a spring and a damper, as a filter of what moves its base."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy

from biodyn_core.base.arrays import Floats


def second_order(values: Floats, softness_s: float, damping_ratio: float, rate_hz: float) -> Floats:
    """(2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2) of values (n,), w = 1 / softness; linear between samples."""
    over, under = _filter(softness_s, damping_ratio, rate_hz)
    return np.asarray(scipy.signal.lfilter(over, under, values))


@lru_cache(maxsize=64)  # every event needs the same filter, whose design takes longer than its application
def _filter(softness_s: float, damping_ratio: float, rate_hz: float) -> tuple[Floats, Floats]:
    """Numerator and denominator of the discrete filter."""
    omega, zeta = 1.0 / softness_s, damping_ratio
    system = scipy.signal.cont2discrete(
        ([2.0 * zeta * omega, omega**2], [1.0, 2.0 * zeta * omega, omega**2]), 1.0 / rate_hz, "foh"
    )
    return np.ravel(system[0]), np.asarray(system[1])
