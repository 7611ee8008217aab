"""Finding: sessions of a seat with a list of planted events, which the search does not see."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from world import sensors
from world.seats import RATE_HZ
from world.session import Planted, SessionMotion, session

from biodyn_core.sessions.findings import Event, Findings
from biodyn_core.sessions.session import Session

NEAR_S: Final = 0.1
"""A shock is found if its time differs by no more."""

EDGE_S: Final = 0.3


@dataclass(frozen=True)
class FindingScore:
    """Counts over sessions: shocks planted, found and invented, events by condition, and rests."""

    seconds: float
    planted: int
    found: int
    all_found: int
    invented: int
    events: int
    right: int
    rests: int
    rests_found: int

    @classmethod
    def total(cls, scores: Sequence[FindingScore]) -> FindingScore:
        """The sum over sessions."""
        return cls(*(sum(getattr(score, name) for score in scores) for name in cls.__dataclass_fields__))


def score_of(minutes: float, seed: int) -> FindingScore:
    """Simulate a session, search it, and compare."""
    rng = np.random.default_rng(seed)
    motion = session(minutes, rng)
    # Times are those of the clock of the seat: with drift they would differ from the list by 0.1 s after 40 minutes.
    seat = dataclasses.replace(sensors.drawn(rng), drift=0.0)
    stamps, samples = seat.stream(motion.accel_mps2, RATE_HZ, rng)
    search = Session(int(stamps[0]))
    search.push("seat", stamps, samples)
    return compared(search.finish(), motion)


def compared(found: Findings, motion: SessionMotion) -> FindingScore:
    """The counts of one session."""
    times = [shock.time_s for event in found.events for shock in event.shocks]
    hits = [any(apart_s(at, one) <= NEAR_S for at in times) for one in motion.shocks]
    invented = [at for at in times if not any(apart_s(at, one) <= NEAR_S for one in motion.shocks)]
    still = [one for one in motion.planted if one.kind == "standstill"]
    met = [one for one in still if any(rest.begin_s < one.end_s and one.begin_s < rest.end_s for rest in found.rests)]
    return FindingScore(
        found.seconds, len(hits), sum(hits), len(times), len(invented), len(found.events),
        sum(event.case in conditions_at(event, motion.planted) for event in found.events), len(still), len(met),
    )  # fmt: skip


def apart_s(at_s: float, one: Planted) -> float:
    """The time from a planted shock; 0 between the strikes of a train, of which two may be about equally large."""
    begin_s, end_s = (one.begin_s, one.end_s) if one.kind == "rail" else (one.peak_s, one.peak_s)
    return max(begin_s - at_s, at_s - end_s, 0.0)


def conditions_at(event: Event, planted: Sequence[Planted]) -> set[str]:
    """The planted conditions at the peak of an event with shocks, else in its middle."""
    at_s = event.peak_s if event.shocks else 0.5 * (event.begin_s + event.end_s)
    shocks = {one.kind for one in planted if one.peak_g and one.begin_s - EDGE_S <= at_s <= one.end_s + EDGE_S}
    return shocks or {one.kind for one in planted if one.begin_s <= at_s <= one.end_s}
