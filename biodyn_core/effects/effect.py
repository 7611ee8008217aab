"""Effects that the base chain lacks: the common part, one class per kind, and an effect applied at a site.

An effect inside the chain has its law as a plain function of scalars. The integrator is generated from the source of
that law, so a new effect changes no integrator code, and an absent effect costs no time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.base.suggestions import did_you_mean, known_are

Place = Literal["joint", "segment", "sensor", "seat"]
Kind = Literal["strength", "shape", "nuisance"]
Experiment = Literal["standstill", "tap", "quiet_loud_quiet", "turns", "bare", "shocks", "levels"]
Variation = Literal["delay", "line", "step"]
"""How a cause varies with time.

delay: a sensor has another delay in every window. line: a spectral line has another amplitude and phase in every part
of a window. step: a joint has another stiffness and damping from an instant between two events on.
"""

Values = Mapping[str, float]
"""The values of an effect's parameters by name."""

Channels = Mapping[str, Floats]
"""Measured signals (n,) by name, such as `seat.x` or `head.rate_y`."""

Transform = Callable[[Floats, float, Channels, Values], Floats]
"""From an acceleration (n,) m/s^2, the rate in Hz, channels and values to the changed acceleration (n,)."""

UNSOURCED: Final = "typical of the tracing study; no source for people"

DECADE: Final = 10.0
"""A range with both ends above zero and at least this ratio between them is logarithmic."""

AT_BOUND: Final = 0.01
"""A value closer to an end than this share of the range is on a bound: fits converge slowly there."""


@dataclass(frozen=True)
class EffectParameter:
    """One parameter with its unit, its range, the start of a fit and the source of the range.

    kind: `strength` is 0 in the base chain; a `nuisance` is fitted but not reported as a finding. acts_at is a typical
    value of a parameter that starts at zero. grid holds further values to try, because a wrong shape hides the effect.
    least: a strength up to this counts as zero; smaller ones have no visible effect but need very short steps.

    reach_shares: starts of a length as shares of the reach of its joint or segment, instead of a grid: a law beyond the
    reach never acts. neutral: the value at which the law is the textbook form; a subject file may omit it. spread:
    standard deviation of the prior of a fit around it.
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
    reach_shares: tuple[float, ...] = ()
    neutral: float | None = None
    spread: float = 0.0

    @property
    def size(self) -> float:
        """A typical value: the start, or `acts_at` where the start is zero."""
        return self.start or self.acts_at

    def share(self, value: float) -> float:
        """The position of a value in the range, 0 to 1."""
        if self._logarithmic:
            return math.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def at_share(self, share: float) -> float:
        """The value at a share of the range; a share outside 0 to 1 gives the nearer end."""
        if share <= 0.0 or share >= 1.0:  # the logarithm would not return the exact end
            return self.lower if share <= 0.0 else self.upper
        if self._logarithmic:
            value = self.lower * (self.upper / self.lower) ** share
        else:
            value = self.lower + share * (self.upper - self.lower)
        return min(max(value, self.lower), self.upper)

    def on_bound(self, value: float) -> bool:
        """Whether a value lies on an end of its range; never for a nuisance, nor for a small value above a zero end."""
        if self.kind == "nuisance":
            return False
        share = self.share(value)
        return share > 1.0 - AT_BOUND or (share < AT_BOUND and self.lower != 0.0)

    @property
    def _logarithmic(self) -> bool:
        return self.lower > 0.0 and self.upper >= DECADE * self.lower

    def check(self, value: float, where: str) -> None:
        """Raise InputError unless the value is finite and within the range."""
        if not (math.isfinite(value) and self.lower <= value <= self.upper):
            raise InputError(f"{where}.{self.name} is {value:g}, allowed are {self.allowed}")

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"{self.lower:g} to {self.upper:g}{self.unit and f' {self.unit}'}"


@dataclass(frozen=True)
class Joint:
    """Constants of the joint below a segment, and the masses of that segment and of all from there up, SI."""

    stiffness_n_per_m: float
    stiffening_n_per_m2: float
    damping_n_s_per_m: float
    mass_above_kg: float
    segment_mass_kg: float


def _no_mass(values: Values) -> float:
    return 0.0


def _no_stiffness_damping(joint: Joint, values: Values) -> tuple[float, float]:
    return 0.0, 0.0


def _no_eigenvalue(joint: Joint, values: Values) -> float:
    return 0.0


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The common part of every effect in the catalogue; the subclasses are the kinds.

    equation and signature are printed: the textbook law, and the pattern of the residual where the effect is missing.
    general_form: the law with all parameters, if it has some with a neutral value. sites are
    those allowed. channels: signals beyond the seat's vertical, such as `seat.x`; `own.` stands for the site. The
    effect can be neither simulated nor tested without them.

    Read by tracing alone. variant_of: the mechanism that it is one law of, its own name if empty. known_omission: the
    base chain is known to lack it, so it is always fitted. constant_part: if it varies from window to window, a subject
    can carry its constant part. sized_by_training: if it varies between events, only the events for fitting set its
    size. varies_as: how it may vary with time; its first parameters are then the delay in s, or cosine and sine in
    m/s^2 and the frequency in Hz of the line, or the change of stiffness as a share. seen_by_gyro: the gyro of its
    sensor measures it, so recordings correct it; its first parameters are then the tilts along x and y as shares of g.
    separated_by: the experiment that separates it from rivals; `biodyn_core.tracing.experiments` has the texts.
    """

    place: ClassVar[Place]

    name: str
    family: str
    equation: str
    signature: str
    parameters: tuple[EffectParameter, ...]
    sites: tuple[str, ...] = SEGMENTS
    channels: tuple[str, ...] = ()
    general_form: str = ""
    variant_of: str = ""
    known_omission: bool = False
    constant_part: bool = False
    sized_by_training: bool = False
    varies_as: Variation | None = None
    seen_by_gyro: bool = False
    separated_by: Experiment = "levels"

    @property
    def mechanism(self) -> str:
        """The mechanism: effects of one mechanism differ in the form of the law, not in its variables."""
        return self.variant_of or self.name

    @property
    def strengths(self) -> tuple[str, ...]:
        """Names of the parameters that are all 0 in the base chain; empty where presence alone is the effect."""
        return tuple(p.name for p in self.parameters if p.kind == "strength")

    @property
    def textbook_parameters(self) -> tuple[EffectParameter, ...]:
        """The parameters of the textbook form, without those that generalise it."""
        return tuple(p for p in self.parameters if p.neutral is None)

    @property
    def static(self) -> bool:
        """Whether it is a static law of a joint: no states, no delay, no channels."""
        return False

    @property
    def supports_live(self) -> bool:
        """Whether predictions sample by sample, from the seat's vertical alone, support a subject that has it."""
        return False

    def required_channels(self, site: str) -> tuple[str, ...]:
        """The channels it needs at a site, by their names in a recording."""
        return tuple(name.replace("own.", f"{site}.") for name in self.channels)

    def sized(self, site: str, *sizes: float) -> AppliedEffect:
        """The textbook form at a site: sizes of the first parameters, moved into their ranges, and 0 for the others."""
        parameters = self.textbook_parameters
        every = (*sizes, *[0.0] * (len(parameters) - len(sizes)))
        values = {p.name: min(max(size, p.lower), p.upper) for p, size in zip(parameters, every, strict=True)}
        return AppliedEffect(self, site, values)


@dataclass(frozen=True)
class StepBounds:
    """Largest stiffness and damping that a law adds, and the largest eigenvalue of its states; they set the step."""

    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    own_eigenvalue_per_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ChainEffect(Effect):
    """An effect inside the chain, integrated with it; each subclass defines the arguments of its law.

    law: a function of scalars that uses `math` and builtins alone; its last arguments are the constants. constants:
    these numbers, from the joint and the values of the parameters. carried_kg: the mass that it adds to the chain.
    """

    law: Callable[..., Any]
    constants: Callable[[Joint, Values], tuple[float, ...]]
    carried_kg: Callable[[Values], float] = _no_mass

    @property
    def states(self) -> int:
        """The number of the law's own states."""
        return 0

    @property
    def longest_delay_s(self) -> float:
        """The upper end of the delay's range, 0 without delay."""
        return 0.0

    @property
    def supports_live(self) -> bool:
        """Whether it needs no other channel."""
        return not self.channels

    def delay_s(self, values: Values) -> float:
        """The delay of the stretch that the law receives, 0 without delay."""
        return 0.0

    def step_bounds(self, joint: Joint, values: Values) -> StepBounds:
        """The most that the law adds to the chain."""
        return StepBounds()


@dataclass(frozen=True, kw_only=True)
class Force(ChainEffect):
    """A force, possibly with states of its own; a mass is a force with two states.

    law(motion, its rate, seat, [delayed stretch], channels, states, constants) returns the force in N, then the rates
    of its states; seat is the seat's acceleration in m/s^2. max_added_stiffness_damping, N/m and N s/m, and
    max_own_eigenvalue_per_s, of its states, are the fields of `StepBounds`.
    """

    states: int = 0
    max_added_stiffness_damping: Callable[[Joint, Values], tuple[float, float]] = _no_stiffness_damping
    max_own_eigenvalue_per_s: Callable[[Joint, Values], float] = _no_eigenvalue

    def step_bounds(self, joint: Joint, values: Values) -> StepBounds:
        """The most that the law adds to the chain."""
        stiffness, damping = self.max_added_stiffness_damping(joint, values)
        return StepBounds(stiffness, damping, self.max_own_eigenvalue_per_s(joint, values))


@dataclass(frozen=True, kw_only=True)
class JointForce(Force):
    """A force added to the tension of a joint, from its stretch m and rate m/s.

    delay: name of the parameter, in s, by which the law also receives the stretch delayed.
    """

    place: ClassVar[Place] = "joint"
    delay: str = ""

    @property
    def static(self) -> bool:
        """Whether it is a static law: no states, no delay, no channels."""
        return not (self.states or self.delay or self.channels)

    @property
    def longest_delay_s(self) -> float:
        """The upper end of the delay's range, 0 without delay."""
        return next((p.upper for p in self.parameters if p.name == self.delay), 0.0)

    def delay_s(self, values: Values) -> float:
        """The delay of the stretch that the law receives, 0 without delay."""
        return values[self.delay] if self.delay else 0.0


@dataclass(frozen=True, kw_only=True)
class JointLimit(ChainEffect):
    """A limit of the whole tension of a joint: law(tension N, rate m/s, constants) returns the limited one."""

    place: ClassVar[Place] = "joint"


@dataclass(frozen=True, kw_only=True)
class SegmentForce(Force):
    """A force on a segment, from its displacement m and velocity m/s relative to the seat."""

    place: ClassVar[Place] = "segment"


@dataclass(frozen=True, kw_only=True)
class SeatTransform(Effect):
    """A change of the seat's vertical acceleration before it acts on the body, over a whole recording."""

    place: ClassVar[Place] = "seat"
    sites: tuple[str, ...] = (SEAT,)
    transform: Transform


@dataclass(frozen=True, kw_only=True)
class SensorTransform(Effect):
    """A change of one segment's acceleration by its sensor, over a whole recording."""

    place: ClassVar[Place] = "sensor"
    sites: tuple[str, ...] = MEASURED_SEGMENTS
    transform: Transform

    @property
    def supports_live(self) -> bool:
        """Always: predictions are of the segments themselves."""
        return True


@dataclass(frozen=True)
class AppliedEffect:
    """An effect at one site with its values; raises InputError for a site or value that it does not have.

    Omitted parameters have their neutral value.
    """

    effect: Effect
    site: str
    values: Values

    def __post_init__(self) -> None:
        where, sites = f"effects: {self.effect.name}", self.effect.sites
        if self.site not in sites:
            near = did_you_mean(self.site, sites)
            raise InputError(f"{where}: site is {self.site!r}, allowed are {', '.join(sites)}{near}")
        known = {parameter.name: parameter for parameter in self.effect.parameters}
        for name in self.values:
            if name not in known:
                raise InputError(f"{where}: unknown parameter {name!r}, {known_are(name, known)}")
        neutral = {name: p.neutral for name, p in known.items() if p.neutral is not None}
        object.__setattr__(self, "values", {**neutral, **self.values})
        missing = [f"{name} ({parameter.allowed})" for name, parameter in known.items() if name not in self.values]
        if missing:
            raise InputError(f"{where}: missing under parameters: {', '.join(missing)}")
        for name, parameter in known.items():
            parameter.check(self.values[name], where)

    @property
    def absent(self) -> bool:
        """Whether all its strengths are zero, so that the base chain remains."""
        strengths = [parameter for parameter in self.effect.parameters if parameter.kind == "strength"]
        return bool(strengths) and all(abs(self.values[p.name]) <= p.least for p in strengths)

    @property
    def stated_values(self) -> dict[str, float]:
        """The values without those that are neutral."""
        return {p.name: self.values[p.name] for p in self.effect.parameters if self.values[p.name] != p.neutral}

    @property
    def is_textbook(self) -> bool:
        """Whether its law has the textbook form."""
        return all(self.values[p.name] == p.neutral for p in self.effect.parameters if p.neutral is not None)

    @property
    def textbook(self) -> AppliedEffect:
        """The same effect with the textbook form of its law."""
        kept = {p.name: self.values[p.name] for p in self.effect.textbook_parameters}
        return AppliedEffect(self.effect, self.site, kept)

    def to_dict(self) -> dict[str, Any]:
        """The mapping of a subject file."""
        return {"name": self.effect.name, "site": self.site, "parameters": self.stated_values}
