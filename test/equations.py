"""The equations of the effects written again from the catalogue, and their integration by DOP853."""

import math
from functools import cache, partial

import naive
import numpy as np
import streams

from biodyn_core.base.segments import SEGMENTS, SENSORS
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect

RATE_HZ = 1129.3
SUBJECT = streams.subject()


@cache
def channels(samples: int) -> dict[str, np.ndarray]:
    """Horizontal and angular motion of every sensor, (n,) each, from rest."""
    time = np.arange(samples) / RATE_HZ
    shapes = {"x": (20.0, 40.0), "y": (10.0, 25.0), "rate_x": (0.5, 12.0), "rate_y": (1.0, 9.0), "rate_z": (0.1, 5.0)}
    shapes |= {"bend_rate_x": (0.8, 14.0), "bend_rate_y": (1.0, 11.0)}
    return {
        f"{sensor}.{name}": size * time * np.sin(omega * time + len(sensor))
        for sensor in SENSORS
        for name, (size, omega) in shapes.items()
    }


def bent(size, at, p):
    """The factor that generalises a law, 1 for an exponent of 0."""
    return (1.0 + abs(size) / at) ** p["exponent"]


def law(name: str, p: dict[str, float], k: float, k_alpha: float, b: float, own_mass: float, past, samples: int):
    """Number of own states, and a function (extra force, rates of own states) of time, stretch, rate, seat and states.

    past is filled with times and stretches as they come.
    """
    driven, times = channels(samples), np.arange(samples) / RATE_HZ

    def driving(*names: str) -> np.ndarray:
        return lambda t: np.array([np.interp(t, times, driven[one]) for one in names])

    plain = {
        "asymmetry": lambda d, r: k * p["asymmetry_per_m"] * d**2 * bent(d, 0.001, p),
        "cubic": lambda d, r: k * p["cubic_per_m2"] * d**3 * bent(d, 0.001, p),
        "stop": lambda d, r: stopping(p, k, d),
        "quadratic_damping": lambda d, r: b * p["growth_s_per_m"] * r * abs(r) * bent(r, 0.02, p),
        "backrest": lambda d, r: (
            -p["stiffness_n_per_m"] * (d + p["cubic_per_m2"] * d**3 + p["damping_s"] * r)
            - p["friction_n"] * r / math.hypot(r, p["smooth_mps"])
        ),
        "harness": lambda d, r: held_down(p, max(0.0, d - p["slack_m"]), r),
    }
    if name in plain:
        return 0, lambda t, d, r, s, q: (plain[name](d, r), [])
    omega = 2.0 * math.pi
    bending_rates, seat_sides = driving("neck.bend_rate_x", "neck.bend_rate_y"), driving("seat.x", "seat.y")
    stateful = {
        "friction": (1, lambda t, d, r, s, q: (
            p["friction_n"] * q[0] * (1.0 + p["stribeck"] * math.exp(-abs(r) / p["stribeck_mps"])),
            [min((abs(r) + p["smooth_mps"]) / p["presliding_m"], 1000.0) * (r / math.hypot(r, p["smooth_mps"]) - q[0])],
        )),
        "hysteresis": (1, lambda t, d, r, s, q: (
            p["yield_n"] * q[0],
            [r / p["yield_m"] * (1 - abs(q[0]) ** p["exponent"] * (1.0 if r * q[0] > 0 else p["unloading"]))],
        )),
        "relaxation": (2, lambda t, d, r, s, q: (
            p["stiffness_ratio"] * k * (d - q[0] + p["second_share"] * (d - q[1])),
            [(d - q[0]) / p["tau_s"], (d - q[1]) / p["second_tau_s"]],
        )),
        "thixotropy": (1, lambda t, d, r, s, q: (
            -p["softening"] * q[0] * (k * d + p["damping_share"] * b * r),
            [((abs(r) / p["rate_mps"]) ** p["exponent"] * (1 - q[0]) - q[0]) / p["tau_s"]],
        )),
        "posture": (0, lambda t, d, r, s, q: (
            p["jump"] * changed(p, t) * (k * d + p["damping_share"] * b * r), [],
        )),
        "periodic": (0, lambda t, d, r, s, q: (
            own_mass * (p["cosine_mps2"] * math.cos(omega * p["frequency_hz"] * t)
                        + p["sine_mps2"] * math.sin(omega * p["frequency_hz"] * t)), [],
        )),
        "viscera": (2, lambda t, d, r, s, q: resonator(p, p["natural_frequency_hz"], d, r, s, q)),
        "added_mass": (2, lambda t, d, r, s, q: resonator(p, p["liner_hz"], d, r, s, q)),
        "cushion": (3, lambda t, d, r, s, q: foam(p, k, k_alpha, b, d, r, s, q)),
        "bending": (2, lambda t, d, r, s, q: nodding(p, k, b, q, bending_rates(t))),
        "reflex": (2, lambda t, d, r, s, q: responding(p, k, q, np.interp(t - p["delay_s"], *past, left=0.0))),
        "cross_axis": (2, lambda t, d, r, s, q: coupled(p, own_mass, q, seat_sides(t))),
    }  # fmt: skip
    return stateful[name]


def stopping(p, k, d):
    beyond = -d - p["gap_m"]
    if p["knee_m"]:
        at_rest = np.logaddexp(0.0, -p["gap_m"] / p["knee_m"])
        depth = p["knee_m"] * (np.logaddexp(0.0, beyond / p["knee_m"]) - at_rest)
    else:
        depth = beyond
    return -p["stiffness_ratio"] * k * max(0.0, depth) * bent(max(0.0, depth), 0.001, p)


def held_down(p, u, r):
    return -p["stiffness_n_per_m"] * u * (1.0 + u / 0.01) ** p["hardening"] * max(0.0, 1.0 + p["loss_s_per_m"] * r)


def changed(p, t):
    if p["width_s"]:
        return 0.5 + 0.5 * math.tanh((t - p["at_s"]) / p["width_s"])
    return 1.0 if t >= p["at_s"] - 1e-12 else 0.0


def responding(p, k, q, late):
    """The two lags as one equation of second order, in q[0] and its rate q[1]."""
    response, rates = late, [0.0, 0.0]
    if p["lag_s"] or p["lead_s"]:
        lag_s = p["lag_s"] + 0.002
        response, rates = q[0] + p["lead_s"] * q[1], [q[1], (late - q[0] - 2.0 * lag_s * q[1]) / lag_s**2]
    return k * p["gain"] * response / math.hypot(1.0, p["saturation_per_m"] * response), rates


def coupled(p, own_mass, q, sides):
    omega = 2.0 * math.pi * p["corner_hz"]
    driving = own_mass * (p["beta_x"] * sides[0] + p["beta_y"] * sides[1])
    return q[0], [q[1], omega**2 * (driving - q[0]) - 2.0 * p["damping_ratio"] * omega * q[1]]


def foam(p, k, k_alpha, b, d, r, s, q):
    stretch, rate = d - q[0], r - q[1]
    tension = k * stretch + k_alpha * stretch * abs(stretch) + b * rate
    hardened = q[0] * (1 + p["stiffening_per_m"] * abs(q[0])) + p["creep_ratio"] * (q[0] - q[2])
    own = tension - (hardened + p["damping_s"] * q[1]) / p["compliance_m_per_n"]
    creep = (q[0] - q[2]) / p["creep_s"]
    return tension - (k * d + k_alpha * d * abs(d) + b * r), [q[1], own / p["mass_kg"] - s, creep]


def turned(angle_rad):
    """From components along x and y to those along an axis and across it."""
    return np.array([[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]])


def nodding(p, k, b, q, rates):
    turn, slopes = turned(p["axis_rad"]), rates - 0.5 * q
    (angle, other), (slope, turning), rest = turn @ q, turn @ slopes, p["rest_rad"]
    spring = 0.5 * k * ((angle + rest) ** 2 - rest**2 + p["across"] * other**2)
    return p["length_m"] * (spring + b * ((angle + rest) * slope + p["across"] * other * turning)), slopes


def resonator(p, frequency_hz, d, r, s, q):
    omega, held = 2 * math.pi * frequency_hz, (2 * math.pi * p.get("held_hz", 0.0)) ** 2
    spring = omega**2 * (q[0] - d) * bent(q[0] - d, 0.01, p)
    pull = p["mass_kg"] * (spring + 2 * p["damping_ratio"] * omega * (q[1] - r))
    return pull, [q[1], -pull / p["mass_kg"] - held * (q[0] + 0.01 * q[1]) - s]


def carried(p, whole, rate, weight, b):
    """The tension of a contact by Hunt and Crossley, from the tension without it: elastic part and damper apart."""
    elastic = weight - (whole - b * rate)
    share = 1.0 - p["fading"] * (1.0 - np.clip(elastic / weight, 0.0, 1.0))
    contact = elastic - b * rate * share
    return weight - (p["width_n"] * np.logaddexp(0.0, contact / p["width_n"]) if p["width_n"] else max(contact, 0.0))


def twin(effect: AppliedEffect, seat: np.ndarray, subject: Subject = SUBJECT, rate_hz: float = RATE_HZ) -> np.ndarray:
    """Absolute accelerations (n, 6) with one effect, by DOP853 from the paper's matrices, restarted at every sample."""
    theta = subject.parameters.vector()
    M, C, K, k, alpha = naive.chain_matrices(theta, subject.body_mass_kg, subject.mass_matrix)
    at, on_joint = SEGMENTS.index(effect.site), effect.effect.place == "joint"
    mass = np.diag(M)
    b = 2.0 * theta[6:12] * np.sqrt(k * np.cumsum(mass[::-1])[::-1])
    weight = 9.80665 * mass[at:].sum()
    step = 1.0 / rate_hz
    times, stretches = step * np.arange(len(seat)), np.zeros(len(seat))
    past = [times[:1], stretches[:1]]
    extra, count = None, 0
    if effect.effect.name != "lift_off":
        count, extra = law(
            effect.effect.name, dict(effect.values), k[at], k[at] * alpha[at], b[at], mass[at], past, len(seat)
        )

    def slope(t, y, t0, before, rise):
        x, v, q = y[:6], y[6:12], y[12:]
        s = before + rise * (t - t0)
        stretch, rate = naive.STRETCH @ x, naive.STRETCH @ v
        tension = k * alpha * stretch * np.abs(stretch)
        on = np.zeros(6)
        own = []
        if extra is None:  # lift_off: the seat joint in all carries no more than the weight
            whole = (k[0] * stretch[0] + b[0] * rate[0]) + tension[0]
            tension[0] += carried(dict(effect.values), whole, rate[0], weight, b[0]) - whole
        else:
            force, own = extra(t, *((stretch[at], rate[at]) if on_joint else (x[at], v[at])), s, q)
            (tension if on_joint else on)[at] += force
        a = (on - C @ v - K @ x - tension @ naive.STRETCH) / mass - s
        return np.concatenate([v, a, own])

    out, y = np.zeros((len(seat), 6)), np.zeros(12 + count)
    for n in range(1, len(seat)):
        t0, rise = times[n - 1], (seat[n] - seat[n - 1]) / step
        here = partial(slope, t0=t0, before=seat[n - 1], rise=rise)
        y = naive.integrated(lambda t, y, t0=t0, here=here: here(t0 + t, y), y, step, 1e-8, 1e-11)
        stretches[n] = (naive.STRETCH @ y[:6])[at]
        past[:] = times[: n + 1], stretches[: n + 1]
        out[n] = here(t0 + step, y)[6:12] + seat[n]
    return out
