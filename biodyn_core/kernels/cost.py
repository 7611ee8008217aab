"""Sixteen chains integrated together, and their cost against a measurement (Zaman et al., Eq. 2-4, 17, 18, 33).

Each lane is one chain. With the lanes innermost and the state in one flat array the compiler vectorises over chains.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.compiling import compiled, inlined

LANES: Final = 16

# Rows of the work array, `LANES` values each.
_K: Final = 0
_B: Final = 6 * LANES
_K_ALPHA: Final = 12 * LANES
_INVERSE_MASS: Final = 18 * LANES
_ALPHA_R: Final = 24 * LANES
_X: Final = 25 * LANES
_V: Final = 31 * LANES
_A: Final = 37 * LANES
_TOTAL: Final = 43 * LANES
_SIZE: Final = 44 * LANES
CONSTANT_ROWS: Final = 25

_Six = tuple[float, float, float, float, float, float]


@inlined
def _joint_force(w: Floats, joint: int, lane: int, delta: float, rate: float) -> float:
    """Force of one joint, Eq. 17."""
    at = joint * LANES + lane
    return delta * (w[_K + at] + w[_K_ALPHA + at] * abs(delta)) + w[_B + at] * rate


@inlined
def _accelerations(
    w: Floats, lane: int,
    x0: float, x1: float, x2: float, x3: float, x4: float, x5: float,
    v0: float, v1: float, v2: float, v3: float, v4: float, v5: float, seat: float,
) -> _Six:  # fmt: skip
    """Relative accelerations x'' of one lane, Eq. 4."""
    f0 = _joint_force(w, 0, lane, x0, v0)
    f1 = _joint_force(w, 1, lane, x1 - x0, v1 - v0)
    f2 = _joint_force(w, 2, lane, x2 - x1, v2 - v1)
    f3 = _joint_force(w, 3, lane, x3 - x2, v3 - v2)
    f4 = _joint_force(w, 4, lane, x4 - x3, v4 - v3)
    f5 = _joint_force(w, 5, lane, x5 - x4, v5 - v4)
    im, alpha_r = _INVERSE_MASS + lane, w[_ALPHA_R + lane]
    return (
        (f1 - f0) * w[im] - alpha_r * v0 - seat,
        (f2 - f1) * w[im + LANES] - alpha_r * v1 - seat,
        (f3 - f2) * w[im + 2 * LANES] - alpha_r * v2 - seat,
        (f4 - f3) * w[im + 3 * LANES] - alpha_r * v3 - seat,
        (f5 - f4) * w[im + 4 * LANES] - alpha_r * v4 - seat,
        -f5 * w[im + 5 * LANES] - alpha_r * v5 - seat,
    )


@compiled
def _step(w: Floats, middle: float, end: float, h: float) -> None:
    """One classical Runge-Kutta step of all lanes; the last slope of a step is the first of the next one."""
    half, sixth = 0.5 * h, h / 6.0
    for lane in range(LANES):
        i, j, m = _X + lane, _V + lane, _A + lane
        x0, x1, x2 = w[i], w[i + LANES], w[i + 2 * LANES]
        x3, x4, x5 = w[i + 3 * LANES], w[i + 4 * LANES], w[i + 5 * LANES]
        v0, v1, v2 = w[j], w[j + LANES], w[j + 2 * LANES]
        v3, v4, v5 = w[j + 3 * LANES], w[j + 4 * LANES], w[j + 5 * LANES]
        a0, a1, a2 = w[m], w[m + LANES], w[m + 2 * LANES]
        a3, a4, a5 = w[m + 3 * LANES], w[m + 4 * LANES], w[m + 5 * LANES]
        p0, p1, p2, p3, p4, p5 = (
            v0 + half * a0, v1 + half * a1, v2 + half * a2, v3 + half * a3, v4 + half * a4, v5 + half * a5,
        )  # fmt: skip
        b0, b1, b2, b3, b4, b5 = _accelerations(
            w, lane, x0 + half * v0, x1 + half * v1, x2 + half * v2, x3 + half * v3, x4 + half * v4, x5 + half * v5,
            p0, p1, p2, p3, p4, p5, middle,
        )  # fmt: skip
        q0, q1, q2, q3, q4, q5 = (
            v0 + half * b0, v1 + half * b1, v2 + half * b2, v3 + half * b3, v4 + half * b4, v5 + half * b5,
        )  # fmt: skip
        c0, c1, c2, c3, c4, c5 = _accelerations(
            w, lane, x0 + half * p0, x1 + half * p1, x2 + half * p2, x3 + half * p3, x4 + half * p4, x5 + half * p5,
            q0, q1, q2, q3, q4, q5, middle,
        )  # fmt: skip
        r0, r1, r2, r3, r4, r5 = v0 + h * c0, v1 + h * c1, v2 + h * c2, v3 + h * c3, v4 + h * c4, v5 + h * c5
        d0, d1, d2, d3, d4, d5 = _accelerations(
            w, lane, x0 + h * q0, x1 + h * q1, x2 + h * q2, x3 + h * q3, x4 + h * q4, x5 + h * q5,
            r0, r1, r2, r3, r4, r5, end,
        )  # fmt: skip
        x0 += sixth * (v0 + 2.0 * p0 + 2.0 * q0 + r0)
        x1 += sixth * (v1 + 2.0 * p1 + 2.0 * q1 + r1)
        x2 += sixth * (v2 + 2.0 * p2 + 2.0 * q2 + r2)
        x3 += sixth * (v3 + 2.0 * p3 + 2.0 * q3 + r3)
        x4 += sixth * (v4 + 2.0 * p4 + 2.0 * q4 + r4)
        x5 += sixth * (v5 + 2.0 * p5 + 2.0 * q5 + r5)
        v0 += sixth * (a0 + 2.0 * b0 + 2.0 * c0 + d0)
        v1 += sixth * (a1 + 2.0 * b1 + 2.0 * c1 + d1)
        v2 += sixth * (a2 + 2.0 * b2 + 2.0 * c2 + d2)
        v3 += sixth * (a3 + 2.0 * b3 + 2.0 * c3 + d3)
        v4 += sixth * (a4 + 2.0 * b4 + 2.0 * c4 + d4)
        v5 += sixth * (a5 + 2.0 * b5 + 2.0 * c5 + d5)
        a0, a1, a2, a3, a4, a5 = _accelerations(w, lane, x0, x1, x2, x3, x4, x5, v0, v1, v2, v3, v4, v5, end)
        w[i], w[i + LANES], w[i + 2 * LANES] = x0, x1, x2
        w[i + 3 * LANES], w[i + 4 * LANES], w[i + 5 * LANES] = x3, x4, x5
        w[j], w[j + LANES], w[j + 2 * LANES] = v0, v1, v2
        w[j + 3 * LANES], w[j + 4 * LANES], w[j + 5 * LANES] = v3, v4, v5
        w[m], w[m + LANES], w[m + 2 * LANES] = a0, a1, a2
        w[m + 3 * LANES], w[m + 4 * LANES], w[m + 5 * LANES] = a3, a4, a5


@compiled
def _add_square(w: Floats, at: int, target: float, weight: float) -> None:
    """Add the square of one sample to the total of every lane."""
    for lane in range(LANES):
        miss = w[at + lane] - target
        w[_TOTAL + lane] += weight * miss * miss


@compiled
def _at_rest(constants: Floats, seat: float) -> Floats:
    """The work array before the first step: z'' = 0 and x'' = -seat."""
    w = np.zeros(_SIZE)
    for row in range(CONSTANT_ROWS):
        for lane in range(LANES):
            w[row * LANES + lane] = constants[row, lane]
    for row in range(6):
        for lane in range(LANES):
            w[_A + row * LANES + lane] = -seat
    return w


@compiled
def difference_quotients(values: Floats, step: float) -> None:
    """Subtract the last column of values (n, s, c) from the others and divide these by step, in place.

    NumPy takes ten times as long, because its inner loop has only c elements.
    """
    last = values.shape[2] - 1
    for n in range(values.shape[0]):
        for s in range(values.shape[1]):
            for c in range(last):
                values[n, s, c] = (values[n, s, c] - values[n, s, last]) / step


@compiled
def integrate_lanes(
    seat: Floats,
    constants: Floats,
    step_s: float,
    substeps: int,
    segments: Integers,
    target: Floats,
    weight: Floats,
    cost: Floats,
    accel: Floats,
) -> None:
    """Integrate `LANES` chains from rest over `seat`, as `integrate_chain`, and compare them with a target.

    seat (n,) m/s^2; constants (25, LANES): k, b, k alpha and 1/m of the joints, then alpha_r; segments (s,) to compare;
    target (n, s) m/s^2 and weight (n, s), or (0, s) if no cost is wanted; cost (LANES,) receives
    sum weight (z'' - target)^2; accel (n, s, LANES) receives z'', or (0, s, LANES).
    """
    w = _at_rest(constants, seat[0])
    last = seat[0]
    for n in range(seat.shape[0]):
        if n > 0:
            slope = (seat[n] - last) / substeps
            for q in range(substeps):
                end = seat[n] if q == substeps - 1 else last + slope * (q + 1)
                _step(w, last + slope * (q + 0.5), end, step_s)
            last = seat[n]
        for s in range(segments.shape[0]):
            at = _A + segments[s] * LANES
            if target.shape[0] > 0 and weight[n, s] > 0.0:
                _add_square(w, at, target[n, s] - last, weight[n, s])
            if accel.shape[0] > 0:
                for lane in range(LANES):
                    accel[n, s, lane] = w[at + lane] + last
    for lane in range(LANES):
        cost[lane] = w[_TOTAL + lane]
