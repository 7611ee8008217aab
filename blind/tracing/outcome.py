"""What was said of one record, what was true of it, and how one compares with the other; plain data, also as JSON."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.findings import NAMING

FAILED: Final = "failed"
"""What stands for a verdict where the tracer gave none; it is right in nothing."""

FATES: Final = (
    "named",
    "another class named",
    "several named as possible",
    "another class was the best, and refused",
    "the true class was the best, and refused for what it is: a bound, a usual size, too few events",
    "... as it gained less than was asked",
    "... as it left most of the gap open",
)
"""What may become of a record's true class."""

JOINT_PLACE: Final = dict(zip(SEGMENTS, (0, 1, 2, 2, 3, 4), strict=True))
"""Joints from below; those on either side of the central torso, which is not measured, count as one."""


@dataclass(frozen=True)
class Cause:
    """An effect by its class, site and family; site is empty where the whole body is meant or none can be compared."""

    name: str
    site: str
    family: str


@dataclass(frozen=True)
class Answer:
    """What the tracer said of a record.

    before and after are theta (15,); applied are the effects of the subject after, as a subject file has them. Errors
    are means over the events that had no say in it, whose names are in `unseen`, percent; None where there are none.
    best is what was taken first, or else gained most, best_gain what it gained, and against what spoke against it.
    """

    row: str
    number: int
    verdict: str
    effects: tuple[Cause, ...] = ()
    ambiguous_with: tuple[Cause, ...] = ()
    before: tuple[float, ...] = ()
    after: tuple[float, ...] = ()
    applied: tuple[dict[str, Any], ...] = ()
    before_percent: float | None = None
    after_percent: float | None = None
    threshold: float | None = None
    p_value: float | None = None
    seconds: float = 0.0
    why: str = ""
    unseen: tuple[str, ...] = ()
    best: Cause | None = None
    best_gain: float | None = None
    against: tuple[str, ...] = ()

    @classmethod
    def of(cls, line: str) -> Answer:
        """Read what `line_of` wrote."""
        data = json.loads(line)
        data["best"] = Cause(**data["best"]) if data.get("best") else None
        for key in ("effects", "ambiguous_with"):
            data[key] = tuple(Cause(**one) for one in data[key])
        for key in ("before", "after", "applied", "unseen", "against"):
            data[key] = tuple(data.get(key, ()))
        return cls(**data)


@dataclass(frozen=True)
class Score:
    """What was true of a record, and errors beside it; None where they were not asked for.

    ratio: rms of what the effect changes in the base refit's residual over the rms without. Errors are in percent, of
    the answer's unseen events, infinite where a subject runs away there: floor without the effect; placebo, generic and
    oracle with it. recovered is the share of the energy that the oracle takes off which the answer takes off too, 0 for
    a wrong class; `why` says what went wrong.
    """

    row: str
    number: int
    causes: tuple[Cause, ...]
    ratio: float | None = None
    floor_percent: float | None = None
    before_percent: float | None = None
    after_percent: float | None = None
    placebo_percent: float | None = None
    generic_percent: float | None = None
    oracle_percent: float | None = None
    recovered: float | None = None
    why: str = ""

    @classmethod
    def of(cls, line: str) -> Score:
        """Read what `line_of` wrote."""
        data = json.loads(line)
        data["causes"] = tuple(Cause(**one) for one in data["causes"])
        return cls(**data)


def line_of(one: Answer | Score) -> str:
    """One line of JSON, keys in their order."""
    return json.dumps(dataclasses.asdict(one), sort_keys=True)


@dataclass(frozen=True)
class Outcome:
    """A record's answer beside its score."""

    answer: Answer
    score: Score

    @property
    def alarmed(self) -> bool:
        """Whether the verdict is that something is there and what it may be."""
        return self.answer.verdict in NAMING

    @property
    def single(self) -> bool:
        """Whether a single cause is named; several that were added one after the other are named too."""
        return self.answer.verdict == "effect"

    @property
    def added(self) -> bool:
        """Whether the subject has an effect more."""
        return bool(self.answer.applied)

    @property
    def named(self) -> str:
        """The class that is named first, or else the verdict."""
        return self.answer.effects[0].name if self.single and self.answer.effects else self.answer.verdict

    @property
    def reported(self) -> tuple[Cause, ...]:
        """All that is reported as possible."""
        return (*self.answer.effects, *self.answer.ambiguous_with) if self.alarmed else ()

    @property
    def set_size(self) -> int:
        """How many classes are reported."""
        return len({cause.name for cause in self.reported})

    @property
    def true_names(self) -> frozenset[str]:
        """The classes that are true."""
        return frozenset(cause.name for cause in self.score.causes)

    @property
    def class_right(self) -> bool:
        """Whether the class that is named first is true."""
        return self.named in self.true_names

    @property
    def family_right(self) -> bool:
        """Whether all that is reported is of the one true family; an ambiguous set may still agree on that."""
        families = {cause.family for cause in self.reported}
        return len(families) == 1 and families <= {cause.family for cause in self.score.causes}

    @property
    def wrong_single(self) -> bool:
        """Whether a single cause is named and any that is named is not true."""
        return self.single and not {cause.name for cause in self.answer.effects} <= self.true_names

    @property
    def in_set(self) -> bool:
        """Whether all that is true is in the reported set."""
        return self.true_names <= {cause.name for cause in self.reported}

    @property
    def found(self) -> int:
        """How many of the true classes are among the effects that are named."""
        return len(self.true_names & {cause.name for cause in self.answer.effects}) if self.single else 0

    @property
    def fate(self) -> str:
        """What became of the true class, in words; the first that holds of `FATES`."""
        answer = self.answer
        if self.class_right:
            return FATES[0]
        if self.alarmed:
            return FATES[1] if self.single else FATES[2]
        if answer.best is None or answer.best.name not in self.true_names:
            return FATES[3]
        if answer.against:
            return FATES[4]
        enough = (answer.best_gain or 0.0) > (answer.threshold or 0.0)
        return FATES[6] if enough else FATES[5]

    @property
    def away(self) -> int | None:
        """How many places the named site is from the true one; None where the class is wrong."""
        if not self.class_right:
            return None
        said = self.answer.effects[0]
        return min(places_away(said.name, said.site, one.site) for one in self.score.causes if one.name == said.name)


def places_away(name: str, site: str, other: str) -> int:
    """How many joints, segments or sensors, by what a class sits on, are from one site to another."""
    place = CATALOGUE[name].place if name in CATALOGUE else "seat"
    if place == "seat" or {site, other} & {"", SEAT}:
        return 0
    if place == "joint":
        return abs(JOINT_PLACE[site] - JOINT_PLACE[other])
    order = MEASURED_SEGMENTS if place == "sensor" else SEGMENTS
    return abs(order.index(site) - order.index(other))
