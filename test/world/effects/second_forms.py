"""Further forms, not used in development: one of every class, and some of no class."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

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
class PolytropicBelly(Effect):
    """Gas in the belly that is compressed polytropically (Poisson, 1823): asymmetry."""

    height: float = between(1.8, 3.0)
    exponent: float = between(1.0, 1.4)

    kind, family, unit, strengths = "asymmetry", "elastic", "added force / k s at the reach", (0.15, 0.6)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e k g(u) / g(u1) d, g = (1 + u)^-n - 1 + n u, u = s / (height d), u1 at -d; straight below u = -0.6."""
        n, d = self.exponent, now.person.reach_m[self.site]
        u = now.stretch[:, self.site] / (self.height * d)
        near = np.maximum(u, -0.6)
        gas = (1.0 + near) ** -n - 1.0 + n * near + n * (1.0 - 0.4 ** (-n - 1.0)) * (u - near)
        whole = (1.0 - 1.0 / self.height) ** -n - 1.0 - n / self.height
        now.pull(self.site, -self.strength * now.person.stiffness_n_per_m[self.site] * d * gas / whole)


@dataclass(frozen=True)
class GentFibres(Effect):
    """Fibres that come to the end of their length, both ways alike (Gent, 1996): cubic."""

    limit: float = between(1.6, 2.4)

    kind, family, unit, strengths = "cubic", "elastic", "added force / k s at the reach", (0.15, 0.8)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k d c (c^2 - 1) u^3 / (1 - u^2), u = s / (c d), c the limit; straight beyond u^2 = 1/2."""
        c, d = self.limit, now.person.reach_m[self.site]
        u = now.stretch[:, self.site] / (c * d)
        near = np.clip(u, -np.sqrt(0.5), np.sqrt(0.5))
        force = near**3 / (1.0 - near**2) + 5.0 * (u - near)
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * d * c * (c * c - 1.0) * force)


@dataclass(frozen=True)
class MindlinTangent(Effect):
    """A cushion that bottoms out by tangent elasticity (Mindlin, 1945): stop."""

    gap: float = between(0.3, 0.5)
    depth: float = between(0.45, 0.65)

    kind, family, unit, strengths = "stop", "elastic", "stiffness / k, half-way to the bottom", (0.6, 4.0)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e k h (tan y - y) / (pi / 2), y = pi u / 2, u = (-s - gap d) / h > 0; straight beyond u = 0.85."""
        d = now.person.reach_m[self.site]
        h = self.depth * d
        y = 0.5 * np.pi * np.maximum((-now.stretch[:, self.site] - self.gap * d) / h, 0.0)
        near = np.minimum(y, 0.425 * np.pi)
        force = np.tan(near) - near + np.tan(0.425 * np.pi) ** 2 * (y - near)
        now.pull(self.site, -self.strength * now.person.stiffness_n_per_m[self.site] * h * force / (0.5 * np.pi))


# --- joints that rub and damp ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OstwaldDilatancy(Effect):
    """A fluid that thickens by a power of its shear rate (Ostwald, 1925): quadratic_damping."""

    power: float = between(1.4, 1.8)

    kind, family, unit, strengths = "quadratic_damping", "quadratic_damping", "force / b v at two rms rates", (0.5, 2.0)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e b v |v / 2 v1|^(n - 1), v1 the rms rate."""
        v = now.rate[:, self.site]
        thicker = np.abs(v / (2.0 * now.person.rate_mps[self.site])) ** (self.power - 1.0)
        now.pull(self.site, self.strength * now.person.damping_ns_per_m[self.site] * v * thicker)


@dataclass(frozen=True)
class AmontonsLoad(Effect):
    """Surfaces that rub the more they are pressed together (Amontons, 1699): friction."""

    creep: float = between(0.05, 0.12)
    pressed: float = between(0.4, 0.8)

    kind, family, unit, strengths = "friction", "rubbing", "Coulomb / rms damper force", (0.4, 1.5)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e b v1 (2 / pi) arctan(v / (creep v1)) (1 - p tanh(s / d)), v1 the rms rate."""
        s, v, rate = now.stretch[:, self.site], now.rate[:, self.site], now.person.rate_mps[self.site]
        load = 1.0 - self.pressed * np.tanh(s / now.person.reach_m[self.site])
        coulomb_n = self.strength * now.person.damping_ns_per_m[self.site] * rate
        now.pull(self.site, coulomb_n * load * np.arctan(v / (self.creep * rate)) / (0.5 * np.pi))


@dataclass(frozen=True)
class ValanisPaths(Effect):
    """Memory that fades with the path gone instead of with time, without a yield point (Valanis, 1971): hysteresis."""

    slip: float = between(0.12, 0.2)
    slope: float = between(0.8, 1.6)

    kind, family, unit, strengths, states = "hysteresis", "rubbing", "yield force / k d", (0.1, 0.4), 3

    def act(self, now: Moment, own: Floats) -> Floats:
        """By z_i' = v - |v| z_i / d_i, F = Fy sum(c_i z_i / d_i): three paths d_i, the longer the more of the force."""
        d, v = now.person.reach_m[self.site], now.rate[:, self.site, None]
        paths = np.array([0.5, 1.5, 4.5])
        weights = paths ** (0.5 * self.slope)
        yield_n = self.strength * now.person.stiffness_n_per_m[self.site] * d
        now.pull(self.site, yield_n * own @ (weights / weights.sum()))
        return (v - np.abs(v) * own) / (self.slip * d * paths)


# --- joints that remember --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FungSpectrum(Effect):
    """Tissue that relaxes over a whole range of times from a stress that is not linear (Fung, 1972): relaxation."""

    fast_s: float = between(0.008, 0.02)
    slow_s: float = between(0.5, 1.5)
    straight: float = between(1.5, 3.0)

    kind, family, unit, strengths, states = "relaxation", "memory", "all branches / k", (0.2, 0.8), 4

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k mean(E - q_i), q_i' = (E - q_i) / tau_i, tau_i in equal ratios; E = s sqrt(1 + (s / c d)^2)."""
        s, d = now.stretch[:, self.site, None], self.straight * now.person.reach_m[self.site]
        lag = s * np.sqrt(1.0 + (s / d) ** 2) - own
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * lag.mean(axis=1))
        return lag / np.geomspace(self.fast_s, self.slow_s, 4)


@dataclass(frozen=True)
class KrausPayne(Effect):
    """A network that amplitude breaks, not rate, and that takes its damping along (Payne; Kraus, 1984): thixotropy."""

    rebuilt_s: float = between(2.0, 8.0)
    broken: float = between(15.0, 50.0)
    power: float = between(0.5, 0.7)
    damped: float = between(0.3, 0.8)

    kind, family, unit, strengths, states = "thixotropy", "drifting", "softening / k without network", (0.25, 0.6), 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """By a' = (c (s / d)^2 - a) / tau, a^m / (1 + a^m) of the network is broken."""
        a = np.maximum(own[:, 0], 0.0) ** self.power
        soften(now, self.site, self.strength * a / (1.0 + a), self.damped)
        strain = now.stretch[:, self.site, None] / now.person.reach_m[self.site]
        return (self.broken * strain**2 - own) / self.rebuilt_s


@dataclass(frozen=True)
class BracesTwoJoints(Effect):
    """In every motion the person braces, over seconds, at a joint and less at its neighbour: posture."""

    at_s: float = between(1.0, 4.0)
    width_s: float = between(0.4, 1.5)
    beside: float = between(0.3, 0.6)
    damped: float = between(0.3, 0.8)

    kind, family, unit, strengths = "posture", "drifting", "stiffness gained / k", (0.15, 0.45)

    def act(self, now: Moment, own: Floats) -> None:
        """By 1 - exp(-(t / width)^2) of it, t the time since it began; the neighbour is the joint above if there is."""
        more = -self.strength * np.expm1(-((max(now.moving_s - self.at_s, 0.0) / self.width_s) ** 2))
        soften(now, self.site, -more, self.damped)
        soften(now, self.site + 1 if self.site < HEAD else NECK, -self.beside * more, self.damped)


@dataclass(frozen=True)
class RateSpindle(Effect):
    """Spindles that feel the rate alone, and a late twitch of second order (Milner-Brown et al., 1973): reflex."""

    late_s: float = between(0.04, 0.08)
    twitch_s: float = between(0.02, 0.04)
    lead_s: float = between(0.03, 0.06)

    kind, family, unit, strengths, states = "reflex", "memory", "gain / k", (0.1, 0.4), 2

    @property
    def delay_s(self) -> float:
        """Nerves and spine."""
        return self.late_s

    def act(self, now: Moment, own: Floats) -> Floats:
        """By z'' = (lead v - z - 2 twitch z') / twitch^2, F = e k z(t - late)."""
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * now.late[:, 0])
        z, w = own.T
        drive = self.lead_s * now.rate[:, self.site] - z
        return np.column_stack([w, (drive - 2.0 * self.twitch_s * w) / self.twitch_s**2])


# --- seat, backrest and belts ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SoftplusContact(Effect):
    """A seat that cannot pull, its contact a penalty that flesh and clothing make gradual: lift_off."""

    softness: float = between(0.03, 0.1)

    kind, family, unit, strengths, sites, scalable = "lift_off", "lift_off", "there", (1.0, 1.0), (PELVIS,), False

    def act(self, now: Moment, own: Floats) -> None:
        """N = w log(1 + exp((W - F) / w)), w the softness times W: W - F wherever it is pressed, and never below 0."""
        weight = now.person.weight_n
        w = self.softness * weight
        carried = w * np.logaddexp(0.0, (weight - now.joint_n[:, 0]) / w)
        now.pull(0, self.strength * (weight - carried - now.joint_n[:, 0]))


@dataclass(frozen=True)
class GibsonAshbySlab(Effect):
    """A foam slab whose cells buckle, then densify (Gibson and Ashby, 1982), and which creeps: cushion."""

    mass_kg: float = between(2.0, 4.0)
    stiffness_n_per_m: float = between(5e4, 1.5e5)
    loss_s: float = between(0.004, 0.012)
    yield_m: float = between(2e-3, 5e-3)
    plateau: float = between(0.35, 0.6)
    creep_s: float = between(0.05, 0.3)
    creep: float = between(0.3, 0.8)

    kind, family, unit, strengths, states = "cushion", "cushion", "compliance", (0.5, 1.5), 3
    sites = (PELVIS,)

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats] | None:
        """The joint stands on the foam."""
        return (0, -own[:, 0], -own[:, 1]) if self.strength else None

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = k (y ((1 - p) tanh u + p u - (-u / 4)^3) + loss x' + c (x - q)) / e, u = x / y, the cube for u < 0."""
        if not self.strength:
            return np.zeros_like(own)
        x, v, q = own.T
        u = x / self.yield_m
        cells = (1.0 - self.plateau) * np.tanh(u) + self.plateau * u - (0.25 * np.maximum(-u, 0.0)) ** 3
        pressed = self.yield_m * cells + self.loss_s * v + self.creep * (x - q)
        up = (now.joint_n[:, 0] - self.stiffness_n_per_m * pressed / self.strength) / self.mass_kg - now.base_mps2
        return np.column_stack([v, up, (x - q) / self.creep_s])


@dataclass(frozen=True)
class PressedKelvinVoigt(Effect):
    """A backrest that holds the torso the more, the more the seat pushes it forward (Kelvin and Voigt): backrest."""

    loss_s: float = between(0.02, 0.05)
    press: float = between(0.4, 0.9)
    press_mps2: float = between(0.5, 1.5)
    corner_hz: float = between(2.0, 5.0)

    kind, family, unit, strengths, sites = "backrest", "backrest", "stiffness / N/m", (1e3, 8e3), (UPPER_TORSO,)

    def signals(self, event: Event, person: Person) -> Floats:
        """Share of contact, by the low-passed forward acceleration."""
        sos = signal.butter(2, self.corner_hz, fs=RATE_HZ, output="sos")
        pushed = signal.sosfilt(sos, event.accel_mps2[:, :1], axis=0)
        return 1.0 + self.press * np.tanh(pushed / self.press_mps2)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -k (x + loss v) (1 + p tanh(a / a0))."""
        held = now.x[:, self.site] + self.loss_s * now.v[:, self.site]
        now.push(self.site, -self.strength * held * now.signal[:, 0])


@dataclass(frozen=True)
class LoadLimiter(Effect):
    """A belt that gives way above a force and returns less than it took, as with a load limiter: harness."""

    slack: float = between(0.25, 0.5)
    toe: float = between(0.05, 0.15)
    limit: float = between(0.3, 0.6)
    loss: float = between(0.2, 0.5)

    kind, family, unit, strengths, sites = "harness", "harness", "stiffness / N/m", (2e4, 8e4), (UPPER_TORSO,)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -k y tanh(u / y) (1 + loss sgn v); u = e^2 / (e + toe d), e = x - slack d > 0, d how far it rises."""
        d = now.person.rise_m[self.site]
        beyond = np.maximum(now.x[:, self.site] - self.slack * d, 0.0)
        taut, y = beyond**2 / (beyond + self.toe * d), self.limit * d
        way = 1.0 + self.loss * smooth_sign(now.v[:, self.site], 0.5 * now.person.rate_mps[0])
        now.push(self.site, -self.strength * y * np.tanh(taut / y) * way)


# --- masses ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OrganOfTwoSegments(Effect):
    """An organ that hangs between two segments, from both: viscera."""

    frequency_hz: float = between(4.0, 6.0)
    damping: float = between(0.15, 0.3)
    lower: float = between(0.35, 0.65)

    kind, family, unit, strengths, states = "viscera", "memory", "kg", (3.0, 8.0), 2
    sites = (LOWER_TORSO, CENTRAL_TORSO)

    def act(self, now: Moment, own: Floats) -> Floats:
        """Per kg: w^2 (x - z) + 2 zeta w (v - z') to the site and to the segment above it, by their shares."""
        both, w = [self.site, self.site + 1], 2.0 * np.pi * self.frequency_hz
        each = w**2 * (now.x[:, both] - own[:, :1]) + 2.0 * self.damping * w * (now.v[:, both] - own[:, 1:])
        each = each * np.array([self.lower, 1.0 - self.lower])
        now.up_n[:, both] -= self.strength * each
        return np.column_stack([own[:, 1], each.sum(axis=1) - now.base_mps2])


@dataclass(frozen=True)
class DriversArms(Effect):
    """Arms that hang from the shoulders and hold a wheel that moves with the seat: added_mass."""

    shoulder_hz: float = between(5.0, 10.0)
    wheel_hz: float = between(1.0, 3.0)
    damping: float = between(0.3, 0.6)

    kind, family, unit, strengths, sites, states = "added_mass", "added_mass", "kg", (2.0, 6.0), (UPPER_TORSO,), 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """Per kg: w^2 (x - z) + 2 zeta w (v - z') from the shoulders, -w^2 z - 2 zeta w z' from the wheel."""
        z, zv = own.T
        w, wheel = 2.0 * np.pi * self.shoulder_hz, 2.0 * np.pi * self.wheel_hz
        per_kg = w**2 * (now.x[:, self.site] - z) + 2.0 * self.damping * w * (now.v[:, self.site] - zv)
        now.push(self.site, -self.strength * per_kg)
        return np.column_stack([zv, per_kg - wheel**2 * z - 2.0 * self.damping * wheel * zv - now.base_mps2])


# --- further inputs to the body --------------------------------------------------------------------------------------

WHOLE: Final = (-1,)


@dataclass(frozen=True)
class OwnSwayPresses(Effect):
    """Every segment's own sway, resonant and in a direction between forward and left, presses it: cross_axis."""

    turn_rad: float = between(-0.8, 0.8)

    kind, family, unit, strengths, sites = "cross_axis", "sideways", "vertical / horizontal", (0.08, 0.3), WHOLE

    def signals(self, event: Event, person: Person) -> Floats:
        """How the segments sway."""
        way = np.array([np.cos(self.turn_rad), np.sin(self.turn_rad)])
        return np.column_stack([event.aside_mps2(joint + 1) @ way for joint in JOINTS])

    def act(self, now: Moment, own: Floats) -> None:
        """By m e (a_x cos + a_y sin), the segment's own."""
        now.up_n += self.strength * now.signal * now.person.inertia_kg


@dataclass(frozen=True)
class FrameOnSlides(Effect):
    """A seat that turns on a frame which rocks by itself, with a longer lever above one joint of the spine: pitch."""

    frame_hz: float = between(5.0, 10.0)
    damping: float = between(0.15, 0.4)
    across: float = between(-0.6, 0.6)
    longer: float = between(0.1, 0.4)
    joint: float = between(1.0, 4.0)

    kind, family, unit, strengths, sites = "pitch", "sideways", "lever / m", (0.04, 0.2), WHOLE

    def signals(self, event: Event, person: Person) -> Floats:
        """Rise per lever of 1 m behind the frame from rotation, and its rate."""
        top, bottom = following(self.frame_hz, self.damping, RATE_HZ)
        turned = signal.lfilter(top, bottom, event.leaning_rad(0) @ np.array([self.across, 1.0]))
        return np.column_stack([turned, np.gradient(turned, 1.0 / RATE_HZ)])

    def base_mps2(self, event: Event) -> Floats:
        """By l (q' + across p')."""
        top, bottom = following(self.frame_hz, self.damping, RATE_HZ)
        turning = np.gradient(event.spin_radps(0) @ np.array([self.across, 1.0]), 1.0 / RATE_HZ)
        return self.strength * signal.lfilter(top, bottom, turning)

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats]:
        """The segments above the joint rest higher by longer * l (q + across p)."""
        angle, rate = self.longer * self.strength * now.signal.T
        return int(self.joint), -angle, -rate


@dataclass(frozen=True)
class NodsAndRolls(Effect):
    """A stiff neck on a ball joint, which nods and rolls: bending."""

    rolls: float = between(0.6, 1.0)

    kind, family, unit, strengths, sites = "bending", "bending", "length / m", (0.1, 0.5), (NECK, HEAD)

    def signals(self, event: Event, person: Person) -> Floats:
        """The height lost per length, and its rate."""
        roll, pitch = (event.leaning_rad(self.site + 1) - event.leaning_rad(self.site)).T
        lost = 1.0 - np.cos(self.rolls * roll) * np.cos(pitch)
        return np.column_stack([lost, np.gradient(lost, 1.0 / RATE_HZ)])

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats]:
        """By L (1 - cos(r roll) cos pitch) of stretch."""
        lost, rate = self.strength * now.signal.T
        return self.site, lost, rate


@dataclass(frozen=True)
class TwoOrdersInTurn(Effect):
    """Two orders of an engine, of which now one is louder and now the other: periodic."""

    frequency_hz: float = between(12.0, 22.0)
    second: float = between(0.4, 0.9)
    depth: float = between(0.3, 0.7)
    slow_hz: float = between(0.05, 0.3)

    kind, family, unit, strengths = "periodic", "periodic", "m/s^2", (0.2, 1.0)

    def signals(self, event: Event, person: Person) -> Floats:
        """(1 + d sin wt) sin(2 pi f t) + second (1 - d sin wt) sin(4 pi f t)."""
        at_s = event.begin_s + event.time_s
        swell, phase = self.depth * np.sin(2.0 * np.pi * self.slow_hz * at_s), 2.0 * np.pi * self.frequency_hz * at_s
        return ((1.0 + swell) * np.sin(phase) + self.second * (1.0 - swell) * np.sin(2.0 * phase))[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """Shake the segment."""
        now.push(self.site, self.strength * now.person.inertia_kg[self.site] * now.signal[:, 0])


# --- sensors ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ScottBlairTissue(Effect):
    """Soft tissue between a spring and a damper, by a derivative of broken order (Scott Blair, 1947): skin."""

    frequency_hz: float = between(15.0, 40.0)
    order: float = between(0.35, 0.7)
    damping: float = between(0.15, 0.35)

    kind, family, unit, strengths, sites = "skin", "sensor", "share that rides on the skin", (0.25, 1.0), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """(1 + c) / (1 + c - (f / f0)^2), c = 2 zeta (i f / f0)^order, mixed with the bone."""
        if sensor != self.site:
            return accel_mps2
        count = fft.next_fast_len(len(accel_mps2) + round(HELD_HZ), real=True)
        ratio = fft.rfftfreq(count, 1.0 / HELD_HZ)[:, None] / self.frequency_hz
        tissue = 1.0 + 2.0 * self.damping * (1j * ratio) ** self.order
        beyond = ratio**2 / (tissue - ratio**2) * fft.rfft(accel_mps2, count, axis=0)
        return accel_mps2 + self.strength * fft.irfft(beyond, count, axis=0)[: len(accel_mps2)]


@dataclass(frozen=True)
class PhillipsCreep(Effect):
    """A strap that slips with what it was shaken, logarithmically (Phillips, 1905), and is then put right: tilt."""

    steep: float = between(4.0, 15.0)
    side: float = between(-0.5, 0.5)

    kind, family, unit, strengths, sites = "tilt", "sideways", "rad", (0.08, 0.25), WORN

    def lean_rad(self, sensor: int, event: Event) -> Floats | None:
        """By log(1 + c w) / log(1 + c), w the share of the event's shaking that is over."""
        if sensor != self.site:
            return None
        shaken = np.cumsum(np.abs(event.accel_mps2[:, 2]))
        slipped = np.log1p(self.steep * shaken / shaken[-1]) / np.log1p(self.steep)
        return self.strength * slipped[:, None] * np.array([self.side, 1.0])


@dataclass(frozen=True)
class TwoPeriodClock(Effect):
    """A clock that wanders smoothly with its temperature: clock."""

    period_s: float = between(8.0, 30.0)
    steady: float = between(0.4, 0.7)

    kind, family, unit, strengths, sites = "clock", "sensor", "s", (1e-3, 5e-3), WORN

    def clock_late_s(self, sensor: int, event: Event, time_s: Floats) -> Floats | float:
        """Late by the steady share, more or less by the rest, in two periods that never meet."""
        if sensor != self.site:
            return 0.0
        turns = 2.0 * np.pi * (event.begin_s + time_s) / self.period_s
        return self.strength * (self.steady + (1.0 - self.steady) * 0.5 * (np.sin(turns) + np.sin(0.618 * turns + 1.0)))


@dataclass(frozen=True)
class ShelvingGain(Effect):
    """A sensor that reads quick motion too large, and what is slow or at rest rightly: gain."""

    corner_hz: float = between(1.0, 3.0)

    kind, family, unit, strengths, sites = "gain", "sensor", "share", (0.04, 0.12), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """By 1 + e s / (s + w)."""
        if sensor != self.site:
            return accel_mps2
        quick = signal.bilinear([1.0, 0.0], [1.0, 2.0 * np.pi * self.corner_hz], HELD_HZ)
        return accel_mps2 + self.strength * signal.lfilter(*quick, accel_mps2, axis=0)


@dataclass(frozen=True)
class RappKnee(Effect):
    """A sensor that saturates with a knee (Rapp, 1991): saturation."""

    knee: float = between(4.0, 10.0)

    kind, family, unit, strengths, sites = "saturation", "saturation", "1 / range in 20 m/s^2", (0.6, 1.0), WORN

    def reading(self, sensor: int, force_mps2: Floats) -> Floats:
        """Every axis reads a / (1 + |a / range|^2p)^(1 / 2p)."""
        if sensor != self.site or not self.strength:
            return force_mps2
        power = 2.0 * self.knee
        full = GRAVITY_MPS2 + 20.0 / self.strength
        return force_mps2 / (1.0 + np.abs(force_mps2 / full) ** power) ** (1.0 / power)


# --- of no class -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SmithInerter(Effect):
    """Fluid that a joint must speed up, behind a narrow passage, an inerter (Smith, 2002): outside."""

    passage_s: float = between(0.005, 0.015)

    kind, family, unit, strengths, states = "outside", "outside", "inertance / mass carried", (0.05, 0.2), 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e m (v - z) / tau = e m z', z the rate of the fluid."""
        speeds = (now.rate[:, self.site, None] - own) / self.passage_s
        now.pull(self.site, self.strength * now.person.carried_kg[self.site] * speeds[:, 0])
        return speeds


@dataclass(frozen=True)
class PelvisGovernsJoint(Effect):
    """A joint that is stiffer while the one below the pelvis is pressed, and softer while it is not: outside."""

    kind, family, unit, strengths = "outside", "outside", "share of k at the reach", (0.3, 0.8)
    sites = JOINTS[1:5]

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e tanh(s0 / d0) k s."""
        pressed = np.tanh(now.stretch[:, 0] / now.person.reach_m[0])
        soften(now, self.site, self.strength * pressed, 0.0)


@dataclass(frozen=True)
class ThreeJointDamper(Effect):
    """Tissue that damps two segments which three joints are between: outside."""

    kind, family, unit, strengths = "outside", "outside", "damping / that of the joints in series", (0.5, 2.0)
    sites = JOINTS[:3]

    def act(self, now: Moment, own: Floats) -> None:
        """F = e b (v_high - v_low)."""
        low, high = self.site, self.site + 3
        b = 1.0 / (1.0 / now.person.damping_ns_per_m[low + 1 : high + 1]).sum()
        tension = self.strength * b * (now.v[:, high] - now.v[:, low])
        now.push(high, -tension)
        now.push(low, tension)


@dataclass(frozen=True)
class EffortTremor(Effect):
    """A muscle that trembles the more, the more it has to work (Harris and Wolpert, 1998): outside."""

    grain: float = between(0.0, 1e6)
    memory_s: float = between(0.1, 0.4)
    low_hz: float = between(5.0, 8.0)

    kind, family, unit, strengths, states = "outside", "outside", "rms tremor / rms damper force", (0.3, 1.2), 1

    def signals(self, event: Event, person: Person) -> Floats:
        """Noise of an octave, its rms 1; another in every event."""
        rng = np.random.default_rng([round(self.grain), round(1e3 * event.begin_s)])
        sos = signal.butter(2, [self.low_hz, 2.0 * self.low_hz], "bandpass", fs=RATE_HZ, output="sos")
        noise = signal.sosfilt(sos, rng.standard_normal((len(event.accel_mps2), 1)), axis=0)
        return noise / noise.std()

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e b z n(t), z' = (|v| - z) / tau."""
        now.pull(self.site, self.strength * now.person.damping_ns_per_m[self.site] * own[:, 0] * now.signal[:, 0])
        return (np.abs(now.rate[:, self.site, None]) - own) / self.memory_s


FORMS: Final[tuple[type[Effect], ...]] = (
    PolytropicBelly, GentFibres, MindlinTangent, OstwaldDilatancy, AmontonsLoad, ValanisPaths, FungSpectrum,
    KrausPayne, BracesTwoJoints, RateSpindle, SoftplusContact, GibsonAshbySlab, PressedKelvinVoigt, LoadLimiter,
    OrganOfTwoSegments, DriversArms, OwnSwayPresses, FrameOnSlides, NodsAndRolls, TwoOrdersInTurn, ScottBlairTissue,
    PhillipsCreep, TwoPeriodClock, ShelvingGain, RappKnee, SmithInerter, PelvisGovernsJoint, ThreeJointDamper,
    EffortTremor,
)  # fmt: skip
