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


def transfer_functions(theta, body_mass_kg, mass_matrix, frequency_hz):
    """Relative displacement per seat acceleration at s_nl = 0, (n, 6), one small linear system a frequency (Eq. 30)."""
    M, C, K, _, _ = chain_matrices(theta, body_mass_kg, mass_matrix)
    rows = []
    for frequency in frequency_hz:
        omega = 2.0 * math.pi * frequency
        rows.append(np.linalg.inv(-(omega**2) * M + 1j * omega * C + K) @ (-M @ np.ones(6)))
    return np.array(rows)


# --- ISO 2631-1 / ISO 8041 -------------------------------------------------------------------------------------------


def weighting(name, frequency_hz):
    """The analog weighting, as ISO 8041 prints its factors: band limits at 0.4 and 100 Hz, a-v transition, step."""
    p = 2j * math.pi * np.asarray(frequency_hz, dtype=float)
    w1, w2 = 2.0 * math.pi * 0.4, 2.0 * math.pi * 100.0
    high_pass = 1.0 / (1.0 + math.sqrt(2.0) * w1 / p + (w1 / p) ** 2)
    low_pass = 1.0 / (1.0 + math.sqrt(2.0) * p / w2 + (p / w2) ** 2)
    w3, q4 = 2.0 * math.pi * {"Wk": 12.5, "Wd": 2.0}[name], 0.63
    transition = (1.0 + p / w3) / (1.0 + p / (q4 * w3) + (p / w3) ** 2)
    step = 1.0
    if name == "Wk":
        w5, w6, q = 2.0 * math.pi * 2.37, 2.0 * math.pi * 3.35, 0.91
        step = (1.0 + p / (q * w5) + (p / w5) ** 2) / (1.0 + p / (q * w6) + (p / w6) ** 2) * (w5 / w6) ** 2
    return high_pass * low_pass * transition * step


def weighted(name, accel, rate_hz):
    """Weight a signal (n,) by its spectrum; zeros behind it keep the end from ringing into the beginning."""
    padded = np.concatenate([accel, np.zeros(2 * len(accel))])
    frequency = np.fft.rfftfreq(len(padded), 1.0 / rate_hz)
    gain = np.zeros(len(frequency), dtype=complex)
    gain[1:] = weighting(name, frequency[1:])
    return np.fft.irfft(np.fft.rfft(padded) * gain, len(padded))[: len(accel)]


def running_rms(accel, rate_hz):
    """Exponentially averaged rms with 1 s, sample by sample (ISO 2631-1:1997, 6.3.1, Eq. 3)."""
    forget = math.exp(-1.0 / rate_hz)
    square, out = 0.0, []
    for a in accel:
        square = forget * square + (1.0 - forget) * a * a
        out.append(math.sqrt(square))
    return np.array(out)


# --- injury criteria -------------------------------------------------------------------------------------------------


def dynamic_response(time_s, accel_mps2):
    """(max -z, max |z|) times w^2 / g of the DRI oscillator for a seat linear between samples (Eq. 24, 25)."""
    omega, zeta = 52.9, 0.224
    z, least, largest = np.zeros(2), 0.0, 0.0
    for begin, end, before, now in zip(time_s, time_s[1:], accel_mps2, accel_mps2[1:], strict=False):
        if end <= begin:
            continue

        def slope(t, y, begin=begin, end=end, before=before, now=now):
            seat = before + (now - before) * (t - begin) / (end - begin)
            return [y[1], -seat - 2.0 * zeta * omega * y[1] - omega**2 * y[0]]

        out = integrate.solve_ivp(slope, (begin, end), z, "DOP853", rtol=1e-10, atol=1e-14, dense_output=True)
        z = out.y[:, -1]
        inside = out.sol(np.linspace(begin, end, 5 + int((end - begin) * 1e4)))[0]
        least, largest = min(least, inside.min()), max(largest, np.abs(inside).max())
    return -least * omega**2 / GRAVITY, largest * omega**2 / GRAVITY


def head_injury(accel_g, rate_hz, length_s):
    """HIC over every pair of samples at most `length_s` apart (Eq. 23), trapezoids."""
    step = 1.0 / rate_hz
    integral = np.concatenate([[0.0], np.cumsum((accel_g[1:] + accel_g[:-1]) * 0.5 * step)])
    best = 0.0
    for i in range(len(accel_g)):
        for j in range(i + 1, len(accel_g)):
            duration = (j - i) * step
            if duration > length_s + 1e-12:
                break
            best = max(best, duration * ((integral[j] - integral[i]) / duration) ** 2.5)
    return best


# --- filters and polynomials -----------------------------------------------------------------------------------------


def lagrange(time_s, values, at_s):
    """The polynomial through all points, as Lagrange wrote it."""
    total = 0.0
    for j, value in enumerate(values):
        others = np.delete(time_s, j)
        total += value * np.prod((at_s - others) / (time_s[j] - others))
    return total
