"""Forms that scored the blind runs up to 2026-11-23, and train the model of tracing since.

At least one of every class of the catalogue, and some of none; none of them is one of `development_forms`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world.effects.effect import (
    CENTRAL_TORSO,
    HEAD,
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
)  # fmt: skip
from world.effects.event import HELD_HZ, Event
from world.seats import GRAVITY_MPS2, RATE_HZ

Floats = NDArray[np.float64]
WHOLE: Final = (-1,)

# --- joints that stiffen ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoSlopes(Effect):
    """Ligaments that pull in tension only, above a soft knee: asymmetry."""

    knee: float = between(0.1, 0.3)

    kind, family, unit, strengths = "asymmetry", "elastic", "added stiffness in tension / k", (0.2, 0.8)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k (s + sqrt(s^2 + w^2) - w) / 2."""
        w, s = self.knee * now.person.reach_m[self.site], now.stretch[:, self.site]
        now.pull(
            self.site, 0.5 * self.strength * now.person.stiffness_n_per_m[self.site] * (s + np.sqrt(s * s + w * w) - w)
        )


@dataclass(frozen=True)
class Hyperbolic(Effect):
    """Stiffening by a hyperbolic sine either way: cubic."""

    toe: float = between(0.35, 0.6)

    kind, family, unit, strengths = "cubic", "elastic", "stiffness / k", (0.15, 0.6)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k (d sinh(s / d) - s), straight beyond 3 d."""
        d, s = self.toe * now.person.reach_m[self.site], now.stretch[:, self.site]
        u = np.clip(s / d, -3.0, 3.0)
        force = d * np.sinh(u) + (s - d * u) * np.cosh(3.0) - s
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * force)


@dataclass(frozen=True)
class HertzStop(Effect):
    """Two rounded ends that touch, and lose energy while they do: stop."""

    gap: float = between(0.4, 0.7)
    loss: float = between(0.1, 0.4)

    kind, family, unit, strengths = "stop", "elastic", "force / k d at the reach", (0.3, 1.5)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e k d u^1.5 (1 - loss v / rms v) where u = (-s / d - gap) / (1 - gap) > 0, never pulling."""
        person = now.person
        d = person.reach_m[self.site]
        u = np.maximum((-now.stretch[:, self.site] / d - self.gap) / (1.0 - self.gap), 0.0)
        losing = np.maximum(1.0 - self.loss * now.rate[:, self.site] / person.rate_mps[self.site], 0.0)
        now.pull(self.site, -self.strength * person.stiffness_n_per_m[self.site] * d * u**1.5 * losing)


# --- joints that rub and damp ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Valve(Effect):
    """A damper of a high power that resists compression more than rebound: quadratic_damping."""

    power: float = between(1.7, 2.4)
    rebound: float = between(0.4, 0.8)

    kind, family, unit, strengths = (
        "quadratic_damping",
        "quadratic_damping",
        "added force / b v at twice rms v",
        (0.3, 1.2),
    )

    def act(self, now: Moment, own: Floats) -> None:
        """F = e b v |v / 2 rms v|^(n - 1), less in rebound."""
        v, person = now.rate[:, self.site], now.person
        share = np.abs(v / (2.0 * person.rate_mps[self.site])) ** (self.power - 1.0)
        opened = np.where(v > 0.0, self.rebound, 1.0)
        now.pull(self.site, self.strength * person.damping_ns_per_m[self.site] * v * share * opened)


@dataclass(frozen=True)
class Stribeck(Effect):
    """Dry friction with more of it near standstill, without bristles: friction."""

    stiction: float = between(1.2, 1.8)
    width: float = between(0.05, 0.12)

    kind, family, unit, strengths = "friction", "rubbing", "Coulomb / rms damper force", (0.3, 1.2)

    def act(self, now: Moment, own: Floats) -> None:
        """F = Fc (1 + (stiction - 1) exp(-(v / 4 v0)^2)) v / sqrt(v^2 + v0^2)."""
        rate, v = now.person.rate_mps[self.site], now.rate[:, self.site]
        more = 1.0 + (self.stiction - 1.0) * np.exp(-((v / (4.0 * self.width * rate)) ** 2))
        coulomb_n = self.strength * now.person.damping_ns_per_m[self.site] * rate
        now.pull(self.site, coulomb_n * more * smooth_sign(v, self.width * rate))


@dataclass(frozen=True)
class Iwan(Effect):
    """Four springs in parallel that slip one after the other (Iwan, 1966): hysteresis."""

    last: float = between(0.3, 0.6)

    kind, family, unit, strengths, states = "hysteresis", "rubbing", "stiffness unslipped / k", (0.3, 1.2), 4

    def act(self, now: Moment, own: Floats) -> Floats:
        """By q' = v while |q| is below the slip's q_i or v brings it back, with a narrow edge; F = e k mean q."""
        slips = self.last * now.person.reach_m[self.site] * np.array([0.05, 0.2, 0.5, 1.0])
        v = now.rate[:, self.site, None]
        outward = np.clip((own * np.sign(v) / slips - 0.95) / 0.05, 0.0, 1.0)
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * own.mean(axis=1))
        return v * (1.0 - outward)


# --- joints that remember --------------------------------------------------------------------------------------------

SLOWEST_RADPS, FASTEST_RADPS, POLES = 0.5, 1500.0, 6


def oustaloup(power: float) -> tuple[float, Floats, Floats]:
    """s^power between 0.5 and 1500 rad/s as D - sum r_i / (s + p_i) (Oustaloup et al., 2000): D, r (6,), p (6,)."""
    ratio, k = FASTEST_RADPS / SLOWEST_RADPS, np.arange(POLES)
    zeros = SLOWEST_RADPS * ratio ** ((k + 0.5 * (1.0 - power)) / POLES)
    poles = SLOWEST_RADPS * ratio ** ((k + 0.5 * (1.0 + power)) / POLES)
    high = FASTEST_RADPS**power
    residues = [-high * np.prod(zeros - p) / np.prod(np.delete(poles, i) - p) for i, p in enumerate(poles)]
    return high, np.array(residues), poles


@dataclass(frozen=True)
class Fractional(Effect):
    """A spring-pot, half spring and half damper at every frequency: relaxation."""

    power: float = between(0.25, 0.55)
    corner_hz: float = between(3.0, 8.0)

    kind, family, unit, strengths, states = "relaxation", "memory", "stiffness at the corner / k", (0.15, 0.6), POLES

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k (s / w)^power of the stretch."""
        high, residues, poles = oustaloup(self.power)
        s = now.stretch[:, self.site]
        stiffness = self.strength * now.person.stiffness_n_per_m[self.site] / (2 * np.pi * self.corner_hz) ** self.power
        now.pull(self.site, stiffness * (high * s - own @ residues))
        return s[:, None] - poles * own


@dataclass(frozen=True)
class Brittle(Effect):
    """A gel that large stretches break quickly and that sets again slowly, its damping with it: thixotropy."""

    set_s: float = between(3.0, 9.0)
    break_s: float = between(0.2, 0.6)
    damped: float = between(0.3, 1.0)

    kind, family, unit, strengths, states = "thixotropy", "drifting", "softening / k when broken", (0.2, 0.5), 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """By g' = u^2 (1 - g) / t_break - g / t_set, u = 2 |s| / d; F = -e g^1.5 (k s + damped b v)."""
        s, gone, person = now.stretch[:, self.site], own[:, 0], now.person
        u = 2.0 * s / person.reach_m[self.site]
        k, b = person.stiffness_n_per_m[self.site], person.damping_ns_per_m[self.site]
        lost = self.strength * np.maximum(gone, 0.0) ** 1.5
        now.pull(self.site, -lost * (k * s + self.damped * b * now.rate[:, self.site]))
        return (u * u * (1.0 - gone) / self.break_s - gone / self.set_s)[:, None]


@dataclass(frozen=True)
class SitsUp(Effect):
    """The person sits up at once, somewhere in the sitting, and is stiffer and more damped from then on: posture."""

    at: float = between(0.2, 0.7)
    damped: float = between(0.5, 1.5)

    kind, family, unit, strengths = "posture", "drifting", "stiffness gained / k", (0.15, 0.4)

    def act(self, now: Moment, own: Floats) -> None:
        """A step in the sitting's time, which runs from 0 to 1."""
        person, gained = now.person, self.strength * (now.share >= self.at)
        k, b = person.stiffness_n_per_m[self.site], person.damping_ns_per_m[self.site]
        now.pull(self.site, gained * (k * now.stretch[:, self.site] + self.damped * b * now.rate[:, self.site]))


@dataclass(frozen=True)
class Tires(Effect):
    """A person who slowly slackens in every motion: posture."""

    after_s: float = between(3.0, 8.0)

    kind, family, unit, strengths = "posture", "drifting", "stiffness lost / k in the end", (0.2, 0.5)

    def act(self, now: Moment, own: Floats) -> None:
        """Exponentially, since the motion set in."""
        lost = self.strength * -np.expm1(-np.maximum(now.moving_s, 0.0) / self.after_s)
        now.pull(self.site, -lost * now.person.stiffness_n_per_m[self.site] * now.stretch[:, self.site])


@dataclass(frozen=True)
class TiringReflex(Effect):
    """A muscle that answers the rate of a while ago, by a twitch of second order, and no more than it can: reflex."""

    late_s: float = between(0.045, 0.09)
    twitch_s: float = between(0.012, 0.025)
    most: float = between(0.5, 1.0)

    kind, family, unit, strengths, states = "reflex", "memory", "gain / k", (0.15, 0.5), 2

    @property
    def delay_s(self) -> float:
        """Nerves and spine."""
        return self.late_s

    def act(self, now: Moment, own: Floats) -> Floats:
        """By z'' = (T v - z - 2 T z') / T^2 with T the twitch; F = e k d tanh(5 z(t - late) / d), d its most."""
        z, rate = own.T
        d = self.most * now.person.reach_m[self.site]
        now.pull(
            self.site, self.strength * now.person.stiffness_n_per_m[self.site] * d * np.tanh(5.0 * now.late[:, 0] / d)
        )
        t = self.twitch_s
        return np.column_stack([rate, (t * now.rate[:, self.site] - z - 2.0 * t * rate) / t**2])


# --- seat, backrest and belts ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SoftContact(Effect):
    """A seat that lets go gradually, as flesh does: lift_off."""

    edge: float = between(0.04, 0.1)

    kind, family, unit, strengths, sites, scalable = "lift_off", "lift_off", "there", (1.0, 1.0), (PELVIS,), False

    def act(self, now: Moment, own: Floats) -> None:
        """W - F becomes w log(1 + exp((W - F) / w)), less its excess at rest."""
        weight = now.person.weight_n
        w = self.edge * weight
        carried = w * np.logaddexp(0.0, (weight - now.joint_n[:, 0]) / w)
        excess = w * np.log1p(np.exp(-1.0 / self.edge))
        now.pull(0, self.strength * (weight - carried + excess - now.joint_n[:, 0]))


@dataclass(frozen=True)
class LayeredCushion(Effect):
    """Two layers with a mass on each, the lower one softer at rest than when it is deep: cushion."""

    upper_kg: float = between(0.8, 1.5)
    lower_kg: float = between(1.0, 2.5)
    upper_n_per_m: float = between(1.5e5, 3e5)
    lower_n_per_m: float = between(8e4, 2e5)
    loss_s: float = between(0.006, 0.012)

    kind, family, unit, strengths, sites, states = "cushion", "cushion", "compliance", (0.5, 1.5), (PELVIS,), 4

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats] | None:
        """The joint stands on the upper layer."""
        return (0, -own[:, 0], -own[:, 1]) if self.strength else None

    def act(self, now: Moment, own: Floats) -> Floats:
        """Springs and dampers in a row."""
        if not self.strength:
            return np.zeros_like(own)
        x, v, y, w = own.T
        upper = self.upper_n_per_m / self.strength * (x - y + self.loss_s * (v - w))
        lower = self.lower_n_per_m / self.strength * (y - 40.0 * y * np.minimum(y, 0.0) + self.loss_s * w)
        up = (now.joint_n[:, 0] - upper) / self.upper_kg - now.base_mps2
        return np.column_stack([v, up, w, (upper - lower) / self.lower_kg - now.base_mps2])


@dataclass(frozen=True)
class SlippingBackrest(Effect):
    """A backrest that holds until the shirt slips, earlier where the seat brakes: backrest."""

    slip: float = between(0.3, 0.8)
    loss_s: float = between(0.005, 0.02)
    pressed: float = between(0.1, 0.4)

    kind, family, unit, strengths, states = "backrest", "backrest", "stiffness / N/m", (1.5e3, 8e3), 1
    sites = (CENTRAL_TORSO, UPPER_TORSO)

    def signals(self, event: Event, person: Person) -> Floats:
        """How hard the torso leans back, 1 at rest: the seat's forward acceleration, smoothed."""
        sos = signal.butter(1, 5.0, fs=RATE_HZ, output="sos")
        forward = signal.sosfilt(sos, event.accel_mps2[:, :1], axis=0)
        return np.maximum(1.0 + self.pressed * forward, 0.1)

    def act(self, now: Moment, own: Floats) -> Floats:
        """By q' = v - |v| q / d, d the slip; F = -e (q + loss v)."""
        d = self.slip * now.person.rise_m[self.site] * now.signal[:, 0]
        v, q = now.v[:, self.site], own[:, 0]
        now.push(self.site, -self.strength * (q + self.loss_s * v))
        return (v - np.abs(v) * q / d)[:, None]


@dataclass(frozen=True)
class CatchingBelt(Effect):
    """A belt with slack that catches the harder the faster it is drawn: harness."""

    slack: float = between(0.3, 0.6)
    catch: float = between(0.2, 0.8)

    kind, family, unit, strengths, sites = "harness", "harness", "stiffness / N/m", (1.5e4, 6e4), (UPPER_TORSO,)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e d u^1.3 (1 + catch v / rms v), u = x / d - slack > 0, never pushing up; d is the rise."""
        d = now.person.rise_m[self.site]
        u = np.maximum(now.x[:, self.site] / d - self.slack, 0.0)
        caught = np.maximum(1.0 + self.catch * now.v[:, self.site] / (3.0 * now.person.rate_mps[0]), 0.0)
        now.push(self.site, -self.strength * d * u**1.3 * caught)


# --- masses ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SoftOrgan(Effect):
    """One organ whose suspension stiffens and whose damping is a liquid's: viscera."""

    frequency_hz: float = between(4.0, 5.5)
    damping: float = between(0.12, 0.25)
    travel_m: float = between(0.015, 0.04)

    kind, family, unit, strengths, states = "viscera", "memory", "kg", (3.0, 8.0), 2
    sites = (LOWER_TORSO, CENTRAL_TORSO, UPPER_TORSO)

    def act(self, now: Moment, own: Floats) -> Floats:
        """Per kg: w^2 u (1 + (u / travel)^2) + 2 zeta w u' (1 + |u'| / 0.2 m/s), u = x - z."""
        z, rate = own.T
        w = 2.0 * np.pi * self.frequency_hz
        u, slip = now.x[:, self.site] - z, now.v[:, self.site] - rate
        hung = w**2 * u * (1.0 + (u / self.travel_m) ** 2) + 2.0 * self.damping * w * slip * (1.0 + np.abs(slip) / 0.2)
        now.push(self.site, -self.strength * hung)
        return np.column_stack([rate, hung - now.base_mps2])


@dataclass(frozen=True)
class HeldArms(Effect):
    """Arms that hang on the shoulders and lie on the thighs, half of the spring each: added_mass."""

    shoulder_hz: float = between(12.0, 20.0)
    damping: float = between(0.4, 0.7)
    held: float = between(0.0, 0.15)

    kind, family, unit, strengths, sites, states = "added_mass", "added_mass", "kg", (2.0, 6.0), (UPPER_TORSO,), 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """A sprung mass between the torso and, weakly, the pelvis."""
        z, rate = own.T
        w = 2.0 * np.pi * self.shoulder_hz
        by_shoulder, by_thigh = (
            share * (w**2 * (now.x[:, at] - z) + 2.0 * self.damping * w * (now.v[:, at] - rate))
            for share, at in ((1.0 - self.held, self.site), (self.held, PELVIS))
        )
        now.push(self.site, -self.strength * by_shoulder)
        now.push(PELVIS, -self.strength * by_thigh)
        return np.column_stack([rate, by_shoulder + by_thigh - now.base_mps2])


# --- further inputs to the body --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SwayingTrunk(Effect):
    """Forward and left motion that comes back up through a resonance of the trunk, some time later: cross_axis."""

    resonance_hz: float = between(2.0, 5.0)
    damping: float = between(0.3, 0.6)
    late_s: float = between(0.01, 0.04)
    left: float = between(-0.8, 0.8)

    kind, family, unit, strengths, sites = "cross_axis", "sideways", "vertical / forward", (0.1, 0.4), WHOLE

    def signals(self, event: Event, person: Person) -> Floats:
        """A sum of both, through a resonance."""
        w = 2.0 * np.pi * self.resonance_hz
        loss = 2.0 * self.damping * w
        both = event.accel_mps2[:, 0] + self.left * event.accel_mps2[:, 1]
        late = round(self.late_s * RATE_HZ)
        behind = np.concatenate([np.zeros(late), both[: both.size - late]])
        return signal.lfilter(*signal.bilinear([w * w], [1.0, loss, w * w], RATE_HZ), behind)[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """By m e times it, on every segment."""
        now.up_n += self.strength * now.signal * now.person.inertia_kg


@dataclass(frozen=True)
class RockingSeat(Effect):
    """A seat that rocks on its frame, so that its lever comes through a resonance: pitch."""

    frame_hz: float = between(10.0, 18.0)
    damping: float = between(0.2, 0.5)
    across: float = between(-0.8, 0.8)

    kind, family, unit, strengths, sites = "pitch", "sideways", "lever / m", (0.06, 0.3), WHOLE

    def base_mps2(self, event: Event) -> Floats:
        """By l (q' + across p'), through the frame."""
        w = 2.0 * np.pi * self.frame_hz
        loss = 2.0 * self.damping * w
        roll, pitch = np.gradient(event.spin_radps(0), 1.0 / RATE_HZ, axis=0).T
        through = signal.lfilter(
            *signal.bilinear([loss, w * w], [1.0, loss, w * w], RATE_HZ), pitch + self.across * roll
        )
        return self.strength * through


@dataclass(frozen=True)
class CurvedNeck(Effect):
    """A neck that is bent already and bends into an arc, whose chord is L sin(phi / 2) / (phi / 2): bending."""

    bent_rad: float = between(0.05, 0.25)

    kind, family, unit, strengths, sites = "bending", "bending", "length / m", (0.15, 0.8), (NECK, HEAD)

    def signals(self, event: Event, person: Person) -> Floats:
        """How much shorter than at rest an arc of 1 m is, and at what rate."""
        phi = self.bent_rad + (event.leaning_rad(self.site + 1) - event.leaning_rad(self.site))[:, 1]
        short = np.sinc(self.bent_rad / (2.0 * np.pi)) - np.sinc(phi / (2.0 * np.pi))
        return np.column_stack([short, np.gradient(short, 1.0 / RATE_HZ)])

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats]:
        """So much more stretch."""
        return self.site, self.strength * now.signal[:, 0], self.strength * now.signal[:, 1]


@dataclass(frozen=True)
class RoughEngine(Effect):
    """An engine with a half order that comes and goes, shaking a segment at standstill too: periodic."""

    frequency_hz: float = between(24.0, 50.0)
    half: float = between(0.2, 0.6)
    beat_hz: float = between(0.1, 0.5)

    kind, family, unit, strengths = "periodic", "periodic", "m/s^2", (0.2, 1.0)

    def signals(self, event: Event, person: Person) -> Floats:
        """A line, its half order, and a beat on both."""
        turns = self.frequency_hz * (event.begin_s + event.time_s)
        beat = 1.0 + 0.4 * np.sin(2.0 * np.pi * self.beat_hz * event.time_s)
        return (beat * (np.sin(2.0 * np.pi * turns) + self.half * np.sin(np.pi * turns + 1.0)))[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """Shake the segment."""
        now.push(self.site, self.strength * now.person.inertia_kg[self.site] * now.signal[:, 0])


# --- sensors ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CreepingSkin(Effect):
    """Skin on fat: a mode whose spring creeps, so a third order: skin."""

    mode_hz: float = between(16.0, 40.0)
    damping: float = between(0.15, 0.35)
    creep_s: float = between(0.005, 0.02)
    crept: float = between(0.3, 0.8)

    kind, family, unit, strengths, sites = "skin", "sensor", "share that rides on the skin", (0.25, 1.0), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """By h / (s^2 + h), h = w^2 (1 + crept T s / (1 + T s)) + 2 zeta w s."""
        if sensor != self.site:
            return accel_mps2
        w, t = 2.0 * np.pi * self.mode_hz, self.creep_s
        loss = 2.0 * self.damping * w
        hold = np.array([loss * t, w * w * t * (1.0 + self.crept) + loss, w * w])
        whole = np.array([t, 1.0 + loss * t, hold[1], hold[2]])
        skin = signal.lfilter(*signal.bilinear(hold, whole, HELD_HZ), accel_mps2, axis=0)
        return accel_mps2 + self.strength * (skin - accel_mps2)


@dataclass(frozen=True)
class SlidesInMotion(Effect):
    """A sensor that slides aslant as soon as it is shaken, and back at rest: tilt."""

    within_s: float = between(0.3, 1.5)
    side: float = between(-0.5, 0.5)

    kind, family, unit, strengths, sites = "tilt", "sideways", "rad", (0.08, 0.25), WORN

    def lean_rad(self, sensor: int, event: Event) -> Floats | None:
        """Exponentially towards its angle in motion and back after it."""
        if sensor != self.site:
            return None
        decay = np.exp(-1.0 / (self.within_s * RATE_HZ))
        slid = signal.lfilter([1.0 - decay], [1.0, -decay], event.moving > 0.0)
        return self.strength * slid[:, None] * np.array([self.side, 1.0])


@dataclass(frozen=True)
class WarpingClock(Effect):
    """A clock that breathes with its oscillator's temperature around an offset: clock."""

    period_s: float = between(15.0, 60.0)
    swing: float = between(0.2, 0.6)

    kind, family, unit, strengths, sites = "clock", "sensor", "s", (1e-3, 5e-3), WORN

    def clock_late_s(self, sensor: int, event: Event, time_s: Floats) -> Floats | float:
        """Late by an offset and a slow sine."""
        if sensor != self.site:
            return 0.0
        return self.strength * (1.0 + self.swing * np.sin(2.0 * np.pi * (event.begin_s + time_s) / self.period_s))


@dataclass(frozen=True)
class WarmingGain(Effect):
    """A gain error that grows while the sensor is shaken, and that gravity at rest does not show: gain."""

    warm_s: float = between(0.5, 3.0)

    kind, family, unit, strengths, sites = "gain", "sensor", "share", (0.05, 0.15), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Motion is read too small, soon after it sets in."""
        if sensor != self.site:
            return accel_mps2
        decay = np.exp(-1.0 / (self.warm_s * HELD_HZ))
        warm = signal.lfilter([1.0 - decay], [1.0, -decay], event.moving[::2])
        return accel_mps2 * (1.0 - self.strength * warm[:, None])


@dataclass(frozen=True)
class SoftClip(Effect):
    """A sensor that bends its readings before the end of its range: saturation."""

    linear: float = between(0.6, 0.85)

    kind, family, unit, strengths, sites = "saturation", "saturation", "1 / range in 20 m/s^2", (0.6, 1.0), WORN

    def reading(self, sensor: int, force_mps2: Floats) -> Floats:
        """Straight up to a share of the range, then a hyperbolic tangent towards it."""
        if sensor != self.site or not self.strength:
            return force_mps2
        full = GRAVITY_MPS2 + 20.0 / self.strength
        straight = self.linear * full
        size = np.abs(force_mps2)
        bent = straight + (full - straight) * np.tanh((size - straight) / (full - straight))
        return np.where(size > straight, np.sign(force_mps2) * bent, force_mps2)


# --- of no class -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tremor(Effect):
    """A muscle that trembles by itself, as van der Pol's oscillator does, and more when it is stretched: outside."""

    frequency_hz: float = between(7.0, 11.0)
    coupled: float = between(0.5, 1.5)

    kind, family, unit, strengths, states = "outside", "outside", "force / k d", (0.03, 0.12), 2
    sites = (LOWER_TORSO, CENTRAL_TORSO, UPPER_TORSO, NECK)

    def act(self, now: Moment, own: Floats) -> Floats:
        """By u'' = w (1 - u^2) u' - w^2 (u - c s / d); F = e k d u."""
        u, rate = own.T
        w, d = 2.0 * np.pi * self.frequency_hz, now.person.reach_m[self.site]
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * d * u)
        driven = w * w * (self.coupled * now.stretch[:, self.site] / d - u)
        return np.column_stack([rate, w * (1.0 - u * u) * rate + driven])


@dataclass(frozen=True)
class LongBypass(Effect):
    """A spring from the pelvis past three joints, that only pulls: outside."""

    loss_s: float = between(0.005, 0.02)

    kind, family, unit, strengths, sites = (
        "outside",
        "outside",
        "stiffness / the joints' in series",
        (0.5, 2.0),
        (PELVIS,),
    )

    def act(self, now: Moment, own: Floats) -> None:
        """Between pelvis and upper torso, behind a knee of a tenth of the reach."""
        k = 1.0 / (1.0 / now.person.stiffness_n_per_m[1:4]).sum()
        apart = now.x[:, UPPER_TORSO] - now.x[:, PELVIS]
        w = 0.1 * now.person.reach_m[1:4].sum()
        rate = self.loss_s * (now.v[:, UPPER_TORSO] - now.v[:, PELVIS])
        tension = self.strength * k * 0.5 * (apart + np.sqrt(apart**2 + w**2) - w + rate)
        now.push(UPPER_TORSO, -tension)
        now.push(PELVIS, tension)


@dataclass(frozen=True)
class SharedHead(Effect):
    """A head that is braced against the torso by muscles which the seat's shaking wakes: outside."""

    wakes_s: float = between(0.1, 0.4)

    kind, family, unit, strengths, sites = "outside", "outside", "stiffness / k at full shaking", (0.5, 2.0), (HEAD,)

    def signals(self, event: Event, person: Person) -> Floats:
        """The seat's shaking, smoothed, 1 at its most."""
        decay = np.exp(-1.0 / (self.wakes_s * RATE_HZ))
        shaken = signal.lfilter([1.0 - decay], [1.0, -decay], np.abs(event.accel_mps2[:, 2:]), axis=0)
        return shaken / max(float(shaken.max()), 1e-9)

    def act(self, now: Moment, own: Floats) -> None:
        """A spring from the upper torso to the head, stiff when awake."""
        apart = now.x[:, HEAD] - now.x[:, UPPER_TORSO]
        tension = self.strength * now.person.stiffness_n_per_m[HEAD] * now.signal[:, 0] * apart
        now.push(HEAD, -tension)
        now.push(UPPER_TORSO, tension)


FORMS: Final[tuple[type[Effect], ...]] = (
    TwoSlopes, Hyperbolic, HertzStop, Valve, Stribeck, Iwan, Fractional, Brittle, SitsUp, Tires, TiringReflex,
    SoftContact, LayeredCushion, SlippingBackrest, CatchingBelt, SoftOrgan, HeldArms, SwayingTrunk, RockingSeat,
    CurvedNeck, RoughEngine, CreepingSkin, SlidesInMotion, WarpingClock, WarmingGain, SoftClip, Tremor, LongBypass,
    SharedHead,
)  # fmt: skip
