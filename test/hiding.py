"""Events with a hidden effect, integrated by the Runge-Kutta method from full matrices, all of a body at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache

import fitting
import naive
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.settings import BASE

Floats = NDArray[np.float64]
Law = Callable[[Floats, Floats], Floats]
Change = Callable[[Floats], Floats]

TRUTH = fitting.true_subjects()["segment"]
SECONDS = 5.0
NOISE_MPS2 = 0.02
NECK, HEAD = 3, 4
"""Columns of the measured segments."""


def applied(name: str, site: str | None = None, **values: float) -> AppliedEffect:
    """An effect with its start values but for those given."""
    effect = CATALOGUE[name]
    start = {parameter.name: parameter.start for parameter in effect.parameters}
    return AppliedEffect(effect, site or effect.sites[0], start | values)


def answers(seats: Floats, law: Law) -> Floats:
    """Absolute accelerations (e, n, 6) to seats (e, n); a law gives more tension (e, 6) for stretch and rate (e, 6)."""
    M, C, K, k, alpha = matrices()
    events, step = len(seats), 1.0 / fitting.RATE_HZ
    by_x, by_v, by_tension = (-(np.linalg.inv(M) @ one).T for one in (K, C, naive.STRETCH.T))
    stiffening = k * alpha

    def acceleration(x: Floats, v: Floats, seat: Floats) -> Floats:
        stretch, rate = x @ naive.STRETCH.T, v @ naive.STRETCH.T
        tension = stiffening * stretch * np.abs(stretch) + law(stretch, rate)
        return x @ by_x + v @ by_v + tension @ by_tension - seat[:, None]

    out, y = np.zeros((*seats.shape, 6)), np.zeros((2, events, 6))
    for n in range(1, seats.shape[1]):
        before, rise = seats[:, n - 1], (seats[:, n] - seats[:, n - 1]) / step

        def slope(t: float, y: Floats, before: Floats = before, rise: Floats = rise) -> Floats:
            return np.stack([y[1], acceleration(*y, before + rise * t)])

        y = naive.stepped(slope, y, step, 2)  # to 1e-3 m/s^2 rms, less than a tenth of the noise
        out[:, n] = acceleration(*y, seats[:, n]) + seats[:, n, None]
    return out


@cache
def matrices() -> tuple[Floats, ...]:
    """M, C, K, and k and alpha of the joints, of the true body."""
    return naive.chain_matrices(fitting.theta_of(TRUTH), TRUTH.body_mass_kg, TRUTH.mass_matrix)


@cache
def stiffness_and_damping() -> tuple[Floats, Floats]:
    """N/m and N s/m of the joints, (6,) each, from the paper's matrices."""
    M, _, _, k, _ = matrices()
    return k, 2.0 * fitting.theta_of(TRUTH)[6:12] * np.sqrt(k * np.cumsum(np.diag(M)[::-1])[::-1])


def nothing(measured: Floats) -> Floats:
    return measured


def louder(measured: Floats) -> Floats:
    measured[:, NECK] *= 1.1
    return measured


def far_louder(measured: Floats) -> Floats:
    """Twice the range of a gain."""
    measured[:, NECK] *= 1.6
    return measured


def later(measured: Floats) -> Floats:
    time = np.arange(len(measured)) / fitting.RATE_HZ
    measured[:, HEAD] = np.interp(time - 0.004, time, measured[:, HEAD])
    return measured


def on_skin(measured: Floats) -> Floats:
    """30 Hz, a damping ratio of 0.3, by another discretisation than the package's."""
    w = 2.0 * np.pi * 30.0
    b, a = signal.bilinear([0.6 * w, w * w], [1.0, 0.6 * w, w * w], fitting.RATE_HZ)
    measured[:, HEAD] = signal.lfilter(b, a, measured[:, HEAD])
    return measured


def plain(stretch: Floats, rate: Floats) -> Floats:
    """No law more than the body has."""
    return np.zeros_like(stretch)


def orifice(stretch: Floats, rate: Floats) -> Floats:
    """Quadratic damping of the seat's joint, 4 s/m."""
    out = np.zeros_like(stretch)
    out[:, 0] = 4.0 * stiffness_and_damping()[1][0] * rate[:, 0] * np.abs(rate[:, 0])
    return out


def stiffening(stretch: Floats, rate: Floats) -> Floats:
    """A cubic seat's joint, 1e6 1/m^2: at 1 mm it pulls twice as hard."""
    out = np.zeros_like(stretch)
    out[:, 0] = 1e6 * stiffness_and_damping()[0][0] * stretch[:, 0] ** 3
    return out


def one_sided(stretch: Floats, rate: Floats) -> Floats:
    """Half as much stiffness again of the seat's joint in compression only."""
    out = np.zeros_like(stretch)
    out[:, 0] = 0.5 * stiffness_and_damping()[0][0] * np.minimum(stretch[:, 0], 0.0)
    return out


def thrown(stretch: Floats, rate: Floats) -> Floats:
    """A seat without tension: the total force of its joint is at most the weight."""
    M, _, _, k, alpha = matrices()
    d, r, b = stretch[:, 0], rate[:, 0], stiffness_and_damping()[1]
    whole = k[0] * d * (1.0 + alpha[0] * np.abs(d)) + b[0] * r
    out = np.zeros_like(stretch)
    out[:, 0] = np.minimum(whole, 9.80665 * np.trace(M)) - whole
    return out


QUICK_BASE = dataclasses.replace(BASE, refined_starts=1, swarm=SwarmSettings(particles=20, iterations=30, starts=1))
"""It ends in the same minimum as BASE: the subject that the fit begins with is the truth, or near to it."""

KINDS = ("road", "pothole", "rail")
EVENTS = 9
LAWS: tuple[Law, ...] = (plain, orifice, stiffening, one_sided, thrown)


@cache
def seats() -> Floats:
    """Seats (EVENTS, n): road, pothole and rail in turn, each once only."""
    return np.stack([fitting.seat_motion(KINDS[i % len(KINDS)], SECONDS, 20 + i) for i in range(EVENTS)])


@cache
def answered() -> Floats:
    """Absolute accelerations (laws, EVENTS, n, 6) of the true body with every law in turn."""
    rows = {law: slice(EVENTS * number, EVENTS * (number + 1)) for number, law in enumerate(LAWS)}
    del rows[plain]

    def each(stretch: Floats, rate: Floats) -> Floats:
        out = np.zeros_like(stretch)
        for law, of_law in rows.items():
            out[of_law] = law(stretch[of_law], rate[of_law])
        return out

    return answers(np.tile(seats(), (len(LAWS), 1)), each).reshape(len(LAWS), EVENTS, -1, 6)


def events(count: int, change: Change = nothing, law: Law = plain) -> tuple[Case, ...]:
    """The first `count` events of the true body with a law in it, measured segments (n, 5) changed and noisy."""
    return _events(change, law)[:count]


@cache
def _events(change: Change, law: Law) -> tuple[Case, ...]:
    rng, made = np.random.default_rng(4), []
    for number, (seat, accel) in enumerate(zip(seats(), answered()[LAWS.index(law)], strict=True)):
        kind = KINDS[number % len(KINDS)]
        recording = fitting.recording(seat, accel, kind)
        measured = change(recording.measured_mps2.copy())
        measured += fitting.low_passed(NOISE_MPS2 * rng.standard_normal(measured.shape))
        recording = dataclasses.replace(recording, name=f"{kind} {number}", measured_mps2=measured)
        made.append(Case.of(recording, fitting.SPECTRUM, fitting.LINES))
    return tuple(made)


def fitted(change: Change = nothing, law: Law = plain) -> Subject:
    """The body fitted to the first three events without an effect."""
    return _nuisance(change, law).subject


def nuisance(change: Change = nothing, law: Law = plain) -> NuisanceModel:
    """The nuisance model of three events for fitting and three for choosing, about the body fitted to the first."""
    return _nuisance(change, law)


@cache
def _nuisance(change: Change, law: Law) -> NuisanceModel:
    cases = events(6, change, law)
    return NuisanceModel.of(fit_joint(cases[:3], TRUTH, 1, QUICK_BASE).subject, cases[:3], cases[3:])
