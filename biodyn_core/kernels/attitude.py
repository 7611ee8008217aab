"""Attitude of a rotating sensor: the vertical from its angular rates, corrected by its specific force."""

from __future__ import annotations

import math

from biodyn_core.base.arrays import Floats
from biodyn_core.kernels.compiling import compiled


@compiled
def follow_attitude(rates_radps: Floats, force_mps2: Floats, step_s: float, gain: float, up: Floats) -> None:
    """The upward direction in the sensor's axes at every sample, into up (n, 3); up[0] is given.

    rates_radps and force_mps2 (n, 3) are in the sensor's axes. A direction fixed in the world rotates opposite to the
    sensor: Rodrigues' rotation by the mean rate of each step, exact for a constant rate. gain: share of the difference
    to the direction of the specific force that each step removes, so that a bias of the rates does not accumulate.
    """
    x, y, z = up[0, 0], up[0, 1], up[0, 2]
    for n in range(1, rates_radps.shape[0]):
        a = -0.5 * step_s * (rates_radps[n - 1, 0] + rates_radps[n, 0])
        b = -0.5 * step_s * (rates_radps[n - 1, 1] + rates_radps[n, 1])
        c = -0.5 * step_s * (rates_radps[n - 1, 2] + rates_radps[n, 2])
        angle = math.sqrt(a * a + b * b + c * c)
        if angle > 0.0:
            a, b, c = a / angle, b / angle, c / angle
            sine, cosine = math.sin(angle), math.cos(angle)
            along = (1.0 - cosine) * (a * x + b * y + c * z)
            x, y, z = (
                x * cosine + (b * z - c * y) * sine + a * along,
                y * cosine + (c * x - a * z) * sine + b * along,
                z * cosine + (a * y - b * x) * sine + c * along,
            )
        u, v, w = force_mps2[n, 0], force_mps2[n, 1], force_mps2[n, 2]
        norm = math.sqrt(u * u + v * v + w * w)
        if gain > 0.0 and norm > 0.0:
            x, y, z = x + gain * (u / norm - x), y + gain * (v / norm - y), z + gain * (w / norm - z)
            size = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / size, y / size, z / size
        up[n, 0], up[n, 1], up[n, 2] = x, y, z
