"""Forms for scoring, by laws that neither the catalogue nor the other splits use; every class, and some of none.

`d` is the reach of the joint (`Person.reach_m`), `s` its stretch and `v` its rate; `k` and `b` are those of the joint.
Sources are named by author and year; a form without a source gives its physical reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal, special

from world import sensors
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
    soften,
)  # fmt: skip
from world.effects.event import HELD_HZ, Event, following
from world.seats import GRAVITY_MPS2, RATE_HZ

Floats = NDArray[np.float64]

TORSO: Final = (LOWER_TORSO, CENTRAL_TORSO, UPPER_TORSO)

# --- joints that stiffen ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class NeoHookeanPad(Effect):
    """A pad of incompressible rubber-like tissue beside the joint (Treloar 1944): asymmetry."""

    thick: float = between(3.0, 6.0)

    kind, family, unit, strengths = "asymmetry", "elastic", "stiffness of the pad / k", (0.25, 0.9)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k L ((y - 1 / y^2) / 3 - (y - 1)), y = 1 + s / L, L = thick d; linear where y is below 0.5."""
        length = self.thick * now.person.reach_m[self.site]
        ratio = 1.0 + now.stretch[:, self.site] / length
        near = np.maximum(ratio, 0.5)
        force = (near - near**-2) / 3.0 - (near - 1.0) + (17.0 / 3.0 - 1.0) * (ratio - near)
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * length * force)


@dataclass(frozen=True)
class GuyWires(Effect):
    """Slack-free ligaments across the joint that turn into its direction (geometric stiffness of a string): cubic."""

    span: float = between(0.5, 1.2)

    kind, family, unit, strengths = "cubic", "elastic", "stiffness far out / k", (0.3, 1.5)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k s (1 - 1 / sqrt(1 + (s / L)^2)), L = span d; e k s far out."""
        s = now.stretch[:, self.site]
        turned = 1.0 - 1.0 / np.hypot(1.0, s / (self.span * now.person.reach_m[self.site]))
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * s * turned)


@dataclass(frozen=True)
class CartilageFilm(Effect):
    """A thin incompressible layer (Blankevoort 1991) behind a film of fluid that is squeezed out (Reynolds): stop."""

    gap: float = between(0.3, 0.6)
    layer: float = between(0.3, 0.8)
    film: float = between(0.3, 1.0)

    kind, family, unit, strengths = "stop", "elastic", "stiffness at contact / k", (0.4, 2.0)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e (-k t ln(1 - u) + film b max(0, -v) / (1 + h / 0.3 g)^3), h = max(0, g + s), u = max(0, -g - s) / t.

        g = gap d, t = layer d; linear beyond u = 0.8.
        """
        d, k = now.person.reach_m[self.site], now.person.stiffness_n_per_m[self.site]
        clear = self.gap * d + now.stretch[:, self.site]
        u = np.maximum(-clear, 0.0) / (self.layer * d)
        near = np.minimum(u, 0.8)
        solid = k * self.layer * d * (-np.log1p(-near) + (u - near) / 0.2)
        squeezed = np.maximum(-now.rate[:, self.site], 0.0) / (1.0 + np.maximum(clear, 0.0) / (0.3 * self.gap * d)) ** 3
        film = self.film * now.person.damping_ns_per_m[self.site] * squeezed
        now.pull(self.site, -self.strength * (solid + film))


# --- dampers and friction --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TurbulenceBuildsUp(Effect):
    """A flow loss that follows the speed of the flow with a delay, as turbulence must grow first: quadratic_damping."""

    build_s: float = between(0.01, 0.05)

    kind, family, unit = "quadratic_damping", "quadratic_damping", "added force / b v at the rms rate"
    strengths = (0.3, 1.5)
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e b v w / (1 + w / 8), w' = (|v| / rms rate - w) / build_s."""
        v, w = now.rate[:, self.site], own[:, 0]
        now.pull(self.site, self.strength * now.person.damping_ns_per_m[self.site] * v * w / (1.0 + 0.125 * w))
        return ((np.abs(v) / now.person.rate_mps[self.site] - w) / self.build_s)[:, None]


@dataclass(frozen=True)
class JenkinRow(Effect):
    """Four spring-slider pairs in parallel that slip one after the other (Prandtl 1928, Jenkin): friction."""

    slip: float = between(0.1, 0.3)

    kind, family, unit, strengths = "friction", "rubbing", "Coulomb / rms damper force", (0.8, 4.0)
    states = 4

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = F_c mean(z_i / y_i), z_i' = v (1 - |z_i / y_i|^4 where it is driven outward), y_i = slip d (0.5 to 2)."""
        person, v = now.person, now.rate[:, self.site, None]
        yields = self.slip * person.reach_m[self.site] * np.array([0.5, 0.8, 1.25, 2.0])
        share = own / yields
        coulomb = self.strength * person.damping_ns_per_m[self.site] * person.rate_mps[self.site]
        now.pull(self.site, coulomb * share.mean(axis=1))
        return v * (1.0 - np.where(v * own > 0.0, np.minimum(np.abs(share), 1.0) ** 4, 0.0))


@dataclass(frozen=True)
class ColemanHodgdon(Effect):
    """Duhem hysteresis that approaches one saturating curve along the path (Coleman and Hodgdon 1986): hysteresis."""

    memory: float = between(0.3, 0.8)
    width: float = between(0.4, 1.0)

    kind, family, unit, strengths = "hysteresis", "rubbing", "saturated force / k d", (0.2, 1.0)
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k d z, z' = |v| / (memory d) (tanh(s / (width d)) - z)."""
        d = now.person.reach_m[self.site]
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * d * own[:, 0])
        curve = np.tanh(now.stretch[:, self.site] / (self.width * d))
        return (np.abs(now.rate[:, self.site]) / (self.memory * d) * (curve - own[:, 0]))[:, None]


# --- joints with a memory --------------------------------------------------------------------------------------------

ARM_SHARES: Final = (np.arange(8) + 0.5) / 8.0
ARM_RATES: Final = 0.25 / special.erfinv(1.0 - ARM_SHARES) ** 2
"""Medians of equal shares of Levy's distribution, whose Laplace transform is exp(-sqrt(t))."""


@dataclass(frozen=True)
class StretchedExponential(Effect):
    """Stress that relaxes as exp(-sqrt(t / tau)), by eight arms of equal weight (Kohlrausch 1854): relaxation."""

    tau_s: float = between(0.3, 1.0)

    kind, family, unit, strengths = "relaxation", "memory", "all arms / k", (0.3, 1.5)
    states = 8

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k mean(s - q_i), q_i' = r_i (s - q_i) / tau, r_i of `ARM_RATES`."""
        over = now.stretch[:, self.site, None] - own
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * over.mean(axis=1))
        return over * (ARM_RATES / self.tau_s)


@dataclass(frozen=True)
class EyringDashpot(Effect):
    """A Maxwell arm whose dashpot yields by thermally activated flow (Eyring 1936): relaxation."""

    tau_s: float = between(0.08, 0.3)
    stress: float = between(0.2, 0.5)

    kind, family, unit, strengths = "relaxation", "memory", "arm / k", (0.2, 0.9)
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k (s - q), q' = stress d / tau sinh(u), u = (s - q) / (stress d); linear beyond |u| = 4."""
        over, scale = now.stretch[:, self.site] - own[:, 0], self.stress * now.person.reach_m[self.site]
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * over)
        near = np.clip(over / scale, -4.0, 4.0)
        flow = np.sinh(near) + np.cosh(4.0) * (over / scale - near)
        return (scale / self.tau_s * flow)[:, None]


@dataclass(frozen=True)
class WorkBreaksBonds(Effect):
    """Bonds that viscous work breaks and that heal in pairs, by second-order kinetics: thixotropy."""

    break_s: float = between(0.5, 2.0)
    heal_s: float = between(0.5, 3.0)
    damped: float = between(0.0, 1.0)

    kind, family, unit, strengths = "thixotropy", "drifting", "softening / k with all bonds broken", (0.15, 0.6)
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """Stiffness k (1 - e n), n' = (1 - n) min(40, (v / rms rate)^2) / break_s - n^2 / heal_s."""
        n = own[:, 0]
        soften(now, self.site, self.strength * n, self.damped)
        work = np.minimum((now.rate[:, self.site] / now.person.rate_mps[self.site]) ** 2, 40.0)
        return ((1.0 - n) * work / self.break_s - n * n / self.heal_s)[:, None]


@dataclass(frozen=True)
class SlumpsSlowly(Effect):
    """Muscles that tire during the whole sitting, quickly at first: posture."""

    fast: float = between(4.0, 12.0)
    damped: float = between(0.0, 1.0)

    kind, family, unit, strengths = "posture", "drifting", "stiffness lost / k", (0.1, 0.5)

    def act(self, now: Moment, own: Floats) -> None:
        """Stiffness k (1 - e ln(1 + fast t / T) / ln(1 + fast)), T the length of the sitting."""
        lost = np.log1p(self.fast * np.clip(now.share, 0.0, 1.0)) / np.log1p(self.fast)
        soften(now, self.site, self.strength * lost, self.damped)


@dataclass(frozen=True)
class StartleLetsGo(Effect):
    """Muscles that brace when the motion sets in and let go again (habituation of a startle, Blouin 2006): posture."""

    rise_s: float = between(0.08, 0.2)
    lasts_s: float = between(1.0, 4.0)

    kind, family, unit, strengths = "posture", "drifting", "stiffness at first / k", (0.4, 1.5)

    def act(self, now: Moment, own: Floats) -> None:
        """Stiffness k (1 + e (1 - exp(-t / rise)) exp(-t / lasts)), t since the motion set in."""
        since = max(now.moving_s, 0.0)
        braced = -np.expm1(-since / self.rise_s) * np.exp(-since / self.lasts_s)
        k = now.person.stiffness_n_per_m[self.site]
        now.pull(self.site, self.strength * braced * k * now.stretch[:, self.site])


@dataclass(frozen=True)
class TwoLoops(Effect):
    """A spinal reflex and a later, spread one through the brain (Matthews 1991): reflex."""

    delay: float = between(0.030, 0.045)
    apart_s: float = between(0.03, 0.06)
    long: float = between(0.3, 0.7)

    kind, family, unit, strengths = "reflex", "memory", "gain of both loops / k", (0.1, 0.4)
    states = 4

    @property
    def delay_s(self) -> float:
        """Of the spinal reflex."""
        return self.delay

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = e k ((1 - long) p(t - delay) + long h): p lags s by 6 ms, h lags p(t - delay) by three poles, apart_s."""
        spinal = now.late[:, 0]
        pull = (1.0 - self.long) * spinal + self.long * own[:, 3]
        now.pull(self.site, self.strength * now.person.stiffness_n_per_m[self.site] * pull)
        before = np.column_stack([now.stretch[:, self.site], spinal, own[:, 1], own[:, 2]])
        return (before - own) / np.array([0.006, *[self.apart_s / 3.0] * 3])


# --- the seat, organs and loads --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PeelsOffTheSeat(Effect):
    """Parts of the contact with unequal shares of the weight leave the seat one after the other: lift_off."""

    spread: float = between(0.4, 0.9)

    kind, family, unit, strengths = "lift_off", "lift_off", "there", (1.0, 1.0)
    sites, scalable = (PELVIS,), False

    def act(self, now: Moment, own: Floats) -> None:
        """F_1 = mean of min(F_1, w), w uniform in W (1 - spread) to W (1 + spread)."""
        weight, joint = now.person.weight_n, now.joint_n[:, 0]
        low, high = weight * (1.0 - self.spread), weight * (1.0 + self.spread)
        opening = np.clip(joint, low, high) - low
        held = np.minimum(joint, high) - opening**2 / (2.0 * (high - low))
        now.pull(PELVIS, self.strength * (held - joint))


@dataclass(frozen=True)
class FoamWithAir(Effect):
    """Foam that hardens when compressed, with air that leaves through its pores (Hilyard 1971, Gent 1966): cushion."""

    mass_kg: float = between(1.5, 4.0)
    damping_ratio: float = between(0.3, 0.8)
    thick_m: float = between(0.03, 0.06)
    air: float = between(0.2, 0.6)
    leak_s: float = between(0.02, 0.10)

    kind, family, unit, strengths = "cushion", "cushion", "compliance of the foam / that of the joint", (0.15, 1.0)
    sites = (PELVIS,)
    states = 3

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats] | None:
        """The pelvis is on a cushion that moves."""
        return (PELVIS, -own[:, 0], -own[:, 1]) if self.strength else None

    def act(self, now: Moment, own: Floats) -> Floats:
        """Newton: m (x'' + a_s) = F_1 - k_f (x (1 + 9 u^2) + air (x - q)) - c x', u = -x / thick in 0 to 0.8.

        k_f = k / e, c of the damping ratio; q' = w / (leak_s (1 + w^2)^(1/4)) mm, w = (x - q) / mm.
        """
        if not self.strength:
            return np.zeros_like(own)
        x, v, q = own.T
        k = now.person.stiffness_n_per_m[PELVIS] / self.strength
        pressed = np.clip(-x / self.thick_m, 0.0, 0.8)
        foam = x * (1.0 + 9.0 * pressed**2) + self.air * (x - q)
        loss = 2.0 * self.damping_ratio * np.sqrt(k * self.mass_kg) * v
        up = (now.joint_n[:, PELVIS] - k * foam - loss) / self.mass_kg - now.base_mps2
        flow = (x - q) / (self.leak_s * (1.0 + ((x - q) / 1e-3) ** 2) ** 0.25)
        return np.column_stack([v, up, flow])


@dataclass(frozen=True)
class OrganOnOrgan(Effect):
    """An organ on the segment that carries another one, two modes in series (Kitazaki and Griffin 1997): viscera."""

    lower: float = between(0.4, 0.7)
    frequency_hz: float = between(4.0, 7.0)
    upper_ratio: float = between(1.2, 2.0)
    damping_ratio: float = between(0.10, 0.25)

    kind, family, unit, strengths, sites = "viscera", "memory", "kg", (2.0, 8.0), TORSO
    states = 4

    def act(self, now: Moment, own: Floats) -> Floats:
        """Newton: m_1 (x_1'' + a_s) = P_1 - P_2, m_2 (x_2'' + a_s) = P_2, P a spring and a damper to the mass below."""
        x1, v1, x2, v2 = own.T
        masses = np.array([self.lower, 1.0 - self.lower])
        w = 2.0 * np.pi * self.frequency_hz * np.array([1.0, self.upper_ratio])
        loss, k = 2.0 * self.damping_ratio * w, w * w
        # Forces per kg of both: the lower one's spring carries both.
        first = loss[0] * (now.v[:, self.site] - v1) + k[0] * (now.x[:, self.site] - x1)
        second = masses[1] * (loss[1] * (v1 - v2) + k[1] * (x1 - x2))
        now.push(self.site, -self.strength * first)
        up = (first - second) / masses[0] - now.base_mps2, second / masses[1] - now.base_mps2
        return np.column_stack([v1, up[0], v2, up[1]])


@dataclass(frozen=True)
class ReclinedBackOpens(Effect):
    """A reclined backrest that sticks and slips, pressed less the higher the body rises (Perzyna 1966): backrest."""

    slip: float = between(0.3, 0.8)
    opens: float = between(1.0, 2.0)

    kind, family, unit, strengths, sites = "backrest", "backrest", "stiffness / N/m", (4e3, 3e4), TORSO
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = -e z, z' = x' - sgn(z) max(0, |z| - z_c) / 4 ms, z_c = slip r (1 - x / (opens r)) in 0 to 3 slip r.

        r is how far the person rises.
        """
        z, rise = own[:, 0], now.person.rise_m[self.site]
        holds = self.slip * rise * np.clip(1.0 - now.x[:, self.site] / (self.opens * rise), 0.0, 3.0)
        now.push(self.site, -self.strength * z)
        return (now.v[:, self.site] - np.sign(z) * np.maximum(np.abs(z) - holds, 0.0) / 0.004)[:, None]


@dataclass(frozen=True)
class WebbingWithBuckle(Effect):
    """Two lengths of webbing with a heavy buckle between them; neither pushes: harness."""

    slack: float = between(0.1, 0.4)
    mass_kg: float = between(0.3, 0.6)
    held: float = between(0.05, 0.15)

    kind, family, unit, strengths, sites = "harness", "harness", "stiffness / N/m", (5e3, 4e4), (UPPER_TORSO,)
    states = 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """F = -T, T = 2 e max(0, x - y - slack r), m (y'' + a_s) = T - 2 e max(0, y) - held e y - c y'.

        c is 0.3 of critical for both lengths; r is how far the person rises.
        """
        y, v = own.T
        slack = self.slack * now.person.rise_m[self.site]
        above = 2.0 * self.strength * np.maximum(now.x[:, self.site] - y - slack, 0.0)
        below = 2.0 * self.strength * np.maximum(y, 0.0) + self.held * self.strength * y
        loss = 0.6 * np.sqrt(4.0 * self.strength * self.mass_kg) * v
        now.push(self.site, -above)
        return np.column_stack([v, (above - below - loss) / self.mass_kg - now.base_mps2])


@dataclass(frozen=True)
class HoppingLoad(Effect):
    """A rucksack or a helmet that lies on the segment by its weight alone, so that it can hop: added_mass."""

    frequency_hz: float = between(5.0, 10.0)
    damping_ratio: float = between(0.2, 0.5)

    kind, family, unit, strengths, sites = "added_mass", "added_mass", "kg", (1.0, 4.0), (UPPER_TORSO, HEAD)
    states = 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """Newton: m (y'' + a_s) = N - m g, N = max(0, m g + k (x - y) + c (x' - y')), reaction on the segment."""
        y, v = own.T
        w = 2.0 * np.pi * self.frequency_hz
        spring = w * w * (now.x[:, self.site] - y) + 2.0 * self.damping_ratio * w * (now.v[:, self.site] - v)
        lifted = np.maximum(spring, -GRAVITY_MPS2)
        now.push(self.site, -self.strength * lifted)
        return np.column_stack([v, lifted - now.base_mps2])


# --- sideways and rotation -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RocksAtTheHip(Effect):
    """A trunk that rocks at the hip when braked, and more so the higher the segment (Fairley 1990): cross_axis."""

    frequency_hz: float = between(1.5, 3.5)
    damping_ratio: float = between(0.2, 0.45)
    left: float = between(-0.4, 0.4)

    kind, family, unit, strengths, sites = "cross_axis", "sideways", "vertical / forward at the head", (0.1, 0.5), (-1,)

    def signals(self, event: Event, person: Person) -> Floats:
        """The horizontal acceleration of a resonance at the hip, (n, 1)."""
        aside = event.accel_mps2[:, 0] + self.left * event.accel_mps2[:, 1]
        return signal.lfilter(*following(self.frequency_hz, self.damping_ratio, RATE_HZ), aside)[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """F_i = e m_i i / 6 a, i = 1 at the pelvis to 6 at the head."""
        now.up_n += self.strength * now.person.inertia_kg * np.arange(1, 7) / 6.0 * now.signal[:, :1]


@dataclass(frozen=True)
class TwistingFrame(Effect):
    """A lever arm on a seat frame that twists at a resonance of its own, with its centripetal part: pitch."""

    frequency_hz: float = between(9.0, 18.0)
    damping_ratio: float = between(0.3, 0.6)
    up_m: float = between(0.0, 0.3)

    kind, family, unit, strengths, sites = "pitch", "sideways", "lever / m", (0.02, 0.10), (-1,)

    def base_mps2(self, event: Event) -> Floats:
        """Lever times q' - (up / 0.3 m) q^2, q the rate of the pitch behind the resonance."""
        angle = signal.lfilter(*following(self.frequency_hz, self.damping_ratio, RATE_HZ), event.angle_rad[:, 1])
        rate = np.gradient(angle, 1.0 / RATE_HZ)
        return self.strength * (np.gradient(rate, 1.0 / RATE_HZ) - self.up_m / 0.3 * rate**2)


@dataclass(frozen=True)
class TwoHingedNeck(Effect):
    """A column with two hinges that both shorten it; the lower one, bent at rest, follows the upper late: bending."""

    late_s: float = between(0.03, 0.12)
    bent_rad: float = between(0.05, 0.20)

    kind, family, unit, strengths, sites = "bending", "bending", "length of either part / m", (0.05, 0.15), (NECK, HEAD)

    def signals(self, event: Event, person: Person) -> Floats:
        """Shortening per length and its rate, (n, 2)."""
        turned = event.leaning_rad(self.site + 1)[:, 1] - event.leaning_rad(self.site)[:, 1]
        pole = 1.0 / self.late_s
        low = signal.lfilter(*signal.bilinear([pole], [1.0, pole], RATE_HZ), turned)
        lost = np.cos(self.bent_rad) - np.cos(self.bent_rad + low) + 1.0 - np.cos(turned - low)
        return np.column_stack([lost, np.gradient(lost, 1.0 / RATE_HZ)])

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats]:
        """Lost height e (cos b - cos(b + p) + 1 - cos(phi - p)), p = phi / (1 + late_s s)."""
        return self.site, self.strength * now.signal[:, 0], self.strength * now.signal[:, 1]


@dataclass(frozen=True)
class MisfiringEngine(Effect):
    """An engine of four cylinders, one of which burns weakly: a train of pulses, at standstill too: periodic."""

    firing_hz: float = between(12.0, 30.0)
    sharpness: float = between(1.5, 4.0)
    weak: float = between(0.2, 0.8)

    kind, family, unit, strengths, sites = "periodic", "periodic", "m/s^2", (0.3, 1.5), JOINTS

    def signals(self, event: Event, person: Person) -> Floats:
        """Pulses exp(k (cos phi - 1)) less their mean, (n, 1), every fourth one lower; the first order is about 1."""
        phi = 2.0 * np.pi * self.firing_hz * (event.begin_s + event.time_s)
        size = np.where(np.rint(phi / (2.0 * np.pi)) % 4 == 0, 1.0 - self.weak, 1.0)
        k, mean = self.sharpness, (1.0 - 0.25 * self.weak) * special.i0e(self.sharpness)
        return ((size * np.exp(k * (np.cos(phi) - 1.0)) - mean) / (2.0 * special.i1e(k)))[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """F = e m times the signal."""
        now.push(self.site, self.strength * now.person.inertia_kg[self.site] * now.signal[:, 0])


# --- sensors ---------------------------------------------------------------------------------------------------------


def link(w: float, damping_ratio: float) -> Floats:
    """Damper and spring per kg of a mass."""
    return np.array([2.0 * damping_ratio * w, w * w])


@dataclass(frozen=True)
class ZenerSkin(Effect):
    """A sensor on skin that is soft when moved slowly and firm when moved fast (standard linear solid): skin."""

    damping_ratio: float = between(0.05, 0.15)
    firm: float = between(0.5, 2.0)
    tau_s: float = between(0.002, 0.010)

    kind, family, unit, strengths, sites = "skin", "sensor", "softness / s", (0.003, 0.008), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """K / (s^2 + K), K = w^2 (1 + firm tau s / (1 + tau s)) + 2 z w s, w = 1 / e."""
        if sensor != self.site or not self.strength:
            return accel_mps2
        w, slow = 1.0 / self.strength, np.array([self.tau_s, 1.0])
        top = np.polyadd(np.polymul(link(w, self.damping_ratio), slow), [w * w * self.firm * self.tau_s, 0.0])
        bottom = np.polyadd(top, np.polymul(slow, [1.0, 0.0, 0.0]))
        return signal.lfilter(*signal.bilinear(top, bottom, HELD_HZ), accel_mps2, axis=0)


@dataclass(frozen=True)
class LeansWithThrust(Effect):
    """A strap that is crooked in motion, and more so while the vehicle speeds up: tilt."""

    turn_rad: float = between(-1.2, 1.2)
    swing: float = between(0.3, 0.8)

    kind, family, unit, strengths, sites = "tilt", "sideways", "rad", (0.05, 0.20), WORN

    def lean_rad(self, sensor: int, event: Event) -> Floats | None:
        """Angle e (1 + swing tanh(a / 1.5 m/s^2)) / (1 + swing), a the slow forward acceleration."""
        if sensor != self.site:
            return None
        slow = signal.lfilter(*following(0.8, 0.7, RATE_HZ), event.aside_mps2(sensor)[:, 0])
        lean = event.moving * (1.0 + self.swing * np.tanh(slow / 1.5)) / (1.0 + self.swing)
        return self.strength * np.outer(lean, [np.sin(self.turn_rad), np.cos(self.turn_rad)])


@dataclass(frozen=True)
class SawtoothBuffer(Effect):
    """Stamps at the end of a buffer that fills against another clock, and is emptied at once: clock."""

    period_s: float = between(0.7, 2.0)
    steady: float = between(0.4, 0.75)

    kind, family, unit, strengths, sites = "clock", "sensor", "s", (0.002, 0.010), WORN

    def clock_late_s(self, sensor: int, event: Event, time_s: Floats) -> Floats | float:
        """Delay e (steady + (1 - steady) u); u rises from 0 to 1 in 95 % of the period and falls in the rest."""
        if sensor != self.site:
            return 0.0
        turn = np.mod((event.begin_s + time_s) / self.period_s, 1.0)
        tooth = np.minimum(turn / 0.95, (1.0 - turn) / 0.05)
        return self.strength * (self.steady + (1.0 - self.steady) * tooth)


@dataclass(frozen=True)
class BesideTheCentre(Effect):
    """A sensor beside the centre of its segment, with more of the motion relative to the seat: gain."""

    kind, family, unit, strengths, sites = "gain", "sensor", "share of the relative acceleration", (0.04, 0.15), WORN

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Vertical a + e (a - a_s)."""
        if sensor != self.site:
            return accel_mps2
        found = accel_mps2.copy()
        found[:, 2] += self.strength * (accel_mps2[:, 2] - event.accel_mps2[::2, 2])
        return found


@dataclass(frozen=True)
class OverloadRecovery(Effect):
    """A sensor that clips and stays shifted for some time after that (zero shift, Chu 1987): saturation."""

    recovery_s: float = between(0.02, 0.08)
    share: float = between(0.1, 0.4)

    kind, family, unit, strengths, sites = "saturation", "saturation", "1 / range in 20 m/s^2", (0.5, 2.0), WORN

    def reading(self, sensor: int, force_mps2: Floats) -> Floats:
        """Clipped at R = g + 20 m/s^2 / e, after a shift by -share of the clipped part behind a pole of recovery_s."""
        return force_mps2 if not self.strength else self._clipped(force_mps2)

    def _clipped(self, force_mps2: Floats) -> Floats:
        full, pole = GRAVITY_MPS2 + 20.0 / self.strength, 1.0 / self.recovery_s
        clipped = np.clip(force_mps2, -full, full)
        shift = signal.lfilter(*signal.bilinear([pole], [1.0, pole], sensors.RATE_HZ), force_mps2 - clipped, axis=0)
        return np.clip(clipped - self.share * shift, -full, full)


# --- outside the classes ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LevelTunedMuscle(Effect):
    """Muscles with a preload that grows with the vibration of the seat in the last second (Robertson 1979): outside."""

    tau_s: float = between(0.5, 2.0)
    half_mps2: float = between(0.3, 1.2)

    kind, family, unit, strengths, sites = "outside", "outside", "stiffness at high levels / k", (0.3, 1.2), JOINTS[:4]

    def signals(self, event: Event, person: Person) -> Floats:
        """Level r / (r + half_mps2), r the rms of the seat's vertical acceleration over tau_s, (n, 1)."""
        pole = 1.0 / self.tau_s
        square = signal.lfilter(*signal.bilinear([pole], [1.0, pole], RATE_HZ), event.accel_mps2[:, 2] ** 2)
        rms = np.sqrt(np.maximum(square, 0.0))
        return (rms / (rms + self.half_mps2))[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k s times the signal."""
        k = now.person.stiffness_n_per_m[self.site]
        now.pull(self.site, self.strength * k * now.stretch[:, self.site] * now.signal[:, 0])


@dataclass(frozen=True)
class SlewLimitedDamper(Effect):
    """Muscles that brake the motion of a segment relative to the seat; their force changes only so fast: outside."""

    lag_s: float = between(0.01, 0.03)
    slew: float = between(0.5, 1.5)

    kind, family, unit, strengths, sites = "outside", "outside", "damper / b", (0.4, 2.0), TORSO
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """Tension f of the joint, f' = R tanh((e b x' - f) / (R lag)), R = slew e b (rms rate) / 50 ms."""
        damper = self.strength * now.person.damping_ns_per_m[self.site]
        most = max(self.slew * damper * now.person.rate_mps[self.site] / 0.05, 1e-12)
        now.pull(self.site, own[:, 0])
        return (most * np.tanh((damper * now.v[:, self.site] - own[:, 0]) / (most * self.lag_s)))[:, None]


@dataclass(frozen=True)
class TetheredHead(Effect):
    """A loose strap between the head and the seat that hardens and loses energy: outside."""

    slack: float = between(0.1, 0.5)
    toe: float = between(0.5, 1.5)
    loss: float = between(0.2, 0.6)

    kind, family, unit, strengths, sites = "outside", "outside", "stiffness / N/m", (1e3, 6e3), (HEAD,)

    def act(self, now: Moment, own: Floats) -> None:
        """F = -e (u + u^2 / (toe r)) (1 + loss tanh(x' / rms rate)), u = max(0, x - slack r), r how far it rises."""
        rise = now.person.rise_m[HEAD]
        over = np.maximum(now.x[:, HEAD] - self.slack * rise, 0.0)
        force = over + over * np.minimum(over / (self.toe * rise), 4.0)
        lossy = 1.0 + self.loss * np.tanh(now.v[:, HEAD] / now.person.rate_mps[HEAD])
        now.push(HEAD, -self.strength * force * lossy)


@dataclass(frozen=True)
class AbsorberUnderThePan(Effect):
    """A tuned absorber that bends the frame between the sensor of the seat and the body (Frahm 1909): outside."""

    absorber_hz: float = between(8.0, 15.0)
    pan_hz: float = between(20.0, 32.0)
    damping_ratio: float = between(0.06, 0.15)

    kind, family, unit, strengths, sites = "outside", "outside", "mass of the absorber / of the pan", (0.2, 0.8), (-1,)

    def base_mps2(self, event: Event) -> Floats:
        """-e s^2 A / (s^2 + 2 z p s + p^2) a_s, A of the absorber, (n,)."""
        tuned = link(2.0 * np.pi * self.absorber_hz, self.damping_ratio)
        pan = link(2.0 * np.pi * self.pan_hz, self.damping_ratio)
        top, bottom = np.polymul([-1.0, 0.0, 0.0], tuned), np.polymul([1.0, *pan], [1.0, *tuned])
        return self.strength * signal.lfilter(*signal.bilinear(top, bottom, RATE_HZ), event.accel_mps2[:, 2])


@dataclass(frozen=True)
class FeedForwardNeck(Effect):
    """A neck that acts on the motion of the pelvis, which does not feel it: coupling without reciprocity: outside."""

    kind, family, unit, strengths, sites = "outside", "outside", "force / k d far out", (0.15, 0.70), (NECK, HEAD)

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k d tanh(s_0 / d_0), of the joint of the pelvis."""
        person = now.person
        drive = np.tanh(now.stretch[:, PELVIS] / person.reach_m[PELVIS])
        now.pull(self.site, self.strength * person.stiffness_n_per_m[self.site] * person.reach_m[self.site] * drive)


@dataclass(frozen=True)
class CommunicatingJoints(Effect):
    """Two joints, a third between them, on one volume of fluid that leaks (abdominal pressure): outside."""

    leak_s: float = between(0.1, 0.6)

    kind, family, unit, strengths, sites = "outside", "outside", "stiffness / both joints in series", (0.5, 2.0), (1, 2)
    states = 1

    def act(self, now: Moment, own: Floats) -> Floats:
        """F_i = F_(i+2) = e k u, u = s_i + s_(i+2) - q, q' = u / leak_s, k of both joints in series."""
        one, other = now.person.stiffness_n_per_m[[self.site, self.site + 2]]
        volume = now.stretch[:, self.site] + now.stretch[:, self.site + 2] - own[:, 0]
        pressure = self.strength * one * other / (one + other) * volume
        for joint in (self.site, self.site + 2):
            now.pull(joint, pressure)
        return (volume / self.leak_s)[:, None]


@dataclass(frozen=True)
class ArmsOnTheWheel(Effect):
    """Arms between the shoulders and a steering wheel that moves with the seat: outside."""

    shoulder_hz: float = between(4.0, 8.0)
    wheel_hz: float = between(3.0, 6.0)
    damping_ratio: float = between(0.15, 0.4)

    kind, family, unit, strengths, sites = "outside", "outside", "kg", (3.0, 9.0), (UPPER_TORSO,)
    states = 2

    def act(self, now: Moment, own: Floats) -> Floats:
        """Newton: m (y'' + a_s) = P - k_w y - c_w y', P = k_s (x - y) + c_s (x' - y'), reaction on the torso."""
        y, v = own.T
        shoulder, wheel = (link(2.0 * np.pi * hz, self.damping_ratio) for hz in (self.shoulder_hz, self.wheel_hz))
        pull = shoulder[0] * (now.v[:, self.site] - v) + shoulder[1] * (now.x[:, self.site] - y)
        now.push(self.site, -self.strength * pull)
        return np.column_stack([v, pull - wheel[0] * v - wheel[1] * y - now.base_mps2])


@dataclass(frozen=True)
class BracesInCurves(Effect):
    """A trunk that stiffens while it is pushed aside, by muscles on both sides: outside."""

    half_mps2: float = between(0.3, 1.0)
    follow_hz: float = between(0.8, 2.0)

    kind, family, unit, strengths, sites = "outside", "outside", "stiffness in curves / k", (0.3, 1.2), (*TORSO, NECK)

    def signals(self, event: Event, person: Person) -> Floats:
        """tanh(|a_y| / half_mps2), a_y the slow leftward acceleration, (n, 1)."""
        slow = signal.lfilter(*following(self.follow_hz, 0.7, RATE_HZ), event.accel_mps2[:, 1])
        return np.tanh(np.abs(slow) / self.half_mps2)[:, None]

    def act(self, now: Moment, own: Floats) -> None:
        """F = e k s times the signal."""
        k = now.person.stiffness_n_per_m[self.site]
        now.pull(self.site, self.strength * k * now.stretch[:, self.site] * now.signal[:, 0])


FORMS: Final[tuple[type[Effect], ...]] = (
    NeoHookeanPad, GuyWires, CartilageFilm, TurbulenceBuildsUp, JenkinRow, ColemanHodgdon, StretchedExponential,
    EyringDashpot, WorkBreaksBonds, SlumpsSlowly, StartleLetsGo, TwoLoops, PeelsOffTheSeat, FoamWithAir, OrganOnOrgan,
    ReclinedBackOpens, WebbingWithBuckle, HoppingLoad, RocksAtTheHip, TwistingFrame, TwoHingedNeck, MisfiringEngine,
    ZenerSkin, LeansWithThrust, SawtoothBuffer, BesideTheCentre, OverloadRecovery, LevelTunedMuscle,
    SlewLimitedDamper, TetheredHead, AbsorberUnderThePan, FeedForwardNeck, CommunicatingJoints, ArmsOnTheWheel,
    BracesInCurves,
)  # fmt: skip
