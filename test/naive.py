"""Slow, obvious twins of the package's mathematics, written from the sources and not from the code under test.

None of them imports biodyn: the paper's equations as full matrices, the standard's formulas, brute force.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import integrate

GRAVITY = 9.80665
MASS_FRACTION = (0.099, 0.117, 0.162, 0.126, 0.018, 0.059)
STIFFENING_SHAPE = (30.0, 25.0, 20.0, 15.0, 8.0, 4.0)


# --- the chain, Zaman et al., Eq. 1-18 -------------------------------------------------------------------------------


def chain_matrices(theta, body_mass_kg, mass_matrix):
    """M, C, K (6, 6), joint stiffness k (6,) and stiffening alpha (6,) of theta (15,), element by element."""
    f_n, zeta = theta[:6], theta[6:12]
    alpha_r, s_nl, m_scale = theta[12:]
    mass = [m_scale * fraction * body_mass_kg for fraction in MASS_FRACTION]
    cascade = [sum(mass[i:]) for i in range(6)]
    k = [(2.0 * math.pi * f_n[i]) ** 2 * cascade[i] for i in range(6)]
    b = [2.0 * zeta[i] * math.sqrt(k[i] * cascade[i]) for i in range(6)]
    M = np.diag(mass if mass_matrix == "segment" else cascade)
    K, C = np.zeros((6, 6)), np.zeros((6, 6))
    for matrix, joint in ((K, k), (C, b)):
        for i in range(6):
            matrix[i, i] += joint[i]
            if i > 0:
                matrix[i - 1, i - 1] += joint[i]
                matrix[i - 1, i] -= joint[i]
                matrix[i, i - 1] -= joint[i]
    return M, C + alpha_r * M, K, np.array(k), s_nl * np.array(STIFFENING_SHAPE)


def _stacked(bodies):
    """The matrices of several bodies (theta, body mass, mass matrix), one array each, bodies first."""
    return [np.array(part) for part in zip(*(chain_matrices(*body) for body in bodies), strict=True)]


def chain_responses(bodies, seat_mps2, rate_hz, rtol=1e-12):
    """Absolute accelerations (bodies, n, 6) by DOP853, restarted at every sample since the seat's slope jumps there."""
    M, C, K, k, alpha = _stacked(bodies)
    inverse, count = np.linalg.inv(M), len(bodies)

    def relative_acceleration(x, v, seat):
        stretch = np.diff(x, axis=1, prepend=0.0)
        joint = k * alpha * stretch * np.abs(stretch)
        nonlinear = joint - np.append(joint[:, 1:], np.zeros((count, 1)), axis=1)
        load = M @ np.ones(6) * seat + (C @ v[..., None] + K @ x[..., None])[..., 0] + nonlinear
        return -(inverse @ load[..., None])[..., 0]

    out = np.zeros((count, len(seat_mps2), 6))
    state = np.zeros((count, 2, 6))
    step = 1.0 / rate_hz
    for n in range(1, len(seat_mps2)):
        before, now = seat_mps2[n - 1], seat_mps2[n]

        def slope(t, y, before=before, now=now):
            x, v = y.reshape(count, 2, 6).swapaxes(0, 1)
            acceleration = relative_acceleration(x, v, before + (now - before) * t / step)
            return np.stack([v, acceleration], axis=1).ravel()

        end = integrate.solve_ivp(slope, (0.0, step), state.ravel(), "DOP853", rtol=rtol, atol=1e-14, first_step=step)
        state = end.y[:, -1].reshape(count, 2, 6)
        out[:, n] = relative_acceleration(state[:, 0], state[:, 1], now) + now
    return out


def chain_response(theta, body_mass_kg, mass_matrix, seat_mps2, rate_hz):
    """The same for one body, (n, 6)."""
    return chain_responses([(theta, body_mass_kg, mass_matrix)], seat_mps2, rate_hz)[0]
