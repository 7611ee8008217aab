"""The ODE: time and error of 5 s of simulation at the native rate; SciPy at the paper's ode45 settings as baseline."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from bench.table import Row, render
from biodyn_core.base.segments import N_SEGMENTS
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis import load_case
from biodyn_core.body.synthesis_settings import CASES, NATIVE_RATE_HZ
from biodyn_ros.base.resources import subject_file

SECONDS = 5.0
ROUNDS = 5
REPEATS = 40  # of ours in each round, a tenth of the time of SciPy

Floats = NDArray[np.float64]
Slope = Callable[[float, Floats], Floats]


def rows() -> list[Row]:
    """Measure; about half a minute, most of it for the reference solutions."""
    chain = Chain.of(load_subject(subject_file("subject_1")))
    seats = {
        name: load_case(name, SECONDS, np.random.default_rng(0), NATIVE_RATE_HZ).accel_mps2[:, 2] for name in CASES
    }
    ours_ms, paper_ms = _times_ms(chain, seats["road"])
    what, paper = "5 s simulation, one core", "SciPy RK45, the paper's settings"
    errors = {name: _errors(chain, seat) for name, seat in seats.items()}
    return [
        Row(what, ours_ms, "ms", None, "", "<= 0.3", ours_ms <= 0.3),
        Row(what, ours_ms, "ms", paper_ms, paper, ">= 2,000 x faster", paper_ms >= 2000.0 * ours_ms),
        *(
            Row(f"its error, {name}", mine, "relative", theirs, paper, "<= 1e-6", mine <= 1e-6)
            for name, (mine, theirs) in errors.items()
        ),
    ]


def _times_ms(chain: Chain, seat: Floats) -> tuple[float, float]:
    """Medians of ours and of SciPy, alternating."""
    stepper = Stepper(chain, NATIVE_RATE_HZ)
    stepper.push(seat)  # compiles
    ours, paper = [], []
    for _ in range(ROUNDS):
        for _ in range(REPEATS):
            stepper.reset()
            ours.append(_seconds(lambda: stepper.push(seat)))
        paper.append(_seconds(lambda: rk45(chain, seat)))
    return 1e3 * statistics.median(ours), 1e3 * statistics.median(paper)


def _seconds(task: Callable[[], object]) -> float:
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def _errors(chain: Chain, seat: Floats) -> tuple[float, float]:
    """Relative rms error of all accelerations, ours and the paper's settings', against the reference."""
    truth = _reference(chain, seat)
    ours, paper = Stepper(chain, NATIVE_RATE_HZ).push(seat), rk45(chain, seat)
    return tuple(float(np.linalg.norm(found - truth) / np.linalg.norm(truth)) for found in (ours, paper))


def _slope(chain: Chain, seat_at: Callable[[float], float]) -> Slope:
    """The state's derivative by Eq. 4, 17 and 18, with full matrices."""
    inverse, damping, stiffness = np.linalg.inv(chain.M), chain.C, chain.K
    k_alpha = chain.stiffness_n_per_m * chain.stiffening_per_m

    def slope(t: float, y: Floats) -> Floats:
        x, v = y[:N_SEGMENTS], y[N_SEGMENTS:]
        stretch = x - np.concatenate(([0.0], x[:-1]))
        joint = k_alpha * stretch * np.abs(stretch)
        nonlinear = joint - np.concatenate((joint[1:], [0.0]))
        return np.concatenate((v, -inverse @ (damping @ v + stiffness @ x + nonlinear) - seat_at(t)))

    return slope


def rk45(chain: Chain, seat: Floats) -> Floats:
    """SciPy RK45 as the paper sets ode45, seat by np.interp: absolute accelerations (n, 6)."""
    times = np.arange(len(seat)) / NATIVE_RATE_HZ
    slope = _slope(chain, lambda t: np.interp(t, times, seat))
    span, rest = (0.0, times[-1]), np.zeros(2 * N_SEGMENTS)
    found = solve_ivp(slope, span, rest, "RK45", t_eval=times, rtol=1e-6, atol=1e-9, max_step=1e-3)
    return np.array([slope(t, y)[N_SEGMENTS:] for t, y in zip(times, found.y.T, strict=True)]) + seat[:, None]


def _reference(chain: Chain, seat: Floats) -> Floats:
    """DOP853 to 1e-13, restarted at every sample, because the seat's slope is discontinuous there."""
    accel, state, step = np.zeros((len(seat), N_SEGMENTS)), np.zeros(2 * N_SEGMENTS), 1.0 / NATIVE_RATE_HZ
    for n in range(1, len(seat)):
        before, rise = seat[n - 1], (seat[n] - seat[n - 1]) / step
        slope = _slope(chain, lambda t, before=before, rise=rise: before + rise * t)
        found = solve_ivp(slope, (0.0, step), state, "DOP853", rtol=1e-13, atol=1e-15, first_step=step)
        state = found.y[:, -1]
        accel[n] = slope(step, state)[N_SEGMENTS:] + seat[n]
    return accel


if __name__ == "__main__":
    print(render(rows()))
