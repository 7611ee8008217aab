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
STRETCH = np.eye(6) - np.eye(6, k=-1)
"""Stretches of the joints from displacements; transposed, forces on segments from tensions."""


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
    """Absolute accelerations (bodies, n, 6) by DOP853, restarted at every sample since the seat's slope jumps there.

    seat_mps2: the seat of all bodies (n,), or one for each of them (bodies, n).
    """
    M, C, K, k, alpha = _stacked(bodies)
    inverse, weight, stiffening, count = np.linalg.inv(M), M @ np.ones(6), k * alpha, len(bodies)
    seats = np.broadcast_to(seat_mps2, (count, np.shape(seat_mps2)[-1]))[:, :, None]

    def relative_acceleration(x, v, seat):
        stretch = x @ STRETCH.T
        nonlinear = (stiffening * stretch * np.abs(stretch)) @ STRETCH
        load = weight * seat + (C @ v[..., None] + K @ x[..., None])[..., 0] + nonlinear
        return -(inverse @ load[..., None])[..., 0]

    out = np.zeros((count, seats.shape[1], 6))
    state = np.zeros((count, 2, 6))
    step = 1.0 / rate_hz
    for n in range(1, seats.shape[1]):
        before, now = seats[:, n - 1], seats[:, n]

        def slope(t, y, before=before, now=now):
            x, v = y.reshape(count, 2, 6).swapaxes(0, 1)
            acceleration = relative_acceleration(x, v, before + (now - before) * t / step)
            return np.stack([v, acceleration], axis=1).ravel()

        state = integrated(slope, state.ravel(), step, rtol, 1e-14).reshape(count, 2, 6)
        out[:, n] = relative_acceleration(state[:, 0], state[:, 1], now) + now
    return out


def integrated(slope, start, seconds, rtol, atol):
    """The state `seconds` after a start, by DOP853; solve_ivp does the same and takes twice as long to begin."""
    solver = integrate.DOP853(slope, 0.0, start, seconds, first_step=seconds, rtol=rtol, atol=atol)
    while solver.status == "running":
        solver.step()
    assert solver.status == "finished"
    return solver.y


def stepped(slope, y, seconds, count):
    """The state `seconds` after a start, by `count` steps of the classical Runge-Kutta method."""
    h = seconds / count
    for t in h * np.arange(count):
        k1 = slope(t, y)
        k2 = slope(t + 0.5 * h, y + 0.5 * h * k1)
        k3 = slope(t + 0.5 * h, y + 0.5 * h * k2)
        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + slope(t + h, y + h * k3))
    return y


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


# f1, f2, f3, f4, Q4, and of the step f5, Q5, f6, Q6 with its factor at 0 Hz. ISO 8041-1 prints (w5 / w6)^2 for that;
# Wb is taken from BS 6841, which prints K = 0.4, and not from ISO's 1.024 (2.5 / 4)^2.
INFINITE = math.inf
WEIGHTINGS = {
    "Wk": (0.4, 100.0, 12.5, 12.5, 0.63, (2.37, 0.91, 3.35, 0.91, (2.37 / 3.35) ** 2)),
    "Wd": (0.4, 100.0, 2.0, 2.0, 0.63, None),
    "Wf": (0.08, 0.63, INFINITE, 0.25, 0.86, (0.0625, 0.80, 0.10, 0.80, (0.0625 / 0.10) ** 2)),
    "Wc": (0.4, 100.0, 8.0, 8.0, 0.63, None),
    "We": (0.4, 100.0, 1.0, 1.0, 0.63, None),
    "Wj": (0.4, 100.0, INFINITE, INFINITE, 1.0, (3.75, 0.91, 5.32, 0.91, (3.75 / 5.32) ** 2)),
    "Wb": (0.4, 100.0, 16.0, 16.0, 0.55, (2.5, 0.9, 4.0, 0.95, 0.4)),
}


def weighting(name, frequency_hz):
    """The analog weighting, as ISO 8041 prints its factors: band limits, a-v transition, upward step."""
    p = 2j * math.pi * np.asarray(frequency_hz, dtype=float)
    f1, f2, f3, f4, q4, upward = WEIGHTINGS[name]
    w1, w2, w3, w4 = (2.0 * math.pi * f for f in (f1, f2, f3, f4))
    high_pass = 1.0 / (1.0 + math.sqrt(2.0) * w1 / p + (w1 / p) ** 2)
    low_pass = 1.0 / (1.0 + math.sqrt(2.0) * p / w2 + (p / w2) ** 2)
    transition = (1.0 + p / w3) / (1.0 + p / (q4 * w4) + (p / w4) ** 2)
    step = 1.0
    if upward:
        f5, q5, f6, q6, factor = upward
        w5, w6 = 2.0 * math.pi * f5, 2.0 * math.pi * f6
        step = factor * (1.0 + p / (q5 * w5) + (p / w5) ** 2) / (1.0 + p / (q6 * w6) + (p / w6) ** 2)
    return high_pass * low_pass * transition * step


def weighting_quotient(name):
    """The same as two polynomials in p, highest power first."""
    f1, f2, f3, f4, q4, upward = WEIGHTINGS[name]
    w1, w2, w3, w4 = (2.0 * math.pi * f for f in (f1, f2, f3, f4))
    top, bottom = np.array([1.0, 0.0, 0.0]), np.array([1.0, math.sqrt(2.0) * w1, w1**2])
    bottom = np.polymul(bottom, [1.0 / w2**2, math.sqrt(2.0) / w2, 1.0])
    top, bottom = np.polymul(top, [1.0 / w3, 1.0]), np.polymul(bottom, [1.0 / w4**2, 1.0 / (q4 * w4), 1.0])
    if upward:
        f5, q5, f6, q6, factor = upward
        w5, w6 = 2.0 * math.pi * f5, 2.0 * math.pi * f6
        top = factor * np.polymul(top, [1.0 / w5**2, 1.0 / (q5 * w5), 1.0])
        bottom = np.polymul(bottom, [1.0 / w6**2, 1.0 / (q6 * w6), 1.0])
    return np.trim_zeros(top, "f"), np.trim_zeros(bottom, "f")


def pulses(pieces, time_s):
    """A signal of exponentials: Re(amplitude exp(exponent (t - begin))) between begin and end, for each piece."""
    total = np.zeros(len(time_s))
    for amplitude, exponent, begin, end in pieces:
        inside = (time_s >= begin) & (time_s < end)
        total += np.where(inside, amplitude * np.exp(exponent * np.where(inside, time_s - begin, 0.0)), 0.0).real
    return total


def half_sine(peak, length_s, seconds, rate_hz, begin_s=0.02):
    """Rest and one half-sine, (n,)."""
    phase = (np.arange(round(seconds * rate_hz)) / rate_hz - begin_s) / length_s
    return peak * np.where((phase > 0.0) & (phase < 1.0), np.sin(np.pi * phase), 0.0)


def response_to_pulses(top, bottom, pieces, time_s):
    """The response of the system top(p) / bottom(p) to `pulses`, in closed form by partial fractions (simple poles)."""
    poles = np.roots(bottom)
    residues = np.polyval(top, poles) / np.polyval(np.polyder(bottom), poles)
    total = np.zeros(len(time_s))
    for amplitude, exponent, begin, end in pieces:
        edges = [(amplitude, begin)]
        if math.isfinite(end):
            edges.append((-amplitude * np.exp(exponent * (end - begin)), end))
        for sign, start in edges:
            t = np.maximum(time_s - start, 0.0)
            for pole, residue in zip(poles, residues, strict=True):
                total += (sign * residue * (np.exp(pole * t) - np.exp(exponent * t)) / (pole - exponent)).real
    return total


def slow_level(accel, rate_hz, time_constant_s):
    """Exponential mean of a signal (n,) within 1 g, sample by sample, from zero."""
    forget = math.exp(-1.0 / (time_constant_s * rate_hz))
    mean = 0.0
    for a in np.clip(accel, -GRAVITY, GRAVITY):
        mean = forget * mean + (1.0 - forget) * a
    return mean


def weighted(name, accel, rate_hz):
    """Weight a signal (n,) by its spectrum; a minute of zeros prevents wrap-around of the ringing."""
    padded = np.concatenate([accel, np.zeros(round(60.0 * rate_hz))])
    frequency = np.fft.rfftfreq(len(padded), 1.0 / rate_hz)
    gain = np.zeros(len(frequency), dtype=complex)
    gain[1:] = weighting(name, frequency[1:])
    return np.fft.irfft(np.fft.rfft(padded) * gain, len(padded))[: len(accel)]


def linear_running_rms(accel, rate_hz):
    """Rms over the last second at every sample (ISO 2631-1:1997, 6.3.1, Eq. 2), rest before the first.

    A sample represents one period; the oldest one of a second counts in part if the second is no multiple of it.
    """
    whole = math.floor(rate_hz)
    square = np.concatenate([np.zeros(whole + 1), np.asarray(accel) ** 2])
    out = []
    for n in range(1, len(accel) + 1):
        in_full, oldest = square[n + 1 : n + 1 + whole], square[n]
        out.append(math.sqrt((in_full.sum() + (rate_hz - whole) * oldest) / rate_hz))
    return np.array(out)


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
    for steps in range(1, len(accel_g)):
        duration = steps * step
        if duration > length_s + 1e-12:
            break
        best = max(best, (duration * ((integral[steps:] - integral[:-steps]) / duration) ** 2.5).max())
    return best


# --- filters and polynomials -----------------------------------------------------------------------------------------


def lagrange(time_s, values, at_s):
    """The polynomial through all points, as Lagrange wrote it."""
    total = 0.0
    for j, value in enumerate(values):
        others = np.delete(time_s, j)
        total += value * np.prod((at_s - others) / (time_s[j] - others))
    return total
