"""How a trace is done.

What separates effects from the usual was set on simulated bodies, with development forms alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.settings import FitSettings
from biodyn_core.settings import check_settings, setting
from biodyn_core.tracing.background import BackgroundSettings
from biodyn_core.tracing.gate import FloorSettings

BASE = FitSettings(
    phase1="pooled", clocks="trusted", refined_starts=2, swarm=SwarmSettings(particles=40, iterations=120, starts=3)
)
"""How theta is refitted before anything is looked for: clocks are one of the things to be found."""


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
