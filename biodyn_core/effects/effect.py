"""Effect: something the base chain lacks, as one small object that says its equation and where it may sit.

What acts inside the chain is a plain function of scalars, from whose source the integrator is generated: no effect
touches the integrator, and none that is absent costs anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS, SENSORS
from biodyn_core.base.suggestions import did_you_mean

Place = Literal["joint", "segment", "sensor", "seat"]
Kind = Literal["strength", "shape", "nuisance"]

UNSOURCED: Final = "typical of the tracing study; no source for people"


DECADE: Final = 10.0
"""A range whose ends are so many times apart, both above zero, is one of scales: shares of it are of its logarithm."""

AT_BOUND: Final = 0.01
"""A value closer to an end than this share of its range is on it: a fit gets there ever more slowly."""


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: unit, range, where a fit starts, whether 0 of it is the base chain, and the range's source.

    acts_at is a value at which it shows, for one that starts at zero; grid are further values to try it at, since far
    from its own a shape shows nothing. least: a strength up to this is none, for what is weaker shows nothing and would
    ask for ever shorter steps.
    """

    name: str
    unit: str
    lower: float
    upper: float
    start: float
    kind: Kind = "shape"
    source: str = UNSOURCED
    acts_at: float = 0.0
    grid: tuple[float, ...] = ()
    least: float = 0.0

    @property
    def size(self) -> float:
        """A value at which it shows: the start, unless that is zero."""
        return self.start or self.acts_at

    def share(self, value: float) -> float:
        """Where a value lies in the range, 0 to 1."""
        if self._of_scales:
            return math.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def at_share(self, share: float) -> float:
        """The value at a share of the range, at an end where that lies beyond."""
        if share <= 0.0 or share >= 1.0:  # exactly, which no logarithm would be
            return self.lower if share <= 0.0 else self.upper
        if self._of_scales:
            value = self.lower * (self.upper / self.lower) ** share
        else:
            value = self.lower + share * (self.upper - self.lower)
        return min(max(value, self.lower), self.upper)

    def on_bound(self, value: float) -> bool:
        """Whether a value lies next to an end of its range: what is next to nothing is only small, nuisances may."""
        if self.kind == "nuisance":
            return False
        share = self.share(value)
        return share > 1.0 - AT_BOUND or (share < AT_BOUND and self.lower != 0.0)

    @property
    def _of_scales(self) -> bool:
        return self.lower > 0.0 and self.upper >= DECADE * self.lower

    def check(self, value: float, where: str) -> None:
        """Raise InputError unless the value is finite and within the range."""
        if not (math.isfinite(value) and self.lower <= value <= self.upper):
            raise InputError(f"{where}.{self.name} is {value:g}, allowed are {self.allowed}")

    @property
    def allowed(self) -> str:
        """Its range in words."""
        return f"{self.lower:g} to {self.upper:g}{self.unit and f' {self.unit}'}"


@dataclass(frozen=True)
class Joint:
    """What an effect on a joint is told besides its parameters, SI: its constants, and the mass that rests on it."""

    stiffness_n_per_m: float
    stiffening_n_per_m2: float
    damping_n_s_per_m: float
    mass_above_kg: float
    segment_mass_kg: float


def _none(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return ()


def _nothing(joint: Joint, values: Mapping[str, float]) -> tuple[float, float]:
    return 0.0, 0.0


def _no_rate(joint: Joint, values: Mapping[str, float]) -> float:
    return 0.0


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue.

    place: `joint` is the joint below the segment a site names, `segment` the segment itself.

    An effect has one of these. force: what is added to the joint's tension, or to the force on the segment, N. It
    takes stretch and rate of the joint, or displacement and velocity of the segment relative to the seat (m, m/s),
    then the seat's acceleration (m/s^2), the joint's stretch one `delay` ago where it has one, its channels, its
    own states, and its constants, all scalars; it returns the force, and after it the rates of its states. limit:
    the joint's force once all has been added, from that force and the constants. Both use `math` and builtins
    alone; a mass is a force with states. seat: what the body feels of the seat, (n,), from its vertical (n,), the
    rate in Hz, the channels (n,) by name and the values. measured: what a sensor shows of its segment's true
    acceleration, from the same. These two are over a whole recording, so neither runs live.

    constants: numbers for force or limit from the joint and the values of the parameters, in their order. stiffens: the
    largest stiffness and damping that force may add, N/m and N s/m, and own_rate_per_s: the largest eigenvalue of its
    own states; the integrator's step is chosen by both. delay: the parameter, in s, that says how far it looks back.
    channels: what has to be measured beside the seat's vertical, such as `seat.x`, `own.` for the site's; without it
    the effect can be neither run nor tested.

    Read by tracing alone. known_omission: the base chain is known to lack it, so it is always fitted, accepted if one
    event improves, and chosen before any other law. constant_part: if it varies from window to window, a subject can
    carry its constant part. sized_by_training: if it varies between events, only the events for fitting set its size.
    """

    name: str
    family: str
    equation: str
    signature: str
    place: Place
    parameters: tuple[EffectParameter, ...]
    sites: tuple[str, ...] = ()
    constants: Callable[[Joint, Mapping[str, float]], tuple[float, ...]] = _none
    force: Callable[..., Any] | None = None
    states: int = 0
    limit: Callable[..., float] | None = None
    stiffens: Callable[[Joint, Mapping[str, float]], tuple[float, float]] = _nothing
    own_rate_per_s: Callable[[Joint, Mapping[str, float]], float] = _no_rate
    seat: Callable[[Floats, float, Mapping[str, Floats], Mapping[str, float]], Floats] | None = None
    measured: Callable[[Floats, float, Mapping[str, Floats], Mapping[str, float]], Floats] | None = None
    delay: str | None = None
    channels: tuple[str, ...] = ()
    known_omission: bool = False
    constant_part: bool = False
    sized_by_training: bool = False

    @property
    def strengths(self) -> tuple[str, ...]:
        """The parameters all of which are 0 in the base chain; none where presence alone is the effect."""
        return tuple(p.name for p in self.parameters if p.kind == "strength")

    @property
    def in_chain(self) -> bool:
        """Whether it acts inside the chain, in time, and so live too; else it is over a whole recording."""
        return self.seat is None and self.measured is None

    @property
    def static(self) -> bool:
        """Whether it is a law of a joint that knows no time: neither states nor delays nor channels."""
        return self.place == "joint" and self.force is not None and not (self.states or self.delay or self.channels)

    def needed(self, site: str) -> tuple[str, ...]:
        """The channels it needs at a site, by the names they have in a recording."""
        return tuple(name.replace("own.", f"{site}.") for name in self.channels)

    @property
    def where(self) -> tuple[str, ...]:
        """The sites it may have."""
        if self.sites:
            return self.sites
        return SENSORS if self.place == "sensor" else SEGMENTS


@dataclass(frozen=True)
class AppliedEffect:
    """An effect at one site with its values; raises InputError for a site or value that it does not have."""

    effect: Effect
    site: str
    values: Mapping[str, float]

    def __post_init__(self) -> None:
        where = f"effects: {self.effect.name}"
        if self.site not in self.effect.where:
            sites = self.effect.where
            near = did_you_mean(self.site, sites)
            raise InputError(f"{where}: site is {self.site!r}, allowed are {', '.join(sites)}{near}")
        known = {parameter.name: parameter for parameter in self.effect.parameters}
        for name in self.values:
            if name not in known:
                listed, near = ", ".join(known) or "none", did_you_mean(name, known)
                raise InputError(f"{where}: unknown parameter {name!r}, known are {listed}{near}")
        missing = [f"{name} ({parameter.allowed})" for name, parameter in known.items() if name not in self.values]
        if missing:
            raise InputError(f"{where}: missing under parameters: {', '.join(missing)}")
        for name, parameter in known.items():
            parameter.check(self.values[name], where)

    @property
    def absent(self) -> bool:
        """Whether it is of no strength, so that the base chain remains."""
        strengths = [parameter for parameter in self.effect.parameters if parameter.kind == "strength"]
        return bool(strengths) and all(abs(self.values[p.name]) <= p.least for p in strengths)

    def to_dict(self) -> dict[str, Any]:
        """The mapping of a subject file."""
        return {"name": self.effect.name, "site": self.site, "parameters": dict(self.values)}
