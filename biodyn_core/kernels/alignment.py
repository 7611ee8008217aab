"""Interpolation of evenly sampled values."""

from __future__ import annotations

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.compiling import compiled


@compiled
def interpolate(
    times: Floats, runs: Integers, values: Floats, grid: Floats, weights: Floats, out: Floats
) -> int:  # fmt: skip
    """Interpolate evenly sampled values at the instants of a grid by Lagrange polynomials through 2h neighbours.

    times, runs, values (m,); grid (n,) ascending; weights (2h,) barycentric; out (n,) stays unchanged where
    a run's edge or a gap leaves too few neighbours. Returns how many instants are done: it stops at the first whose
    neighbours may still arrive.
    """
    half = weights.shape[0] // 2
    newest = times.shape[0] - 1
    m = 0
    for n in range(grid.shape[0]):
        t = grid[n]
        while m < newest and times[m + 1] <= t:
            m += 1
        if newest < 0 or (m + half > newest and t >= times[m]):
            return n
        first, last = m - half + 1, m + half
        if t < times[m] or first < 0 or runs[first] != runs[last]:
            continue
        u = (t - times[m]) / (times[m + 1] - times[m]) + half - 1.0
        above, below, exact = 0.0, 0.0, -1
        for j in range(2 * half):
            distance = u - j
            if distance == 0.0:
                exact = j
                break
            w = weights[j] / distance
            above += w * values[first + j]
            below += w
        out[n] = values[first + exact] if exact >= 0 else above / below
    return grid.shape[0]
