"""Foreign forms for development and thresholds: at least one of every class of the catalogue, and some of none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world.effects.effect import (
    CENTRAL_TORSO,
    HEAD,
    JOINTS,
    LOWER_TORSO,
    NECK,
    PELVIS,
    UPPER_TORSO,
    WORN,
    Effect,
    Moment,
    Person,
    between,
    smooth_sign,
    soften,
)  # fmt: skip
from world.effects.event import HELD_HZ, Event, following
from world.seats import GRAVITY_MPS2, RATE_HZ

Floats = NDArray[np.float64]

# --- joints that stiffen ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FungTissue(Effect):
    """Tissue that stiffens exponentially when compressed and slackens when pulled (Fung's law): asymmetry."""

    toe: float = between(0.5, 1.0)

    kind, family, unit, strengths = "asymmetry", "elastic", "stiffness at the toe / k", (0.15, 0.6)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e k d (exp(u) - 1 - u) with u = -s / d, straight beyond u = 2; d is a share of the person's reach."""
        d = self.toe * now.person.reach_m[self.site]
        u = -now.stretch[:, self.site] / d
        near = np.minimum(u, 2.0)
        force = np.expm1(near) - near + np.expm1(2.0) * (u - near)
        now.pull(self.site, -self.strength * now.person.stiffness_n_per_m[self.site] * d * force)


@dataclass(frozen=True)
class PowerLaw(Effect):
    """Stiffening by a power of the stretch: cubic."""

    power: float = between(2.4, 3.6)

    kind, family, unit, strengths = "cubic", "elastic", "added force / k s at the reach", (0.15, 0.8)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k s |s / d|^(n - 1)."""
        s = now.stretch[:, self.site]
        share = np.abs(s) / now.person.reach_m[self.site]
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * s * share ** (self.power - 1.0))


@dataclass(frozen=True)
class ExponentialStop(Effect):
    """An end stop that sets in exponentially: stop."""

    gap: float = between(0.5, 0.75)
    softness: float = between(0.06, 0.12)

    kind, family, unit, strengths = "stop", "elastic", "stiffness / k, one softness beyond the gap", (0.3, 2.0)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e k w exp(u), u = (-s - gap d) / w, less its value at rest; straight beyond u = 3."""
        d = now.person.reach_m[self.site]
        w = self.softness * d
        u = (-now.stretch[:, self.site] - self.gap * d) / w
        near = np.minimum(u, 3.0)
        force = np.exp(near) * (1.0 + u - near) - np.exp(-self.gap / self.softness)
        now.pull(self.site, -self.strength * now.person.stiffness_n_per_m[self.site] * w * force)


# --- joints that rub and damp ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Orifice(Effect):
    """A damper from laminar to turbulent flow through an orifice: quadratic_damping."""

    knee: float = between(1.0, 2.0)

    kind, family, unit, strengths = (
        "quadratic_damping",
        "quadratic_damping",
        "added force / b v at the knee",
        (0.3, 1.2),
    )

    def act(self, now: Moment, own: Floats) -> None:
        """F = e b v (sqrt(1 + (v / v1)^2) - 1) / (sqrt 2 - 1), the knee v1 in rms rates."""
        v = now.rate[:, self.site]
        turbulent = np.sqrt(1.0 + (v / (self.knee * now.person.rate_mps[self.site])) ** 2) - 1.0
        now.pull(self.site, self.strength * now.person.damping_ns_per_m[self.site] * v * turbulent / (np.sqrt(2) - 1))


@dataclass(frozen=True)
class LuGre(Effect):
    """Bristles with a Stribeck curve (Canudas de Wit et al., 1995): friction."""

    stribeck: float = between(0.2, 0.5)
    stiction: float = between(1.1, 1.5)

    kind, family, unit, strengths, states = "friction", "rubbing", "Coulomb / rms damper force", (0.3, 1.2), 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """By z' = v - |v| z / z0(v), F = Fc z / d; z0 goes from stiction * d at rest to d, a 300th of the rate."""
        v, z = now.rate[:, self.site], own[:, 0]
        rate = now.person.rate_mps[self.site]
        d = rate / 300.0
        limit = d * (1.0 + (self.stiction - 1.0) * np.exp(-((v / (self.stribeck * rate)) ** 2)))
        coulomb_n = self.strength * now.person.damping_ns_per_m[self.site] * rate
        now.pull(self.site, coulomb_n * z / d)
        return (v - np.abs(v) * z / limit)[:, None]


@dataclass(frozen=True)
class Dahl(Effect):
    """Friction that is a spring before it slips (Dahl, 1968): hysteresis."""

    slip: float = between(0.08, 0.25)

    kind, family, unit, strengths, states = "hysteresis", "rubbing", "yield force / k d", (0.08, 0.3), 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """By z' = v (1 - z sgn v), sgn v = v / |v| so without a kink; F = Fy z, z counted in slips of d."""
        d = now.person.reach_m[self.site]
        v, z = now.rate[:, self.site] / (self.slip * d), own[:, 0]
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * d * z)
        return (v - np.abs(v) * z)[:, None]


# --- joints that remember --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoBranches(Effect):
    """A Prony series of two branches: relaxation."""

    fast_s: float = between(0.01, 0.03)
    slow_s: float = between(0.1, 0.5)
    share: float = between(0.4, 0.7)

    kind, family, unit, strengths, states = "relaxation", "memory", "both branches / k", (0.2, 0.8), 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k (a (s - q1) + (1 - a) (s - q2)), q' = (s - q) / tau."""
        lag = now.stretch[:, self.site, None] - own
        stiffness = self.strength * now.person.stiffness_n_per_m[self.site]
        now.pull(self.site, stiffness * (self.share * lag[:, 0] + (1.0 - self.share) * lag[:, 1]))
        return lag / np.array([self.fast_s, self.slow_s])


@dataclass(frozen=True)
class Structure(Effect):
    """Thixotropy by a structure that motion breaks down and rest builds up: thixotropy."""

    rebuilt_s: float = between(2.0, 8.0)
    power: float = between(0.6, 0.9)
    broken: float = between(0.8, 2.0)

    kind, family, unit, strengths, states = "thixotropy", "drifting", "softening / k without structure", (0.25, 0.6), 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """By l' = (1 - l - a (|v| / rms v)^m l) / tau, F = -e (1 - l) k s; the state is 1 - l."""
        s, gone, person = now.stretch[:, self.site], own[:, 0], now.person
        flow = self.broken * (np.abs(now.rate[:, self.site]) / person.rate_mps[self.site]) ** self.power
        now.pull(self.site, -self.strength * gone * person.stiffness_n_per_m[self.site] * s)
        return ((flow * (1.0 - gone) - gone) / self.rebuilt_s)[:, None]


@dataclass(frozen=True)
class SlumpsInEvents(Effect):
    """Every motion makes the person slump once, stiffness and damping alike: posture."""

    at_s: float = between(2.0, 5.0)
    width_s: float = between(0.1, 0.5)
    damped: float = between(0.3, 1.2)

    kind, family, unit, strengths = "posture", "drifting", "stiffness lost / k", (0.12, 0.35)

    def act(self, now: Moment, own: Floats) -> None:
        """A sigmoid of the time since the motion set in."""
        done = 0.5 + 0.5 * np.tanh((now.moving_s - self.at_s) / self.width_s)
        soften(now, self.site, self.strength * done, self.damped)


@dataclass(frozen=True)
class SlumpsBetweenEvents(Effect):
    """Somewhere in the sitting, often between two events, the person slumps: posture."""

    at: float = between(0.2, 0.7)
    width: float = between(0.002, 0.02)
    damped: float = between(0.3, 1.2)

    kind, family, unit, strengths = "posture", "drifting", "stiffness lost / k", (0.12, 0.35)

    def act(self, now: Moment, own: Floats) -> None:
        """A sigmoid of the sitting's time, which runs from 0 to 1."""
        done = 0.5 + 0.5 * np.tanh((now.share - self.at) / self.width)
        soften(now, self.site, self.strength * done, self.damped)


@dataclass(frozen=True)
class LatePull(Effect):
    """A muscle that pulls by the stretch of a while ago, through a twitch of first order: reflex."""

    late_s: float = between(0.05, 0.1)
    twitch_s: float = between(0.015, 0.04)

    kind, family, unit, strengths, states = "reflex", "memory", "gain / k", (0.1, 0.4), 1

    @property
    def delay_s(self) -> float:
        """Nerves and spine."""
        return self.late_s

    def act(self, now: Moment, own: Floats) -> Floats:
        """By z' = (s - z) / twitch, F = e k z(t - late)."""
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * now.late[:, 0])
        return (now.stretch[:, self.site, None] - own) / self.twitch_s


# --- seat, backrest and belts ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HuntCrossley(Effect):
    """A seat that cannot pull, its contact by Hunt and Crossley (1975): lift_off."""

    kind, family, unit, strengths, sites, scalable = "lift_off", "lift_off", "there", (1.0, 1.0), (PELVIS,), False

    def act(self, now: Moment, own: Floats) -> None:
        """N = E - b v min(E / W, 1) > 0, E > 0 being W less the joint's spring force: W - F wherever it is pressed."""
        weight, damper = now.person.weight_n, now.person.damping_ns_per_m[0] * now.rate[:, 0]
        pressed = np.maximum(weight - (now.joint_n[:, 0] - damper), 0.0)
        carried = np.maximum(pressed - damper * np.minimum(pressed / weight, 1.0), 0.0)
        now.pull(0, self.strength * (weight - carried - now.joint_n[:, 0]))


@dataclass(frozen=True)
class ShearedFoam(Effect):
    """A foam slab below the pelvis with a mass of its own, lowered where the pelvis shears it: cushion."""

    mass_kg: float = between(2.0, 4.0)
    damping_ns_per_m: float = between(500.0, 1500.0)
    stiffness_n_per_m: float = between(5e4, 1.5e5)
    height_m: float = between(0.06, 0.12)
    shear_hz: float = between(3.0, 6.0)

    kind, family, unit, strengths, states = "cushion", "cushion", "compliance", (0.5, 1.5), 4
    sites = (PELVIS,)

    def signals(self, event: Event, person: Person) -> Floats:
        """Forward."""
        return event.accel_mps2[:, :1]

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats] | None:
        """The joint stands on the foam, u^2 / 2 h lower where it is sheared by u."""
        if not self.strength:
            return None
        x, v, u, w = own.T
        return 0, u * u / (2.0 * self.height_m) - x, u * w / self.height_m - v

    def act(self, now: Moment, own: Floats) -> Floats:
        """The foam, which is stiffer where it is deeper, and a shear oscillator driven from forward."""
        if not self.strength:
            return np.zeros_like(own)
        x, v, u, w = own.T
        omega = 2.0 * np.pi * self.shear_hz
        foam = (self.stiffness_n_per_m * x * (1.0 + 20.0 * np.abs(x)) + self.damping_ns_per_m * v) / self.strength
        up = (now.joint_n[:, 0] - foam) / self.mass_kg - now.base_mps2
        return np.column_stack([v, up, w, -now.signal[:, 0] - 0.6 * omega * w - omega**2 * u])


@dataclass(frozen=True)
class RubbingBackrest(Effect):
    """A backrest that holds the upper torso by a spring and by rubbing: backrest."""

    rubbing: float = between(0.2, 0.6)
    loss_s: float = between(0.01, 0.03)

    kind, family, unit, strengths, sites = "backrest", "backrest", "stiffness / N/m", (1e3, 8e3), (UPPER_TORSO,)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -k (x + loss v) - rubbing k d v / sqrt(v^2 + v0^2), d a third of how far the torso rises."""
        x, v, person = now.x[:, self.site], now.v[:, self.site], now.person
        rubbing = self.rubbing * person.rise_m[self.site] / 3.0 * smooth_sign(v, 0.1 * person.rate_mps[0])
        now.push(self.site, -self.strength * (x + self.loss_s * v + rubbing))


@dataclass(frozen=True)
class Webbing(Effect):
    """A belt whose webbing stiffens exponentially once it is taut: harness."""

    slack: float = between(0.3, 0.6)
    toe: float = between(0.1, 0.3)

    kind, family, unit, strengths, sites = "harness", "harness", "stiffness / N/m", (1e4, 5e4), (UPPER_TORSO,)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -k w (exp(u) - 1), u = (x - slack d) / w > 0, straight beyond 3; d is how far the torso rises."""
        d = now.person.rise_m[self.site]
        u = np.maximum((now.x[:, self.site] - self.slack * d) / (self.toe * d), 0.0)
        near = np.minimum(u, 3.0)
        now.push(self.site, -self.strength * self.toe * d * (np.expm1(near) + np.exp(3.0) * (u - near)))


# --- masses ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoOrgans(Effect):
    """Two organs, one hung in the torso and one on the first: viscera."""

    first_hz: float = between(4.0, 5.5)
    second_hz: float = between(6.0, 9.0)
    damping: float = between(0.15, 0.3)
    share: float = between(0.6, 0.8)

    kind, family, unit, strengths, states = "viscera", "memory", "kg", (3.0, 8.0), 4
    sites = (LOWER_TORSO, CENTRAL_TORSO, UPPER_TORSO)

    def act(self, now: Moment, own: Floats) -> Floats:
        """Per kg of each: w^2 (x - z) + 2 zeta w (v - z')."""
        z, zv, y, yv = own.T
        w1, w2 = 2.0 * np.pi * self.first_hz, 2.0 * np.pi * self.second_hz
        first = w1**2 * (now.x[:, self.site] - z) + 2.0 * self.damping * w1 * (now.v[:, self.site] - zv)
        second = w2**2 * (z - y) + 2.0 * self.damping * w2 * (zv - yv)
        now.push(self.site, -self.strength * first)
        beside = (1.0 - self.share) / self.share
        # The first hangs by the whole mass's spring and carries the second.
        return np.column_stack([zv, first / self.share - beside * second - now.base_mps2, yv, second - now.base_mps2])


@dataclass(frozen=True)
class LinedHelmet(Effect):
    """A helmet on a soft liner: added_mass."""

    liner_hz: float = between(18.0, 30.0)
    damping: float = between(0.25, 0.5)

    kind, family, unit, strengths, sites, states = "added_mass", "added_mass", "kg", (0.8, 2.0), (HEAD,), 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """Per kg: w^2 (x - z) + 2 zeta w (v - z')."""
        return _carried(now, own, self.site, self.strength, self.liner_hz, self.damping)


def _carried(now: Moment, own: Floats, site: int, mass_kg: float, frequency_hz: float, damping: float) -> Floats:
    """A sprung mass on a segment: pushes it, and gives the rates of the mass's two states."""
    w = 2.0 * np.pi * frequency_hz
    per_kg = w**2 * (now.x[:, site] - own[:, 0]) + 2.0 * damping * w * (now.v[:, site] - own[:, 1])
    now.push(site, -mass_kg * per_kg)
    return np.column_stack([own[:, 1], per_kg - now.base_mps2])


# --- further inputs to the body --------------------------------------------------------------------------------------

WHOLE: Final = (-1,)


@dataclass(frozen=True)
class LeaningSpine(Effect):
    """Fore-aft motion that presses every segment up or down, behind a low-pass: cross_axis."""

    corner_hz: float = between(3.0, 8.0)
    top: float = between(0.5, 1.5)

    kind, family, unit, strengths, sites = "cross_axis", "sideways", "vertical / forward", (0.1, 0.4), WHOLE

    def signals(self, event: Event, person: Person) -> Floats:
        """Forward, low-passed."""
        sos = signal.butter(2, self.corner_hz, fs=RATE_HZ, output="sos")
        return signal.sosfilt(sos, event.accel_mps2[:, :1], axis=0)

    def act(self, now: Moment, own: Floats) -> None:
        """By m e a_x, more or less of it towards the head."""
        now.up_n += self.strength * now.signal * now.person.inertia_kg * np.linspace(1.0, self.top, 6)


@dataclass(frozen=True)
class PitchingSeat(Effect):
    """A seat that turns about a point that is not below the body: pitch."""

    across_m: float = between(-0.1, 0.1)
    below_m: float = between(0.0, 0.2)

    kind, family, unit, strengths, sites = "pitch", "sideways", "lever / m", (0.06, 0.3), WHOLE

    def base_mps2(self, event: Event) -> Floats:
        """By l q' + l' p' - l_z (p^2 + q^2), levers as strong as the first."""
        roll, pitch = event.spin_radps(0).T
        turning = np.gradient(self.strength * pitch + self.strength / 0.15 * self.across_m * roll, 1.0 / RATE_HZ)
        return turning - self.strength / 0.15 * self.below_m * (roll**2 + pitch**2)


@dataclass(frozen=True)
class NoddingNeck(Effect):
    """A stiff neck that nods: its height is L cos phi: bending."""

    kind, family, unit, strengths, sites = "bending", "bending", "length / m", (0.1, 0.5), (NECK, HEAD)

    def signals(self, event: Event, person: Person) -> Floats:
        """The angle between the segments that meet at the joint, and its rate."""
        phi = (event.leaning_rad(self.site + 1) - event.leaning_rad(self.site))[:, 1]
        return np.column_stack([phi, np.gradient(phi, 1.0 / RATE_HZ)])

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats]:
        """By L (1 - cos phi) of stretch."""
        phi, rate = now.signal.T
        return self.site, self.strength * (1.0 - np.cos(phi)), self.strength * np.sin(phi) * rate


@dataclass(frozen=True)
class WanderingEngine(Effect):
    """An engine's line that wanders in frequency and shakes a segment, at standstill too: periodic."""

    frequency_hz: float = between(22.0, 45.0)
    wander_hz: float = between(0.3, 1.5)
    slow_hz: float = between(0.05, 0.3)

    kind, family, unit, strengths = "periodic", "periodic", "m/s^2", (0.2, 1.0)

    def signals(self, event: Event, person: Person) -> Floats:
        """A line whose frequency goes up and down by wander_hz."""
        at_s = event.begin_s + event.time_s
        wander = self.wander_hz / self.slow_hz * np.sin(2.0 * np.pi * self.slow_hz * at_s)
        return np.sin(2.0 * np.pi * self.frequency_hz * at_s + wander)[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """Shake the segment."""
        now.push(self.site, self.strength * now.person.inertia_kg[self.site] * now.signal[:, 0])


# --- sensors ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoModeSkin(Effect):
    """Soft tissue with two modes under a sensor: skin."""

    first_hz: float = between(14.0, 30.0)
    second_hz: float = between(40.0, 70.0)
    damping: float = between(0.2, 0.4)
    first: float = between(0.5, 0.8)

    kind, family, unit, strengths, sites = "skin", "sensor", "share that rides on the skin", (0.25, 1.0), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Bone and skin mixed."""
        if sensor != self.site:
            return accel_mps2
        slow, quick = (self._mode(hz, accel_mps2) for hz in (self.first_hz, self.second_hz))
        skin = self.first * slow + (1.0 - self.first) * quick
        return accel_mps2 + self.strength * (skin - accel_mps2)

    def _mode(self, frequency_hz: float, accel_mps2: Floats) -> Floats:
        return signal.lfilter(*following(frequency_hz, self.damping, HELD_HZ), accel_mps2, axis=0)


@dataclass(frozen=True)
class LeansWithShaking(Effect):
    """A sensor that leans the more it is shaken, and not at rest: tilt."""

    memory_s: float = between(0.5, 2.0)
    side: float = between(-0.5, 0.5)

    kind, family, unit, strengths, sites = "tilt", "sideways", "rad", (0.08, 0.25), WORN

    def lean_rad(self, sensor: int, event: Event) -> Floats | None:
        """By the smoothed vertical acceleration of the seat, up to the strength."""
        if sensor != self.site:
            return None
        decay = np.exp(-1.0 / (self.memory_s * RATE_HZ))
        shaken = signal.lfilter([1.0 - decay], [1.0, -decay], np.abs(event.accel_mps2[:, 2]))
        return self.strength * (shaken / shaken.max())[:, None] * np.array([self.side, 1.0])


@dataclass(frozen=True)
class JumpingClock(Effect):
    """A clock that is set a little back and forth while it runs: clock."""

    every_s: float = between(2.0, 5.0)
    steady: float = between(0.4, 0.7)

    kind, family, unit, strengths, sites = "clock", "sensor", "s", (1e-3, 5e-3), WORN

    def clock_late_s(self, sensor: int, event: Event, time_s: Floats) -> Floats | float:
        """Late by the steady share, and every other while by all of it."""
        if sensor != self.site:
            return 0.0
        on = np.floor((event.begin_s + time_s) / self.every_s) % 2.0
        return self.strength * (self.steady + (1.0 - self.steady) * on)


@dataclass(frozen=True)
class GainInMotion(Effect):
    """A gain error that gravity at rest does not show: gain."""

    kind, family, unit, strengths, sites = "gain", "sensor", "share", (0.04, 0.12), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Motion alone is read too large."""
        return accel_mps2 * (1.0 + self.strength) if sensor == self.site else accel_mps2


@dataclass(frozen=True)
class EarlyClip(Effect):
    """A sensor that was set to too small a range: saturation."""

    kind, family, unit, strengths, sites = "saturation", "saturation", "1 / range in 20 m/s^2", (0.6, 1.0), WORN

    def reading(self, sensor: int, force_mps2: Floats) -> Floats:
        """Every axis ends at the range."""
        if sensor != self.site or not self.strength:
            return force_mps2
        full = GRAVITY_MPS2 + 20.0 / self.strength
        return np.clip(force_mps2, -full, full)


# --- of no class -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Breathing(Effect):
    """Stiffness that goes up and down with every breath: outside."""

    rate_hz: float = between(0.2, 0.35)

    kind, family, unit, strengths = "outside", "outside", "share of k", (0.15, 0.5)
    sites = (LOWER_TORSO, CENTRAL_TORSO, UPPER_TORSO)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e sin(2 pi f t) k s."""
        breath = self.strength * np.sin(2.0 * np.pi * self.rate_hz * now.time_s)
        now.pull(self.site, breath * now.person.stiffness_n_per_m[self.site] * now.stretch[:, self.site])


@dataclass(frozen=True)
class Bypass(Effect):
    """A muscle that goes past a segment without touching it: outside."""

    loss_s: float = between(0.005, 0.02)

    kind, family, unit, strengths = "outside", "outside", "stiffness / that of both joints in series", (0.4, 1.5)
    sites = JOINTS[:4]

    def act(self, now: Moment, own: Floats) -> None:
        """A spring and damper between the segment below a joint's upper neighbour and the one above it."""
        low, high = self.site, self.site + 2
        k = now.person.stiffness_n_per_m[low + 1 : high + 1]
        apart = now.x[:, high] - now.x[:, low] + self.loss_s * (now.v[:, high] - now.v[:, low])
        tension = self.strength * k.prod() / k.sum() * apart
        now.push(high, -tension)
        now.push(low, tension)


FORMS: Final[tuple[type[Effect], ...]] = (
    FungTissue, PowerLaw, ExponentialStop, Orifice, LuGre, Dahl, TwoBranches, Structure, SlumpsInEvents,
    SlumpsBetweenEvents, LatePull, HuntCrossley, ShearedFoam, RubbingBackrest, Webbing, TwoOrgans, LinedHelmet,
    LeaningSpine, PitchingSeat, NoddingNeck, WanderingEngine, TwoModeSkin, LeansWithShaking, JumpingClock, GainInMotion,
    EarlyClip, Breathing, Bypass,
)  # fmt: skip
