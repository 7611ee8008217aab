"""What a trace finds: plain data from the method to its document, text and page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from biodyn_core.base.arrays import Floats
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect
from biodyn_core.identification.problem import Errors

Verdict = Literal["effect", "ambiguous", "none", "unexplained", "not_decidable"]
NAMING: Final[tuple[Verdict, ...]] = ("effect", "ambiguous")
"""The verdicts that name a cause."""

Use = Literal["train", "choose", "held_out"]
"""What an event was for: theta and sizes are fitted to `train`, the effect is chosen by `choose`, and the errors that
are reported come from `held_out`, which has had no say in either."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One rung of the ladder.

    gain is the mean log ratio of SSE without over with in the events that choose, theta and the usual departures
    refitted on both sides, and by how much less these have to be stretched then; refitted says whether it comes from a
    refit or from screening's linear step. p_value is how often the best of all candidates gains as much by chance;
    absorbed, the share of its own energy that theta takes on itself; helps, in how many of the events it helps; against
    says what speaks against it, empty where nothing does; steady is not set for what is set anew time and again in the
    very events that choose: it always gains a little, and its p_value says nothing; usual is set for a law that is no
    larger than such bodies usually have it, which leaves nothing unexplained.
    """

    applied: AppliedEffect
    gain: float
    refitted: bool
    p_value: float
    absorbed: float
    helps: int
    against: tuple[str, ...] = ()
    steady: bool = True
    usual: bool = False


@dataclass(frozen=True, eq=False)
class Round:
    """One greedy step: the ladder, best first, what a gain had to exceed, and which rung was taken, if any."""

    ladder: tuple[Candidate, ...]
    threshold: float
    taken: Candidate | None
    ambiguous_with: tuple[Candidate, ...]


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
    """One event under the subject before and after, for errors and pictures.

    measured_mps2, before_mps2 and after_mps2 are (n, 5) by measured segment, NaN where not compared; segments without
    sensor or left out are NaN throughout. before and after are `Errors` of the same, given those of the subject as it
    was given, None where that was never fitted or is not asked for.
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
class Departure:
    """How far one usual departure (a gain, a clock, a mass, a joint's bend) is from nothing, in its own spread."""

    name: str
    times_usual: float


@dataclass(frozen=True, eq=False)
class SensorFinding:
    """A fault of a sensor that stands beside the verdict.

    told_by: the sensor's own gyro, or the fit. gain is that of the fault as a candidate, None where it was not tried;
    explains: whether it was taken as the cause.
    """

    fault: AppliedEffect
    told_by: Literal["gyro", "fit"]
    gain: float | None
    explains: bool


@dataclass(frozen=True)
class Need:
    """Recordings that a verdict lacks, for one use: so much more of each, and which recordings have to hold it."""

    use: Literal["to fit", "held out"]
    road_s: float
    shocks: int
    hard_shocks: int
    how: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Surface:
    """What force a joint lacks, N, over stretch (m) and its rate (m/s), where the data have been.

    force_n is (r, s): rows by rate_mps (r,), columns by stretch_m (s,), NaN where the joint never was. gain is as a
    candidate's; below the threshold, what is missing is memory, measurement or input and no law of this joint.
    """

    site: str
    stretch_m: Floats
    rate_mps: Floats
    force_n: Floats
    gain: float


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """What the residual says after the refit, before any candidate is tried.

    amplitude_transfer: per loading condition, what is left in multiples of what a good model misses, of a theta fitted
    to the quietest condition alone, and of the one fitted to all. coherent: per channel, the segment whose residual
    goes most with it, and the share of its power, with chance taken off. peeling: per sub-chain, from the head down,
    named by the sensor that drives it, normalised rms percent of what is above. bracket: the joints that this points
    to. level_slope: d log of the relative residual / d log peak. jump: the event, in the order given, at which the
    residual changes most, with how often chance does as much. pinned: parameters on a bound. drift: per parameter, ln
    of largest over smallest among the conditions' own values. pulled_down: the most that any event's seat would have to
    hold the body down, over the weight it carries.
    """

    amplitude_transfer: Mapping[str, tuple[float, float]]
    coherent: Mapping[str, tuple[str, float]]
    peeling: Mapping[str, float]
    bracket: tuple[str, ...]
    level_slope: float | None
    jump: tuple[str, float] | None
    pinned: tuple[str, ...]
    drift: Mapping[str, float]
    pulled_down: float


@dataclass(frozen=True, eq=False)
class Trace:
    """A whole trace.

    reasons: one line each, why this verdict and no other. given is the subject as it was given, before the same
    refitted without (the same object where nothing could be fitted to), after with the effects that were added (the
    object before where none was). sensors: faults of sensors, beside the verdict. needs: what to record for a verdict.
    intervals, one list for each of the effects. floor_percent is what noise of the sensors alone leaves, None where it
    cannot be told. untestable: effects for which a channel is missing. left_out: events or sensors the gate took out,
    with why. experiment: what to record next. calibrated: whether the threshold was computed anew or found.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    given: Subject
    before: Subject
    after: Subject
    effects: tuple[AppliedEffect, ...]
    intervals: tuple[tuple[Interval, ...], ...]
    ambiguous_with: tuple[AppliedEffect, ...]
    family: str
    experiment: str
    events: tuple[ComparedEvent, ...]
    rounds: tuple[Round, ...]
    departures: tuple[Departure, ...]
    diagnostics: Diagnostics | None
    surface: Surface | None
    floor_percent: float | None
    p_value: float | None
    threshold: float | None
    untestable: tuple[str, ...]
    left_out: tuple[str, ...]
    lacking: tuple[str, ...]
    seed: int
    calibrated: Literal["anew", "found", "not"]
    sensors: tuple[SensorFinding, ...] = ()
    needs: tuple[Need, ...] = ()

    @property
    def refitted(self) -> bool:
        """Whether theta was fitted to these events."""
        return self.before is not self.given

    @property
    def adds(self) -> bool:
        """Whether the subject after has an effect more."""
        return len(self.after.effects) > len(self.before.effects)
