"""Findings of a trace: plain data for its document, text and page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.problem import Errors

Verdict = Literal["effect", "ambiguous", "none", "unexplained", "not_decidable"]
NAMING: Final[tuple[Verdict, ...]] = ("effect", "ambiguous")
"""The verdicts that name a cause."""

Use = Literal["train", "choose", "held_out"]
"""The use of an event: theta and sizes are fitted to `train`, the effect is chosen by `choose`, and errors are reported
of `held_out`, which influences neither."""


@dataclass(frozen=True, eq=False)
class RankedCandidate:
    """A candidate in the ranking of a round.

    probability: of this effect at this site. gain: mean log ratio of the squared residual without over with the effect
    in the events for choosing, theta and nuisance parameters refitted, plus the gain in evidence of the nuisance
    parameters; refitted: whether it comes from a fit to all events or from the linear step of screening. p_value: how
    often the largest random gain is as large. absorbed: share of the effect's energy that theta explains.
    improved_events: number of events with a positive gain, None if not refitted. remarks: on its fit. steady: False if
    the effect is fitted again in every window or between events; it always gains a little, and its p_value has no
    meaning.
    """

    applied: AppliedEffect
    probability: float
    gain: float
    refitted: bool
    p_value: float
    absorbed: float
    improved_events: int | None
    remarks: tuple[str, ...] = ()
    steady: bool = True

    @property
    def key(self) -> tuple[str, str]:
        """The name of the effect, and its site."""
        return self.applied.effect.name, self.applied.site


@dataclass(frozen=True, eq=False)
class Round:
    """One greedy step: the candidates, the most probable first, the chosen one if any, and its rivals.

    answers: the probability of each mechanism, of `none` and of `outside`, the largest first; likely: those of them in
    the 90 % set. rivals: the best candidate of each other mechanism in that set, and other sites of the chosen one.
    """

    ranking: tuple[RankedCandidate, ...]
    answers: Mapping[str, float]
    likely: tuple[str, ...]
    chosen: RankedCandidate | None
    rivals: tuple[RankedCandidate, ...]

    @property
    def best(self) -> str:
        """The most probable answer."""
        return next(iter(self.answers))


@dataclass(frozen=True, eq=False)
class Interval:
    """A value with its 95 % interval."""

    name: str
    unit: str
    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class ComparedEvent:
    """One event with the answers of the subject before and after, for errors and drawings.

    measured_mps2, before_mps2, after_mps2 (n, 5) by measured segment, NaN where not compared; segments without a sensor
    or left out are all NaN. before, after: their `Errors`; given: those of the given subject, None if it is unfitted.
    """

    name: str
    case: str
    use: Use
    rate_hz: float
    measured_mps2: Floats
    before_mps2: Floats
    after_mps2: Floats
    before: Errors
    after: Errors
    given: Errors | None = None


@dataclass(frozen=True, eq=False)
class NuisanceValue:
    """One nuisance parameter (a gain, a clock, a mass, a joint's nonlinearity) in multiples of its typical spread."""

    name: str
    typical_multiple: float


@dataclass(frozen=True, eq=False)
class SensorFinding:
    """A sensor fault that is reported with every verdict.

    source: the sensor's gyro, or the fit. gain: of the fault as a candidate, None if it was not tried. explains:
    whether it is the chosen cause.
    """

    fault: AppliedEffect
    source: Literal["gyro", "fit"]
    gain: float | None
    explains: bool


@dataclass(frozen=True)
class Need:
    """Recordings that are missing for a verdict, for one use: the amount of each, and conditions on the recordings."""

    use: Literal["to fit", "held out"]
    road_s: float
    shocks: int
    hard_shocks: int
    conditions: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Surface:
    """The missing force of a joint, N, over stretch (m) and its rate (m/s).

    force_n (r, s): rows by rate_mps (r,), columns by stretch_m (s,), NaN outside the data. gain: as a candidate's;
    a gain shows that a law of this joint is missing. Without one the cause may be memory, measurement, input, or a law
    of the rate, for which the surface is too coarse.
    """

    site: str
    stretch_m: Floats
    rate_mps: Floats
    force_n: Floats
    gain: float


@dataclass(frozen=True, eq=False)
class ForceProfile:
    """Mean forces (b,), N, over bins of stretch (m) or of its rate (m/s), NaN in bins with few samples.

    at: centres. before_n: missing force before; measured_n, after_n: that of the subject after without and with the
    law. law_n: the law's own force in simulation, with its 95 % band from lower_n to upper_n. explained: share of the
    variance of the measured force that its mean over the bins has.
    """

    at: Floats
    samples: Integers
    before_n: Floats
    measured_n: Floats
    after_n: Floats
    law_n: Floats
    lower_n: Floats
    upper_n: Floats
    explained: float


@dataclass(frozen=True, eq=False, kw_only=True)
class RestoringForce:
    """The missing force of a joint, or on a segment, N, by inverse dynamics of the measurement.

    It is proportional to the assumed body_mass_kg. effects: those whose law is shown; none if only the force before is
    known. carried_n, missing_before_n, missing_after_n: rms. samples, before_n, after_n (r, s): rows by rate_mps (r,),
    columns by stretch_m (s,), NaN in bins with few samples. Motion below high_pass_hz is the model's.
    """

    site: str
    joint: bool
    effects: tuple[AppliedEffect, ...]
    high_pass_hz: float
    body_mass_kg: float
    events: tuple[str, ...]
    carried_n: float
    missing_before_n: float
    missing_after_n: float
    stretch_m: Floats
    rate_mps: Floats
    samples: Integers
    before_n: Floats
    after_n: Floats
    over_stretch: ForceProfile
    over_rate: ForceProfile

    @property
    def unmeasured(self) -> bool:
        """Whether the central torso, which has no sensor, is the segment or one end of the joint."""
        return self.site == "central_torso" or (self.joint and self.site == "upper_torso")

    @property
    def over_rate_first(self) -> bool:
        """Whether the rate explains the measured force better than the stretch."""
        return self.over_rate.explained > self.over_stretch.explained


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Diagnostics of the residual after the refit, before any candidate is tried.

    amplitude_transfer: per loading condition, the residual in multiples of a good model's, for theta fitted to the
    quietest condition alone and to all. coherent: per channel, the segment with the most coherent residual, and its
    share of power above chance. peeling: per sub-chain, from the head down, named by the sensor that drives it, error
    of the segments above, rms percent. bracket: the joints that this points to. level_slope: d log of the relative
    residual / d log peak. jump: the event, in the order of time, at which the residual changes most, and its p-value.
    at_bound: parameters on a bound. drift: per parameter, ln of largest over smallest value among the conditions.
    seat_tension: largest tension of the seat's joint, over the weight it carries.
    """

    amplitude_transfer: Mapping[str, tuple[float, float]]
    coherent: Mapping[str, tuple[str, float]]
    peeling: Mapping[str, float]
    bracket: tuple[str, ...]
    level_slope: float | None
    jump: tuple[str, float] | None
    at_bound: tuple[str, ...]
    drift: Mapping[str, float]
    seat_tension: float


@dataclass(frozen=True)
class NamedBodies:
    """How many simulated bodies with an effect amid a background have it named.

    ratio: of the effects, within half an octave.
    """

    ratio: float
    bodies: int
    named: int


@dataclass(frozen=True)
class FurtherRecordings:
    """How many simulated bodies with an effect amid a background have the right cause named from some recordings.

    recordings: in words. best: bodies whose most probable answer is right.
    """

    recordings: str
    bodies: int
    named: int
    best: int


@dataclass(frozen=True)
class LouderRecordings:
    """How many simulated effects of a mechanism are named from the same drives with `level` times the motion.

    named, named_louder: without and with louder motion. with_true_law, with_true_law_louder: the same by a decision
    that knows the true laws.
    """

    mechanism: str
    level: float
    effects: int
    named: int
    named_louder: int
    with_true_law: int
    with_true_law_louder: int

    @property
    def lifts(self) -> bool:
        """Whether louder motion lets more effects be named."""
        return self.named_louder > self.named or self.with_true_law_louder > self.with_true_law


@dataclass(frozen=True, eq=False, kw_only=True)
class Trace:
    """A whole trace.

    reasons: of the verdict, a line each. given: the given subject; before: refitted without an effect (the given object
    if nothing could be fitted); after: with the added effects (the object before if there are none). sensors: sensor
    faults beside the verdict. needs: recordings missing for a verdict. intervals: for each of the effects.
    floor_percent: error by sensor noise alone, None if unknown. untestable: effects that lack a channel. left_out:
    events or sensors that are not used, with the reason. experiment: the next recordings. calibrated: whether the
    screening was computed or read from an earlier trace. nuisance: largest multiple first. named_from: probability from
    which one cause is named. named_bodies: causes named in simulation by ratio, for the verdict `none`. further: the
    same from the least data and from more, without a named cause; louder: from louder motion, of possible mechanisms.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    given: Subject
    before: Subject
    after: Subject
    experiment: str
    events: tuple[ComparedEvent, ...]
    floor_percent: float | None
    untestable: tuple[str, ...]
    left_out: tuple[str, ...]
    seed: int
    calibrated: Literal["anew", "found", "not"]
    effects: tuple[AppliedEffect, ...] = ()
    intervals: tuple[tuple[Interval, ...], ...] = ()
    ambiguous_with: tuple[AppliedEffect, ...] = ()
    named_bodies: tuple[NamedBodies, ...] = ()
    further: tuple[FurtherRecordings, ...] = ()
    louder: tuple[LouderRecordings, ...] = ()
    family: str = ""
    rounds: tuple[Round, ...] = ()
    nuisance: tuple[NuisanceValue, ...] = ()
    diagnostics: Diagnostics | None = None
    surface: Surface | None = None
    restoring_forces: tuple[RestoringForce, ...] = ()
    p_value: float | None = None
    named_from: float | None = None
    sensors: tuple[SensorFinding, ...] = ()
    lacking: tuple[str, ...] = ()
    needs: tuple[Need, ...] = ()

    @property
    def chosen(self) -> RankedCandidate | None:
        """The chosen candidate of the first round."""
        return self.rounds[0].chosen if self.rounds else None

    @property
    def refitted(self) -> bool:
        """Whether theta was fitted to these events."""
        return self.before is not self.given

    @property
    def added(self) -> tuple[AppliedEffect, ...]:
        """The found effects that the subject after has."""
        return tuple(one for one in self.effects if one in self.after.effects)

    @property
    def not_added(self) -> tuple[AppliedEffect, ...]:
        """The found effects that cannot be stored in a subject."""
        return tuple(one for one in self.effects if one not in self.after.effects)

    @property
    def adds(self) -> bool:
        """Whether the subject after has a further effect."""
        return len(self.after.effects) > len(self.before.effects)
