"""Seated people by the paper's equations (Zaman et al., Eq. 1-18), many side by side, integrated by DOP853."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, interpolate

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

TABLE_1: Final[Floats] = np.array(
    [[5, 15], [5, 18], [3, 15], [3, 15], [5, 20], [3, 12], *[[0.025, 0.40]] * 6, [0.1, 3.0], [0.01, 2.0], [0.85, 1.15]]
)
"""Bounds of theta (15, 2): f_n in Hz and zeta of six joints, alpha_r in rad/s, s_nl, m_scale."""

MASS_FRACTION: Final[Floats] = np.array([0.099, 0.117, 0.162, 0.126, 0.018, 0.059])
STIFFENING_PER_M: Final[Floats] = np.array([30.0, 25.0, 20.0, 15.0, 8.0, 4.0])
BODY_MASS_KG: Final = (50.0, 100.0)

RELATIVE_TOLERANCE: Final = 1e-8
ABSOLUTE_TOLERANCE: Final = 1e-11
"""In m and m/s: accelerations are right to some 1e-6 m/s^2."""

SPLINE_SAMPLES: Final = 50
"""A cubic spline shows a sample this far ahead 0.27 to this power as large."""


@dataclass(frozen=True, eq=False)
class People:
    """Some people: theta (p, 15), body mass (p,) kg, and whether M holds cascade masses as Eq. 7 prints it (p,)."""

    theta: Floats
    body_mass_kg: Floats
    cascade: Flags

    def __len__(self) -> int:
        return len(self.theta)

    @property
    def segment_mass_kg(self) -> Floats:
        """Eq. 5, (p, 6)."""
        return self.theta[:, 14:] * self.body_mass_kg[:, None] * MASS_FRACTION

    @property
    def carried_mass_kg(self) -> Floats:
        """Mass carried by each joint, the cascade masses (p, 6)."""
        mass = self.segment_mass_kg
        return mass.sum(axis=1, keepdims=True) - np.cumsum(mass, axis=1) + mass

    @property
    def inertia_kg(self) -> Floats:
        """The diagonal of M, (p, 6)."""
        return np.where(self.cascade[:, None], self.carried_mass_kg, self.segment_mass_kg)


def drawn(count: int, rng: np.random.Generator) -> People:
    """People drawn evenly from the whole of Table 1, under either mass convention in turn."""
    theta = rng.uniform(TABLE_1[:, 0], TABLE_1[:, 1], (count, len(TABLE_1)))
    return People(theta, rng.uniform(*BODY_MASS_KG, count), np.arange(count) % 2 == 1)


JointForce = Callable[[Floats, Floats], Floats]
"""Forces of the joints (..., p, 6) N by their stretch (..., p, 6) m and its rate (..., p, 6) m/s."""


def paper_joints(people: People) -> JointForce:
    """The paper's joints: springs that stiffen with stretch, and dampers (Eq. 8, 11, 15-17)."""
    carried = people.carried_mass_kg
    stiffness = (2.0 * np.pi * people.theta[:, :6]) ** 2 * carried
    damping = 2.0 * people.theta[:, 6:12] * np.sqrt(stiffness * carried)
    stiffening = people.theta[:, 13:14] * STIFFENING_PER_M

    def force(stretch: Floats, rate: Floats) -> Floats:
        return stiffness * stretch * (1.0 + stiffening * np.abs(stretch)) + damping * rate

    return force


def accelerations(
    people: People,
    rate_hz: float,
    seat_mps2: Floats,
    joints: Callable[[People], JointForce] = paper_joints,
    piece_s: float = math.inf,
) -> Floats:
    """Absolute accelerations (p, n, 6) from rest on seats (n, p) at rate_hz, cubic splines between samples.

    A long motion is integrated in pieces of piece_s, each from the end of the one before: the solver keeps every step.
    Before the first motion of a seat, but for the `SPLINE_SAMPLES` in which the spline shows it, all stays at rest.
    """
    force, inertia, alpha_r = joints(people), people.inertia_kg, people.theta[:, 12:13]
    shape, time_s = (2, len(people), 6), np.arange(len(seat_mps2)) / rate_hz
    pieces = interpolate.CubicSpline(time_s, seat_mps2).c  # (4, n - 1, p)
    last = pieces.shape[1] - 1

    def seat(t: float) -> Floats:
        piece = min(int(t * rate_hz), last)
        since = t - time_s[piece]
        a, b, c, d = pieces[:, piece]
        return ((a * since + b) * since + c) * since + d

    def upward(state: Floats) -> Floats:
        """Absolute acceleration (..., p, 6) of each segment from the forces of joints and Rayleigh damping."""
        motion = state.copy()  # of the joints: np.diff does the same and takes longer than all the rest
        motion[..., 1:] -= state[..., :-1]
        below = force(*motion)
        both = 0.0 - below
        both[..., :-1] += below[..., 1:]
        return both / inertia - alpha_r * state[1]

    def slope(t: float, flat: Floats) -> Floats:
        state, out = flat.reshape(shape), np.empty(shape)
        out[0] = state[1]
        out[1] = upward(state) - seat(t)[:, None]
        return out.ravel()

    answer, state = np.zeros((time_s.size, len(people), 6)), np.zeros(shape).ravel()
    moving = np.flatnonzero(np.any(seat_mps2, axis=1))
    begin = max(0, int(moving[0]) - SPLINE_SAMPLES) if moving.size else time_s.size
    most = max(2, round(min(piece_s * rate_hz, time_s.size)))
    while begin < time_s.size - 1:
        here_s = time_s[begin : begin + most]
        # While the seat rests the squares of errors underflow to 0 / 0; the solver then tries a shorter step.
        with np.errstate(invalid="ignore"):
            found = integrate.solve_ivp(
                slope, (here_s[0], here_s[-1]), state, "DOP853", here_s,
                rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE, max_step=4e-3,
            )  # fmt: skip
        answer[begin : begin + here_s.size] = upward(np.moveaxis(found.y.reshape(*shape, -1), -1, 1))
        state, begin = found.y[:, -1], begin + here_s.size - 1
    return answer.swapaxes(0, 1)
