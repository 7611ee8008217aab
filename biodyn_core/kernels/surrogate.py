"""Linear chains in the frequency domain, many at once, and their cost against measured magnitudes (Eq. 30, 31)."""

from __future__ import annotations

import math

import numpy as np

from biodyn_core.base.arrays import Complexes, Floats, Integers
from biodyn_core.kernels.compiling import compiled


@compiled
def _transmissibility(
    omega: float, k: Floats, b: Floats, mass: Floats, alpha_r: float, slope: Complexes, offset: Complexes,
    out: Complexes,
) -> None:  # fmt: skip
    """T_i = 1 - omega^2 H_i of one chain, (6,): downwards x_i = slope_i x_(i-1) + offset_i, then upwards."""
    inertia = complex(-omega * omega, omega * alpha_r)
    above_k, above_slope, above_offset = 0.0j, 0.0j, 0.0j
    for i in range(5, -1, -1):
        joint = complex(k[i], omega * b[i])
        pivot = inertia * mass[i] + joint + above_k * (1.0 - above_slope)
        # Python's complex division guards against overflow and takes twice the time; dynamic stiffnesses are small.
        inverse = pivot.conjugate() * (1.0 / (pivot.real * pivot.real + pivot.imag * pivot.imag))
        above_offset = (above_k * above_offset - mass[i]) * inverse
        above_slope = joint * inverse
        above_k = joint
        slope[i] = above_slope
        offset[i] = above_offset
    below = 0.0j
    for i in range(6):
        below = slope[i] * below + offset[i]
        out[i] = 1.0 - omega * omega * below


@compiled
def surrogate_costs(
    omega: Floats,
    magnitude: Floats,
    weight: Floats,
    segments: Integers,
    k: Floats,
    b: Floats,
    mass: Floats,
    alpha_r: Floats,
    costs: Floats,
) -> None:
    """Sum of weight (|T_i| - magnitude)^2 over frequencies and segments for each chain (Eq. 31 without its lambda_1).

    omega (f,) rad/s; magnitude, weight (f, s) of the segments (s,); k, b, mass (p, 6); alpha_r and
    costs (p,).
    """
    slope, offset = np.empty(6, dtype=np.complex128), np.empty(6, dtype=np.complex128)
    t = np.empty(6, dtype=np.complex128)
    for p in range(costs.shape[0]):
        total = 0.0
        for n in range(omega.shape[0]):
            _transmissibility(omega[n], k[p], b[p], mass[p], alpha_r[p], slope, offset, t)
            for s in range(segments.shape[0]):
                value = t[segments[s]]
                miss = math.sqrt(value.real * value.real + value.imag * value.imag) - magnitude[n, s]
                total += weight[n, s] * miss * miss
        costs[p] = total
