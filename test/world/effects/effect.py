"""Effects: hooks into the body, its seat and its sensors; the default of each hook changes nothing."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from world import body
from world.effects.event import Event

if TYPE_CHECKING:
    from typing_extensions import Self

Floats = NDArray[np.float64]

JOINTS = tuple(range(6))
"""Joints and segments from below: pelvis, lower, central and upper torso, neck, head; joint 0 is below the pelvis."""

PELVIS, LOWER_TORSO, CENTRAL_TORSO, UPPER_TORSO, NECK, HEAD = JOINTS
WORN = (1, 2, 4, 5, 6)
"""Sensors on the body by their place in `ride.SENSORS`; 3, the central torso, has none."""


@dataclass(frozen=True, eq=False)
class Person:
    """One body, (6,) each: its joints and masses, and the travel and rate of the plain body in its events.

    reach_m is the deepest compression of a joint, rise_m how far a segment rose above its rest, rate_mps the rms rate
    of a joint, all of them the median over the events in which it was most.
    """

    stiffness_n_per_m: Floats
    damping_ns_per_m: Floats
    stiffening_per_m: Floats
    inertia_kg: Floats
    carried_kg: Floats
    alpha_r: float
    reach_m: Floats = field(default_factory=lambda: np.full(6, 5e-3))
    rise_m: Floats = field(default_factory=lambda: np.full(6, 5e-3))
    rate_mps: Floats = field(default_factory=lambda: np.full(6, 0.05))

    @classmethod
    def of(cls, people: body.People, index: int) -> Person:
        """One of some people, by Eq. 5-17 of the paper."""
        carried, theta = people.carried_mass_kg[index], people.theta[index]
        stiffness = (2.0 * np.pi * theta[:6]) ** 2 * carried
        damping = 2.0 * theta[6:12] * np.sqrt(stiffness * carried)
        return cls(
            stiffness, damping, theta[13] * body.STIFFENING_PER_M, people.inertia_kg[index], carried, float(theta[12])
        )

    @property
    def weight_n(self) -> float:
        """Mass on the seat."""
        return float(self.carried_kg[0]) * 9.80665


class Moment:
    """State of the body in the events of an effect, (r, 6) each; the effect adds its forces here.

    x, v: segments above the seat and their rates. stretch, rate: of the joints. joint_n: tension of the plain joints.
    base_mps2 (r,): the acceleration below. signal (r, c): the effect's own signals. late (r, s): its states, delayed.
    time_s (r,): since the first event of the sitting began; share, the same of the whole sitting. moving_s: since the
    motion set in, negative before.
    """

    __slots__ = (
        "base_mps2", "joint_n", "late", "moving_s", "person", "rate", "share", "signal", "stretch", "time_s", "up_n",
        "v", "x",
    )  # fmt: skip

    person: Person
    x: Floats
    v: Floats
    stretch: Floats
    rate: Floats
    joint_n: Floats
    up_n: Floats
    base_mps2: Floats
    signal: Floats
    late: Floats
    time_s: Floats
    share: Floats
    moving_s: float

    def pull(self, joint: int, tension_n: Floats) -> None:
        """Let a joint pull its two segments together."""
        self.up_n[:, joint] -= tension_n
        if joint:
            self.up_n[:, joint - 1] += tension_n

    def push(self, segment: int, force_n: Floats) -> None:
        """Push a segment up from outside."""
        self.up_n[:, segment] += force_n


def between(low: float, high: float) -> Any:
    """A shape parameter that is drawn evenly from a range; its middle unless drawn."""
    return field(default=0.5 * (low + high), metadata={"range": (low, high)})


class SensorHooks:
    """Changes of the sensors; the default of each hook changes nothing."""

    def lean_rad(self, sensor: int, event: Event) -> Floats | None:
        """Roll and pitch of a sensor relative to its segment, (n, 2) on the grid of the event."""
        return None

    def sensor_acceleration(self, sensor: int, event: Event, accel_mps2: Floats) -> Floats:
        """Acceleration of the sensor for accelerations (m, 3) of its segment at `HELD_HZ`."""
        return accel_mps2

    def clock_late_s(self, sensor: int, event: Event, time_s: Floats) -> Floats | float:
        """Delay of the sensor's clock at its own time_s (m,) within the event."""
        return 0.0

    def reading(self, sensor: int, force_mps2: Floats) -> Floats:
        """Reading of the sensor for a specific force (m, 3) in its own axes."""
        return force_mps2


@dataclass(frozen=True)
class Effect(SensorHooks):
    """One thing a record can hide. Of `strength` 0 it hides nothing; shapes are fields made by `between`.

    kind and family are those of the catalogue ("outside": of none). site is a joint or segment from below, a place in
    `ride.SENSORS`, or -1 where the whole body is meant. strengths is the range of its strength in `unit`; a strength
    that means nothing but "there" is 1 and not `scalable`.
    """

    site: int
    strength: float

    kind: ClassVar[str]
    family: ClassVar[str]
    unit: ClassVar[str]
    sites: ClassVar[tuple[int, ...]] = JOINTS
    strengths: ClassVar[tuple[float, float]]
    scalable: ClassVar[bool] = True
    states: ClassVar[int] = 0

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Self:
        """Site and shapes evenly, strength evenly in its logarithm."""
        low, high = np.log(cls.strengths)
        shapes = {f.name: rng.uniform(*f.metadata["range"]) for f in dataclasses.fields(cls) if "range" in f.metadata}
        return cls(int(rng.choice(cls.sites)), float(np.exp(rng.uniform(low, high))), **shapes)

    def scaled(self, factor: float) -> Self:
        """The same effect, stronger or weaker where it can be."""
        return dataclasses.replace(self, strength=self.strength * factor) if self.scalable else self

    def truth(self) -> dict[str, str | int | float]:
        """The truth for a scorer, as plain data."""
        return {
            "class": self.kind, "family": self.family, "form": type(self).__name__, "site": self.site,
            "strength": self.strength, "unit": self.unit,
        }  # fmt: skip

    @property
    def delay_s(self) -> float:
        """How late `Moment.late` is; 0 for effects that look at now."""
        return 0.0

    def signals(self, event: Event, person: Person) -> Floats:
        """Signals from outside on the grid of the event, (n, c)."""
        return np.empty((len(event.accel_mps2), 0))

    def base_mps2(self, event: Event) -> Floats | float:
        """Acceleration of the body's base minus that of the seat's sensor, (n,)."""
        return 0.0

    def offset(self, now: Moment, own: Floats) -> tuple[int, Floats, Floats] | None:
        """A joint, its stretch beyond the distance of its segments, and the rate of that stretch, (r,)."""
        return None

    def act(self, now: Moment, own: Floats) -> Floats | None:
        """Add forces to `now`; return the rates (r, s) of the effect's states (r, s), which begin at 0."""
        return None


def smooth_sign(rate: Floats, width: float) -> Floats:
    """The sign, without a jump."""
    return rate / np.sqrt(rate * rate + width * width)


def soften(now: Moment, joint: int, lost: Floats | float, damped: float) -> None:
    """Take a share (r,) of a joint's stiffness away, and `damped` times as much of its damping."""
    k, b = now.person.stiffness_n_per_m[joint], now.person.damping_ns_per_m[joint]
    now.pull(joint, -lost * (k * now.stretch[:, joint] + damped * b * now.rate[:, joint]))
