"""The chain of segments, integrated (Zaman et al., Eq. 2-4, 17, 18).

With effects the integrator is this source text with their functions inserted at the lines marked `effects:`
(`biodyn_core.kernels.generated`); without them the lines about their states q take no time.
"""

from __future__ import annotations

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.kernels.compiling import compiled, inlined

# effects: functions


@inlined
def _accelerations(
    x: Floats,
    v: Floats,
    q: Floats,
    seat: float,
    k: Floats,
    b: Floats,
    k_alpha: Floats,
    inverse_mass: Floats,
    alpha_r: float,
    p: Floats,
    out: Floats,
    dq: Floats,
    tension: Floats,
) -> None:
    """Relative accelerations x'' of Eq. 4, joint by joint from the head down (Eq. 17, 18).

    Also the rates dq of the states q, and the tension of each joint, N.
    """
    above = 0.0
    # effects: before
    for j in range(5, -1, -1):
        delta = x[j] - x[j - 1] if j > 0 else x[0]
        rate = v[j] - v[j - 1] if j > 0 else v[0]
        force = delta * (k[j] + k_alpha[j] * abs(delta)) + b[j] * rate
        # effects: joints
        load = above - force
        # effects: segments
        out[j] = load * inverse_mass[j] - alpha_r * v[j] - seat
        tension[j] = force
        above = force


@compiled
def integrate_chain(
    seat: Floats,
    drive: Floats,
    state: Floats,
    k: Floats,
    b: Floats,
    k_alpha: Floats,
    inverse_mass: Floats,
    alpha_r: float,
    p: Floats,
    step_s: float,
    substeps: int,
    accel: Floats,
    motion: Floats,
) -> None:
    """Integrate the chain over `seat` samples by classical Runge-Kutta, seat acceleration linear between samples.

    seat (n,) m/s^2; drive (n, d): further inputs of effects; state (13 + s,) = x (6), v (6), last seat sample, s states
    of effects, and p, the constants and memory of effects, are updated in place; accel (n, 6) absolute m/s^2;
    motion (n, 18) = x, v, and the compression of each joint in N, or (0, 18) if not wanted; Rayleigh damping counts as
    carried by the joints below. Zaman et al., Eq. 2-4, 17, 18.
    """
    x, v, x_try = np.empty(6), np.empty(6), np.empty(6)
    v2, v3, v4 = np.empty(6), np.empty(6), np.empty(6)
    a1, a2, a3, a4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    tension, damping = np.empty(6), np.empty(6)
    states = state.shape[0] - 13
    # effects: states
    q, q_try = np.empty(states), np.empty(states)
    d1, d2, d3, d4 = np.empty(states), np.empty(states), np.empty(states), np.empty(states)
    for j in range(6):
        x[j] = state[j]
        v[j] = state[6 + j]
        damping[j] = alpha_r / inverse_mass[j]
    last = state[12]
    for j in range(states):
        q[j] = state[13 + j]
    half, sixth = 0.5 * step_s, step_s / 6.0
    keep_motion = motion.shape[0] > 0
    _accelerations(x, v, q, last, k, b, k_alpha, inverse_mass, alpha_r, p, a1, d1, tension)
    for n in range(seat.shape[0]):
        slope = (seat[n] - last) / substeps
        # effects: samples
        for substep in range(substeps):
            middle = last + slope * (substep + 0.5)
            # Exactly the sample at the last substep, so that block boundaries change no bit.
            end = seat[n] if substep == substeps - 1 else last + slope * (substep + 1)
            # effects: middle
            for j in range(6):
                v2[j] = v[j] + half * a1[j]
                x_try[j] = x[j] + half * v[j]
            for j in range(states):
                q_try[j] = q[j] + half * d1[j]
            _accelerations(x_try, v2, q_try, middle, k, b, k_alpha, inverse_mass, alpha_r, p, a2, d2, tension)
            for j in range(6):
                v3[j] = v[j] + half * a2[j]
                x_try[j] = x[j] + half * v2[j]
            for j in range(states):
                q_try[j] = q[j] + half * d2[j]
            _accelerations(x_try, v3, q_try, middle, k, b, k_alpha, inverse_mass, alpha_r, p, a3, d3, tension)
            # effects: end
            for j in range(6):
                v4[j] = v[j] + step_s * a3[j]
                x_try[j] = x[j] + step_s * v3[j]
            for j in range(states):
                q_try[j] = q[j] + step_s * d3[j]
            _accelerations(x_try, v4, q_try, end, k, b, k_alpha, inverse_mass, alpha_r, p, a4, d4, tension)
            for j in range(6):
                x[j] += sixth * (v[j] + 2.0 * v2[j] + 2.0 * v3[j] + v4[j])
                v[j] += sixth * (a1[j] + 2.0 * a2[j] + 2.0 * a3[j] + a4[j])
            for j in range(states):
                q[j] += sixth * (d1[j] + 2.0 * d2[j] + 2.0 * d3[j] + d4[j])
            # effects: past
            # The input is continuous: the last slope of this step is the first of the next one, and the output.
            _accelerations(x, v, q, end, k, b, k_alpha, inverse_mass, alpha_r, p, a1, d1, tension)
        last = seat[n]
        for j in range(6):
            accel[n, j] = a1[j] + last
        if keep_motion:
            damped = 0.0
            for j in range(5, -1, -1):
                damped += damping[j] * v[j]
                motion[n, j] = x[j]
                motion[n, 6 + j] = v[j]
                motion[n, 12 + j] = -tension[j] - damped
    for j in range(6):
        state[j] = x[j]
        state[6 + j] = v[j]
    state[12] = last
    for j in range(states):
        state[13 + j] = q[j]
