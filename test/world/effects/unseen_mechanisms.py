"""Further mechanisms of the background, for scoring alone: nothing is trained or adjusted on them.

Sizes are as in `body_mechanisms` and `sensor_mechanisms`: at scale 1 they change the response by shares that are
similar to those of the known kinds (`mixture.CHANGES`). No law makes a body unstable: its own force gives no energy, or
it changes stiffness and damping by limited shares within seconds. The sensor of the seat (0) is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world.effects.effect import Moment, Person
from world.effects.event import HELD_HZ, Event, following
from world.effects.mechanism import Mechanism, half_normal, log_uniform
from world.effects.sensor_mechanisms import white

if TYPE_CHECKING:
    from typing_extensions import Self

Floats = NDArray[np.float64]

PAST: Final = 0.10
"""Stiffness of tissue across two joints over that of both joints in series."""

TONE: Final = 0.10
MOST_TONE: Final = 0.5
"""Change of stiffness and of damping with the breath as a share, and its limit."""

SHIFT: Final = 0.05
"""Shift of a joint's rest by the breath over its reach."""

BREATH_HZ: Final = (0.2, 0.35)
DEEPER: Final = 0.5
"""How much deeper and shallower breaths become, as a share."""

POWER: Final = 0.30
POWER_HZ: Final = 5.0
ORDER: Final = (0.15, 0.45)
"""Modulus of the power law at `POWER_HZ` over stiffness, and its exponent."""

STEP: Final = 10.0**0.75
BRANCHES_PER_S: Final = 2.0 * np.pi * 0.1 * STEP ** np.arange(5)
"""Rates of the branches of the power law, 0.1 to 100 Hz, and the factor between two of them."""

FLOW: Final = 0.7
"""Damping by flow over that of the joint."""

RIDING: Final = 0.30
MOST_RIDING: Final = 0.5
"""Share of a sensor's motion in each mode of the tissue beneath it, and its limit."""

GAIN: Final = 0.02
WANDER_S: Final = 0.0008
UNEVEN_S: Final = 0.0001
COARSE_MPS2: Final = 0.1
"""Of a warm sensor: change of its gain, wander of its clock, unevenness of its samples, all rms; and its digit."""


# --- in the body -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TwoJointTissue(Mechanism):
    """Springs and dampers across two neighbouring joints, past the segment between them.

    Fascicles of the back muscles span several segments (Bogduk, Macintosh and Pearcy, 1992).
    """

    spring_n_per_m: Floats
    damper_ns_per_m: Floats

    in_body = True

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Fields (5,) by the lower joint; time constants of 5 to 30 ms."""
        k = person.stiffness_n_per_m
        spring = half_normal(PAST, scale, rng, 5) * k[:-1] * k[1:] / (k[:-1] + k[1:])
        return cls(spring, spring * log_uniform(0.005, 0.03, rng, 5))

    def act(self, now: Moment, own: Floats) -> None:
        """F = k (s1 + s2) + b (v1 + v2) in both joints."""
        stretch, rate = (each[:, :-1] + each[:, 1:] for each in (now.stretch, now.rate))
        pull = self.spring_n_per_m * stretch + self.damper_ns_per_m * rate
        now.joint_n[:, :-1] += pull
        now.joint_n[:, 1:] += pull


@dataclass(frozen=True, eq=False)
class Breathing(Mechanism):
    """The breath stiffens, damps and lengthens every joint in turn, and becomes deeper and shallower.

    Pressure in the abdomen stiffens the lumbar spine by 8 to 31 % (Hodges et al., 2005).
    """

    stiffness_n_per_m: Floats
    damping_ns_per_m: Floats
    stiffer: Floats
    damped: Floats
    shift_m: Floats
    phase_rad: Floats
    breath_hz: float
    depth_s: float
    depth_rad: float

    in_body = True

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """One rhythm, another phase in every joint; the depth changes within 15 to 60 s."""
        stiffer, damped = scale * TONE * rng.standard_normal((2, 6))
        return cls(
            person.stiffness_n_per_m,
            person.damping_ns_per_m,
            stiffer,
            damped,
            scale * SHIFT * person.reach_m * rng.standard_normal(6),
            rng.uniform(0.0, 2.0 * np.pi, 6),
            float(rng.uniform(*BREATH_HZ)),
            float(rng.uniform(15.0, 60.0)),
            float(rng.uniform(0.0, 2.0 * np.pi)),
        )

    def signals(self, event: Event) -> Floats:
        """The breath of every joint with rms near 1, and what it has changed since the event began, (n, 12)."""
        time_s = event.begin_s + event.time_s[:, None]
        depth = 1.0 + DEEPER * np.sin(2.0 * np.pi * time_s / self.depth_s + self.depth_rad)
        breath = np.sqrt(2.0) * depth * np.sin(2.0 * np.pi * self.breath_hz * time_s + self.phase_rad)
        # Every event begins from rest, so a rest that has shifted before it must not strike the body.
        return np.hstack([breath, breath - breath[0]])

    def act(self, now: Moment, own: Floats) -> None:
        """F = c k s + d b v - k e, c and d limited by a hyperbolic tangent."""
        breath, since = now.signal[:, :6], now.signal[:, 6:]
        stiffer, damped = (MOST_TONE * np.tanh(one * breath / MOST_TONE) for one in (self.stiffer, self.damped))
        now.joint_n += self.stiffness_n_per_m * (stiffer * now.stretch - self.shift_m * since)
        now.joint_n += damped * self.damping_ns_per_m * now.rate


@dataclass(frozen=True, eq=False)
class PowerLaw(Mechanism):
    """Every joint relaxes by a power of time over three decades: fractional viscoelasticity (Bonfanti et al., 2020).

    The modulus K (i w / w0)^a is the sum of branches whose stiffness grows as their rate to the power a; a damper
    stands for all that are faster, and the plain joint for all that are slower.
    """

    branch_n_per_m: Floats
    damper_ns_per_m: Floats

    in_body, states = True, 6 * len(BRANCHES_PER_S)

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """branch_n_per_m (6, 5) by joint and branch."""
        return cls.by(half_normal(POWER, scale, rng) * person.stiffness_n_per_m, rng.uniform(*ORDER, 6))

    @classmethod
    def by(cls, modulus_n_per_m: Floats, order: Floats) -> Self:
        """From K and a, (6,): (i w)^a = sin(a pi) / pi times the integral of q^(a - 1) i w / (i w + q) over rates q."""
        omega, spacing = 2.0 * np.pi * POWER_HZ, np.log(STEP)
        size = modulus_n_per_m * np.sin(np.pi * order) / np.pi
        branch = size[:, None] * spacing * (BRANCHES_PER_S / omega) ** order[:, None]
        fastest = BRANCHES_PER_S[-1] * np.sqrt(STEP) / omega
        return cls(branch, size / omega * fastest ** (order - 1.0) / (1.0 - order))

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = sum of k (s - q), and b v; q' = (s - q) r."""
        left = now.stretch[:, :, None] - own.reshape(-1, 6, len(BRANCHES_PER_S))
        now.joint_n += (self.branch_n_per_m * left).sum(axis=2) + self.damper_ns_per_m * now.rate
        return (left * BRANCHES_PER_S).reshape(own.shape)


@dataclass(frozen=True, eq=False)
class FluidFlow(Mechanism):
    """Fluid leaves a compressed joint against another resistance than it returns, the greater the denser the tissue.

    Valve of the disc: Ayotte et al., 2000. Permeability exponential in strain: Lai and Mow, 1980.
    """

    damping_ns_per_m: Floats
    growth: Floats
    valve: Floats
    reach_m: Floats
    rate_mps: Floats

    in_body = True

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Resistance grows up to four times far within, and one way differs from the other by up to 0.9 of the mean."""
        damping = half_normal(FLOW, scale, rng) * person.damping_ns_per_m
        return cls(damping, rng.uniform(0.0, 1.4, 6), rng.uniform(-0.9, 0.9, 6), person.reach_m, 0.3 * person.rate_mps)

    def act(self, now: Moment, own: Floats) -> None:
        """F = b exp(-g u / sqrt(1 + u^2)) (1 - h w / sqrt(1 + w^2)) v, u = s / reach, w = v / rate."""
        u, w = now.stretch / self.reach_m, now.rate / self.rate_mps
        resistance = np.exp(-self.growth * u / np.sqrt(1.0 + u * u)) * (1.0 - self.valve * w / np.sqrt(1.0 + w * w))
        now.joint_n += self.damping_ns_per_m * resistance * now.rate


# --- in the sensors --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SoftTissue(Mechanism):
    """Skin and fat beneath every sensor have two modes, and the sensor rides on both.

    A sensor on skin oscillates on the tissue above the bone (Ziegert and Lewis, 1979; Kitazaki and Griffin, 1995).
    """

    share: Floats
    frequency_hz: Floats
    damping: Floats

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Fields (7, 2) by sensor and mode, of 12 to 35 Hz and of 35 to 90 Hz."""
        share = MOST_RIDING * np.tanh(half_normal(RIDING, scale, rng, (7, 2)) / MOST_RIDING)
        share[0] = 0.0
        hz = np.column_stack([log_uniform(12.0, 35.0, rng, 7), log_uniform(35.0, 90.0, rng, 7)])
        return cls(share, hz, rng.uniform(0.2, 0.5, (7, 2)))

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """H = 1 + sum of share (mode - 1)."""
        found = accel_mps2
        for share, hz, damping in zip(self.share[sensor], self.frequency_hz[sensor], self.damping[sensor], strict=True):
            if share:
                found = found + share * (
                    signal.lfilter(*following(hz, damping, HELD_HZ), accel_mps2, axis=0) - accel_mps2
                )
        return found


@dataclass(frozen=True, eq=False)
class Sampling(Mechanism):
    """Every sensor warms up, and its gain with it; its clock wanders, its samples are uneven and its digits coarse.

    Errors of calibration and synchronisation of body-worn sensors: Chen et al., 2012.
    """

    gain: Floats
    warm_s: Floats
    wander_s: Floats
    period_s: Floats
    phase_rad: Floats
    uneven_s: float
    digit_mps2: Floats
    grain: int

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Warm within 1 to 7 min; the clock wanders within 5 to 60 s. Fields are (7,), zero for the seat."""
        worn = scale * (np.arange(7) > 0)
        return cls(
            worn * GAIN * rng.standard_normal(7),
            log_uniform(60.0, 400.0, rng, 7),
            worn * np.sqrt(2.0) * WANDER_S * np.abs(rng.standard_normal(7)),
            log_uniform(5.0, 60.0, rng, 7),
            rng.uniform(0.0, 2.0 * np.pi, 7),
            scale * UNEVEN_S,
            worn * COARSE_MPS2 * rng.uniform(0.3, 1.7, 7),
            int(rng.integers(2**31)),
        )

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """By the gain, without gravity, because sensors are levelled at rest."""
        warm = 1.0 - np.exp(-(event.begin_s + event.time_s[::2, None]) / self.warm_s[sensor])
        return (1.0 + self.gain[sensor] * warm) * accel_mps2

    def clock_late_s(self, sensor: int, event: Event, time_s: Floats) -> Floats | float:
        """Wander, and unevenness."""
        if sensor == 0:
            return 0.0
        turns = (event.begin_s + time_s) / self.period_s[sensor]
        wander = self.wander_s[sensor] * np.sin(2.0 * np.pi * turns + self.phase_rad[sensor])
        return wander + self.uneven_s * white(self.grain, sensor, event, time_s.shape)

    def reading(self, sensor: int, force_mps2: Floats) -> Floats:
        """Rounded to its digit."""
        digit = self.digit_mps2[sensor]
        return np.rint(force_mps2 / digit) * digit if digit else force_mps2
