"""How a trace is done.

What separates effects from the usual was set on simulated bodies, with development forms alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting
from biodyn_core.identification.settings import FitSettings, SwarmSettings

BASE = FitSettings(
    phase1="pooled", clocks="trusted", refined_starts=2, swarm=SwarmSettings(particles=40, iterations=120, starts=3)
)
"""How theta is refitted before anything is looked for: clocks are one of the things to be found."""


@dataclass(frozen=True)
class FloorSettings:
    """The least that a verdict rests on, each to fit and once more held out.

    The tracing study's 30 s of road, three potholes and three rails, told by what the seat feels: rails differ.
    """

    road_s: float = setting(30.0, "seconds without shocks", "s", 1.0, 3600.0)
    shocks: int = setting(6, "shocks, hard ones among them", "", 0, 1000)
    hard_shocks: int = setting(1, "hard shocks", "", 0, 1000)
    shock_g: float = setting(0.8, "a shock has a peak of so much", "g", 0.1, 10.0)
    hard_shock_g: float = setting(2.0, "a hard one", "g", 0.2, 20.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class WeightSettings:
    """How samples and windows are weighed: one over what a good model still misses, and what counts as independent."""

    noise_mps2: float = setting(0.025, "noise of a channel after the low-pass, rms", "m/s^2", 1e-4, 10.0)
    local_share: float = setting(0.04, "... and this share of the motion around a sample", "", 0.0, 1.0)
    event_share: float = setting(0.015, "... and this of the motion of the event", "", 0.0, 1.0)
    counted_s: float = setting(1.0, "length of the windows that are counted", "s", 0.1, 10.0)
    independent: float = setting(0.001, "share of the samples that count as independent of each other", "", 1e-6, 1.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class UsualSettings:
    """How far bodies and sensors usually depart from the model, as one standard deviation.

    Sensors: what data sheets, a belt mounting and clocks set once before an event allow. Bodies: the tracing study's.
    """

    usual_gain: float = setting(0.015, "gain of a sensor", "", 1e-4, 0.5)
    usual_clock_s: float = setting(0.0005, "offset of a sensor's clock", "s", 1e-6, 0.1)
    usual_lean: float = setting(0.025, "lean of a sensor in motion, as a share of g", "", 1e-4, 0.5)
    rest_lean: float = setting(
        0.008, "lean that a sensor's bias gives to what it takes for level at rest, as a share of g", "", 1e-4, 0.1
    )
    usual_softness_s: float = setting(0.0005, "softness of what a sensor sits on, 1 / (2 pi f)", "s", 1e-6, 0.02)
    usual_level_mps2: float = setting(0.2, "level of a sensor against its rest", "m/s^2", 1e-3, 10.0)
    usual_bend: float = setting(
        0.1, "bend of a joint's law at its reach, as a share of its linear force", "", 1e-3, 1.0
    )
    usual_mass: float = setting(0.06, "mass of a segment against its table", "", 1e-3, 0.5)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class BackgroundSettings:
    """How samples are weighed, how far bodies and sensors usually depart, and how far theta may move."""

    theta_spread: float = setting(0.5, "how far theta may move from the fit, in its logarithm", "", 0.01, 10.0)
    weights: WeightSettings = dataclasses.field(default_factory=WeightSettings)
    usual: UsualSettings = dataclasses.field(default_factory=UsualSettings)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class TraceSettings:
    """How a trace is done."""

    most_effects: int = setting(3, "effects that are added at most", "", 1, 10)
    least_gain: float = setting(
        0.15,
        "what a gain must exceed at least, in mean log ratio: bodies without anything hidden reach it",
        "",
        0.0,
        5.0,
    )
    plain_gain: float = setting(
        0.07,
        "... of a body that is as the model has it and lacks nothing yet: no law but a clock gains 0.05 by itself",
        "",
        0.0,
        5.0,
    )
    departing: float = setting(
        0.8, "... and so much more, in its shares, of bodies that depart as far as usual", "", 0.0, 100.0
    )
    farthest: float = setting(
        4.0, "spreads of a usual departure, up to which it is no cause in a body that departs at all", "", 0.0, 100.0
    )
    least_lift_off: float = setting(
        0.05, "... for a seat that holds nobody down: without it, events that lift tell it at once", "", 0.0, 5.0
    )
    overwhelming: float = setting(
        2.5, "times what is asked, from which an effect is believed though it ends on a bound", "", 1.0, 100.0
    )
    replicates: int = setting(200, "draws of the largest gain by chance", "", 20, 100_000)
    refined: int = setting(12, "candidates that are settled on all events", "", 1, 1000)
    near: float = setting(0.8, "share of the best gain from which another effect explains as much", "", 0.1, 1.0)
    near_alike: float = setting(0.6, "... and one that looks alike", "", 0.1, 1.0)
    alike: float = setting(0.6, "cosine from which two effects look alike", "", 0.1, 1.0)
    enough: float = setting(
        0.5, "times what a good model misses: with less left, no more is looked for", "", 0.0, 100.0
    )
    unusual: float = setting(
        1.15, "times what a good model misses, from which what is left is unexplained", "", 1.0, 100.0
    )
    most_stretched: float = setting(
        30.0, "squares of usual departures, in theirs, from which they explain nothing any more", "", 0.0, 1e6
    )
    usual_left: float = setting(0.65, "... and what is left of bodies with nothing hidden, their median", "", 0.0, 10.0)
    least_closed: float = setting(0.45, "share of the gap between both that effects must close", "", 0.0, 1.0)
    floor: FloorSettings = dataclasses.field(default_factory=FloorSettings)
    background: BackgroundSettings = dataclasses.field(default_factory=BackgroundSettings)
    base: FitSettings = BASE

    def __post_init__(self) -> None:
        check_settings(self)
