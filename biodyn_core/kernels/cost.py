"""Sixteen chains integrated together, and their cost against a measurement (Zaman et al., Eq. 2-4, 17, 18, 33).

Each lane is one chain. All is in one flat array with the lanes innermost, so that the compiler vectorises over chains.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.kernels.compiling import compiled, inlined

LANES: Final = 16
CONSTANT_ROWS: Final = 25

# Where the parts of the work array begin, six rows of `LANES` values each. The row before x or v is that of the seat,
# the row after the forces that above the head; both are 0.
_SIX: Final = 6 * LANES
_K: Final = 0
_B: Final = _K + _SIX
_K_ALPHA: Final = _B + _SIX
_INVERSE_MASS: Final = _K_ALPHA + _SIX
_ALPHA_R: Final = _INVERSE_MASS + _SIX
_FORCE: Final = _ALPHA_R + _SIX
_X: Final = _FORCE + _SIX + 2 * LANES
_X_TRY: Final = _X + _SIX + LANES
_V: Final = _X_TRY + _SIX + LANES
_V2: Final = _V + _SIX + LANES
_V3: Final = _V2 + _SIX + LANES
_V4: Final = _V3 + _SIX + LANES
_A: Final = _V4 + _SIX
_A2: Final = _A + _SIX
_A3: Final = _A2 + _SIX
_A4: Final = _A3 + _SIX
_TOTAL: Final = _A4 + _SIX
_SIZE: Final = _TOTAL + LANES


@inlined
def _accelerations(w: Floats, x: int, v: int, seat: float, out: int) -> None:
    """Relative accelerations x'' of all lanes, Eq. 4, from displacements and velocities that begin at x and v."""
    for i in range(_SIX):
        delta = w[x + i] - w[x + i - LANES]
        rate = w[v + i] - w[v + i - LANES]
        w[_FORCE + i] = delta * (w[_K + i] + w[_K_ALPHA + i] * abs(delta)) + w[_B + i] * rate  # Eq. 17
    for i in range(_SIX):
        load = w[_FORCE + i + LANES] - w[_FORCE + i]
        w[out + i] = load * w[_INVERSE_MASS + i] - w[_ALPHA_R + i] * w[v + i] - seat


@compiled
def _step(w: Floats, middle: float, end: float, h: float) -> None:
    """One classical Runge-Kutta step of all lanes; the last slope of a step is the first of the next one."""
    half, sixth = 0.5 * h, h / 6.0
    for i in range(_SIX):
        w[_V2 + i] = w[_V + i] + half * w[_A + i]
        w[_X_TRY + i] = w[_X + i] + half * w[_V + i]
    _accelerations(w, _X_TRY, _V2, middle, _A2)
    for i in range(_SIX):
        w[_V3 + i] = w[_V + i] + half * w[_A2 + i]
        w[_X_TRY + i] = w[_X + i] + half * w[_V2 + i]
    _accelerations(w, _X_TRY, _V3, middle, _A3)
    for i in range(_SIX):
        w[_V4 + i] = w[_V + i] + h * w[_A3 + i]
        w[_X_TRY + i] = w[_X + i] + h * w[_V3 + i]
    _accelerations(w, _X_TRY, _V4, end, _A4)
    for i in range(_SIX):
        w[_X + i] += sixth * (w[_V + i] + 2.0 * w[_V2 + i] + 2.0 * w[_V3 + i] + w[_V4 + i])
        w[_V + i] += sixth * (w[_A + i] + 2.0 * w[_A2 + i] + 2.0 * w[_A3 + i] + w[_A4 + i])
    _accelerations(w, _X, _V, end, _A)


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
    for row in range(CONSTANT_ROWS - 1):
        for lane in range(LANES):
            w[row * LANES + lane] = constants[row, lane]
    for row in range(6):
        for lane in range(LANES):
            w[_ALPHA_R + row * LANES + lane] = constants[CONSTANT_ROWS - 1, lane]
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
