"""Mechanisms of the background in all joints or segments of a body.

Sizes are rms over joints at scale 1. They leave a residual after a refit that is similar to that of the paper's kind;
`mixture.CHANGES` has the share of the plain response that each changes. No law makes a body unstable: it is passive, or
follows the input alone, or leaves stiffness and damping positive while they change within seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world.effects.effect import Moment, Person
from world.effects.event import Event, following
from world.effects.mechanism import Mechanism, half_normal, log_uniform
from world.seats import RATE_HZ

if TYPE_CHECKING:
    from typing_extensions import Self

Floats = NDArray[np.float64]

YIELD: Final = 0.05
"""Yield force over the spring's force at the reach."""

BRANCH: Final = 0.20
"""Stiffness of each branch over that of the joint."""

MASS: Final = 0.08
"""Sprung mass over the mass of its segment: loose tissue, clothes and equipment."""

ACROSS: Final = 0.12
"""Vertical force over inertia per horizontal acceleration, below the resonance."""

SOFTENED: Final = 0.20
MOST_SOFTENED: Final = 0.6
"""Share of stiffness lost where the structure is broken down, and its limit."""

DRIFT: Final = 0.15
MOST_DRIFT: Final = 0.5
"""Change of stiffness over the sitting as a share, and its limit."""


@dataclass(frozen=True, eq=False)
class Hysteresis(Mechanism):
    """Friction in every joint that is a spring before it slips (Dahl, 1968)."""

    yield_n: Floats
    slip_m: Floats

    in_body, states = True, 6

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Slips of 0.1 to 0.4 of the reach."""
        share = half_normal(YIELD, scale, rng)
        return cls(share * person.stiffness_n_per_m * person.reach_m, log_uniform(0.1, 0.4, rng) * person.reach_m)

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = Fy z, z' = (v - |v| z) / d."""
        now.joint_n += self.yield_n * own
        return (now.rate - np.abs(now.rate) * own) / self.slip_m


@dataclass(frozen=True, eq=False)
class Relaxation(Mechanism):
    """Every joint relaxes by a Prony series of two branches (quasi-linear viscoelasticity: Fung, 1993)."""

    fast_n_per_m: Floats
    slow_n_per_m: Floats
    fast_s: Floats
    slow_s: Floats

    in_body, states = True, 12

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Time constants of 10 to 40 ms and of 0.1 to 1 s."""
        fast, slow = (half_normal(BRANCH, scale, rng) * person.stiffness_n_per_m for _ in range(2))
        return cls(fast, slow, log_uniform(0.01, 0.04, rng), log_uniform(0.1, 1.0, rng))

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = k1 (s - q1) + k2 (s - q2), q' = (s - q) / tau."""
        fast, slow = now.stretch - own[:, :6], now.stretch - own[:, 6:]
        now.joint_n += self.fast_n_per_m * fast + self.slow_n_per_m * slow
        return np.hstack([fast / self.fast_s, slow / self.slow_s])


@dataclass(frozen=True, eq=False)
class SprungMasses(Mechanism):
    """Small masses on springs on about half of the segments: wobbling masses (Gruber et al., 1998)."""

    mass_kg: Floats
    omega_radps: Floats
    damping: Floats

    in_body, states = True, 12

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Of 3 to 20 Hz and damping ratios of 0.1 to 0.4."""
        there = rng.permutation(6) < rng.integers(2, 5)
        mass = there * half_normal(MASS, scale, rng) * person.inertia_kg
        return cls(mass, 2.0 * np.pi * log_uniform(3.0, 20.0, rng), rng.uniform(0.1, 0.4, 6))

    def act(self, now: Moment, own: Floats) -> Floats:
        """Per kg: w^2 (x - z) + 2 zeta w (v - z')."""
        z, rate = own[:, :6], own[:, 6:]
        per_kg = self.omega_radps**2 * (now.x - z) + 2.0 * self.damping * self.omega_radps * (now.v - rate)
        now.up_n -= self.mass_kg * per_kg
        return np.hstack([rate, per_kg - now.base_mps2[:, None]])


@dataclass(frozen=True, eq=False)
class HorizontalCoupling(Mechanism):
    """Horizontal seat motion presses every segment up and down, through one resonance for each segment and axis.

    Cross-axis response of seated people: Nawayseh and Griffin, 2003.
    """

    across_kg: Floats
    frequency_hz: Floats
    damping: Floats

    in_body = True

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Resonances of 2 to 12 Hz; fields (6, 2) by segment and axis."""
        gain = scale * ACROSS * rng.standard_normal((6, 2))
        return cls(
            gain * person.inertia_kg[:, None], log_uniform(2.0, 12.0, rng, (6, 2)), rng.uniform(0.2, 0.5, (6, 2))
        )

    def signals(self, event: Event) -> Floats:
        """The forces, N, (n, 6)."""
        force = np.zeros((len(event.accel_mps2), 6))
        for segment, axis in np.ndindex(6, 2):
            behind = following(self.frequency_hz[segment, axis], self.damping[segment, axis], RATE_HZ)
            force[:, segment] += self.across_kg[segment, axis] * signal.lfilter(*behind, event.accel_mps2[:, axis])
        return force

    def act(self, now: Moment, own: Floats) -> None:
        """Push the segments."""
        now.up_n += now.signal


@dataclass(frozen=True, eq=False)
class Softening(Mechanism):
    """Motion softens every joint, and rest stiffens it again: thixotropy (Huang and Griffin, 2008)."""

    lost_n_per_m: Floats
    lost_ns_per_m: Floats
    rebuilt_s: Floats
    broken_per_mps: Floats

    in_body, states = True, 6

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Structure builds up within 2 to 10 s; damping is lost by up to the same share as stiffness."""
        lost = np.minimum(half_normal(SOFTENED, scale, rng), MOST_SOFTENED)
        return cls(
            lost * person.stiffness_n_per_m,
            lost * rng.uniform(0.0, 1.0, 6) * person.damping_ns_per_m,
            log_uniform(2.0, 10.0, rng),
            log_uniform(0.5, 3.0, rng) / person.rate_mps,
        )

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = -g (k s + b v), g' = (c |v| (1 - g) - g) / tau."""
        now.joint_n -= own * (self.lost_n_per_m * now.stretch + self.lost_ns_per_m * now.rate)
        return (self.broken_per_mps * np.abs(now.rate) * (1.0 - own) - own) / self.rebuilt_s


@dataclass(frozen=True, eq=False)
class StiffnessDrift(Mechanism):
    """The stiffness of every joint changes slowly over the sitting: creep of tissue, fatigue and posture."""

    stiffness_n_per_m: Floats
    slope: Floats
    wave: Floats
    phase_rad: Floats

    in_body = True

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """A trend, and one period over the sitting."""
        slope, wave = scale * DRIFT * rng.standard_normal((2, 6))
        return cls(person.stiffness_n_per_m, slope, wave, rng.uniform(0.0, 2.0 * np.pi, 6))

    def act(self, now: Moment, own: Floats) -> None:
        """F = c(t) k s, c limited by a hyperbolic tangent; t runs from 0 to 1 over the sitting."""
        t = now.share[:, None]
        free = self.slope * (2.0 * t - 1.0) + self.wave * np.sin(2.0 * np.pi * t + self.phase_rad)
        now.joint_n += MOST_DRIFT * np.tanh(free / MOST_DRIFT) * self.stiffness_n_per_m * now.stretch
