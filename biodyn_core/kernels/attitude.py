"""Which way is up for a sensor that turns: the vertical followed by its own rates, and pulled towards what it feels."""

from __future__ import annotations

import math

from biodyn_core.base.arrays import Floats
from biodyn_core.kernels.compiling import compiled


@compiled
def follow_attitude(rates_radps: Floats, force_mps2: Floats, step_s: float, pull: float, up: Floats) -> None:
    """The direction that is up as up[0] says at the first sample, in the sensor's axes at every sample, into up (n, 3).

    rates_radps and force_mps2 (n, 3) in the sensor's axes. What is fixed in the world turns the other way in the
    sensor: Rodrigues' rotation by the mean rate of each step, exact for a steady one. pull: share of the way to the
    direction of the specific force that is gone at each step, so that a bias does not add up for ever.
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
        felt = math.sqrt(u * u + v * v + w * w)
        if pull > 0.0 and felt > 0.0:
            x, y, z = x + pull * (u / felt - x), y + pull * (v / felt - y), z + pull * (w / felt - z)
            size = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / size, y / size, z / size
        up[n, 0], up[n, 1], up[n, 2] = x, y, z
