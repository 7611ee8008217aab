"""Answer, truth and comparison of one record: plain data, also as JSON."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.findings import NAMING
from biodyn_core.tracing.probability import NONE, OUTSIDE

FAILED: Final = "failed"
"""The verdict of a record whose trace failed; it is never right."""

TRUE_CLASS_RESULTS: Final = (
    "named",
    "another class named",
    "the most probable answer, with less than the required probability",
    "another answer is more probable, and it is in the 90 % set",
    "another answer is more probable, and it is not in the 90 % set",
)
"""The possible results for a record's true class."""

LEAST_RATIO: Final = 0.3
"""Below this ratio no mark asks for an effect, and `none` is right too."""

MECHANISMS: Final = frozenset(effect.mechanism for effect in CATALOGUE.values())

JOINT_PLACE: Final = dict(zip(SEGMENTS, (0, 1, 2, 2, 3, 4), strict=True))
"""Joints from below; both joints of the central torso, which has no sensor, count as one."""


@dataclass(frozen=True)
class Cause:
    """An effect by its name, site and family; site is empty for the whole body, or if sites cannot be compared."""

    name: str
    site: str
    family: str

    @property
    def mechanism(self) -> str:
        """Its class in the study: effects of one mechanism differ in the form of the law alone."""
        return CATALOGUE[self.name].mechanism if self.name in CATALOGUE else self.name


@dataclass(frozen=True)
class Answer:
    """The trace of a record.

    before, after: theta (15,); applied: the effects of the subject after, as in a subject file. Errors are means over
    the held-out events, whose names are `unseen`, percent; None without any. seconds: of processor time.
    probabilities: of each mechanism, `none` and `outside` in the first round, the largest first; likely: the 90 % set.
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
    p_value: float | None = None
    seconds: float = 0.0
    why: str = ""
    unseen: tuple[str, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    likely: tuple[str, ...] = ()

    @property
    def most_probable(self) -> str:
        """The most probable answer, empty without a round."""
        return max(self.probabilities, key=lambda name: self.probabilities[name], default="")

    @classmethod
    def of(cls, line: str) -> Answer:
        """Read a line of `line_of`."""
        data = json.loads(line)
        for key in ("effects", "ambiguous_with"):
            data[key] = tuple(Cause(**one) for one in data[key])
        for key in ("before", "after", "applied", "unseen", "likely"):
            data[key] = tuple(data.get(key, ()))
        return cls(**data)


@dataclass(frozen=True)
class Score:
    """The truth of a record, and errors; None if they are not needed.

    ratio: rms of the effect's change of the base refit's residual over the rms without it. Errors are in percent, of
    the answer's unseen events, infinite for an unstable simulation: floor without the effect; placebo, generic and
    oracle with it. recovered: the energy that the answer removes, as a share of that which the oracle removes, 0 for a
    wrong class. own_ratio: of a cause named where nothing is hidden, that of the background's own law of this class at
    this site; None if it has none. ceiling, ceiling_likely: the probabilities of the first round, and its 90 % set, as
    if the catalogue had the true law; empty where they are not needed. ceilings_alone: such probabilities of each of
    several effects in the record without the others. why: the error message of a failed refit.
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
    own_ratio: float | None = None
    ceiling: Mapping[str, float] = field(default_factory=dict)
    ceiling_likely: tuple[str, ...] = ()
    ceilings_alone: tuple[Mapping[str, float], ...] = ()
    why: str = ""

    def closed(self, percent: float | None) -> float | None:
        """The share of the squared gap between before and the floor that an error closes, 0 without one.

        None if there is no gap.
        """
        if self.before_percent is None or self.floor_percent is None or self.before_percent <= self.floor_percent:
            return None
        after = self.before_percent if percent is None else percent
        return (self.before_percent**2 - after**2) / (self.before_percent**2 - self.floor_percent**2)

    @classmethod
    def of(cls, line: str) -> Score:
        """Read a line of `line_of`."""
        data = json.loads(line)
        data["causes"] = tuple(Cause(**one) for one in data["causes"])
        for key in ("ceiling_likely", "ceilings_alone"):
            data[key] = tuple(data.get(key, ()))
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
        """Whether the verdict names one or several causes."""
        return self.answer.verdict in NAMING

    @property
    def single(self) -> bool:
        """Whether the verdict is `effect`; effects of later rounds are named too."""
        return self.answer.verdict == "effect"

    @property
    def added(self) -> bool:
        """Whether the subject has a further effect."""
        return bool(self.answer.applied)

    @property
    def named(self) -> str:
        """The first named class, or else the verdict."""
        return self.answer.effects[0].mechanism if self.single and self.answer.effects else self.answer.verdict

    @property
    def reported(self) -> tuple[Cause, ...]:
        """All reported causes."""
        return (*self.answer.effects, *self.answer.ambiguous_with) if self.alarmed else ()

    @property
    def set_size(self) -> int:
        """The number of answers in the 90 % set, `none` and `outside` among them."""
        return len(self.answer.likely)

    @property
    def true_names(self) -> frozenset[str]:
        """The true classes."""
        return frozenset(cause.mechanism for cause in self.score.causes)

    @property
    def class_right(self) -> bool:
        """Whether the first named class is true."""
        return self.named in self.true_names

    @property
    def family_right(self) -> bool:
        """Whether all reported causes are of the one true family; this may hold for an ambiguous verdict."""
        families = {cause.family for cause in self.reported}
        return len(families) == 1 and families <= {cause.family for cause in self.score.causes}

    @property
    def wrong_single(self) -> bool:
        """Whether the verdict is `effect` and a named class is not true."""
        return self.single and not {cause.mechanism for cause in self.answer.effects} <= self.true_names

    @property
    def in_set(self) -> bool:
        """Whether the 90 % set has a true class."""
        return bool(self.true_names & set(self.answer.likely))

    def named_with_true_law(self, named_from: float) -> bool:
        """Whether the true class would be named if the catalogue had its law."""
        return any(_names(self.score.ceiling, one, named_from) for one in self.score.causes)

    def named_alone(self, named_from: float) -> int:
        """The number of effects that would be named if the catalogue had their laws, and each were the only one."""
        alone = zip(self.score.ceilings_alone, self.score.causes, strict=False)
        return sum(_names(ideal, one, named_from) for ideal, one in alone)

    @property
    def in_set_with_true_law(self) -> bool:
        """Whether the 90 % set would have a true class if the catalogue had its law."""
        return bool(self.true_names & set(self.score.ceiling_likely))

    @property
    def right_answers(self) -> frozenset[str]:
        """The true classes, `outside` for an effect of no class; `none` if the effect is weak, or nothing is hidden."""
        names = {name if name in MECHANISMS else OUTSIDE for name in self.true_names}
        weak = self.score.ratio is not None and self.score.ratio < LEAST_RATIO
        return frozenset({*names, NONE} if weak or not names else names)

    @property
    def probability(self) -> float:
        """The probability of the most probable answer, 0 without one."""
        return self.answer.probabilities.get(self.answer.most_probable, 0.0)

    @property
    def most_probable_right(self) -> bool:
        """Whether the most probable answer is right."""
        return self.answer.most_probable in self.right_answers

    @property
    def true_class_leads(self) -> bool:
        """Whether the most probable answer is a true class."""
        return self.answer.most_probable in self.true_names

    @property
    def confidence(self) -> tuple[float, bool] | None:
        """The probability of the most probable answer, and whether it is right; None without an answer."""
        return (self.probability, self.most_probable_right) if self.answer.probabilities else None

    @property
    def found(self) -> int:
        """The number of hidden effects whose class is named; two effects of one class need two names."""
        if not self.single:
            return 0
        true, named = (Counter(one.mechanism for one in each) for each in (self.score.causes, self.answer.effects))
        return (true & named).total()

    @property
    def true_class_result(self) -> str:
        """The result for the true class: the first of `TRUE_CLASS_RESULTS` that holds."""
        if self.class_right:
            return TRUE_CLASS_RESULTS[0]
        if self.single:
            return TRUE_CLASS_RESULTS[1]
        if self.true_class_leads:
            return TRUE_CLASS_RESULTS[2]
        return TRUE_CLASS_RESULTS[3] if self.in_set else TRUE_CLASS_RESULTS[4]

    @property
    def site_distance(self) -> int | None:
        """The distance of the named site from the true one, in places; None if the class is wrong."""
        if not self.class_right:
            return None
        named = self.answer.effects[0]
        true = [one for one in self.score.causes if one.mechanism == named.mechanism]
        return min(site_distance(named.name, named.site, one.site) for one in true)


def _names(probabilities: Mapping[str, float], cause: Cause, named_from: float) -> bool:
    """Whether the most probable answer is the class of a cause, with the required probability."""
    best = max(probabilities, key=lambda name: probabilities[name], default="")
    return best == cause.mechanism and probabilities[best] >= named_from


def site_distance(name: str, site: str, other: str) -> int:
    """The distance of two sites of a class, in joints, segments or sensors."""
    place = CATALOGUE[name].place if name in CATALOGUE else "seat"
    if place == "seat" or {site, other} & {"", SEAT}:
        return 0
    if place == "joint":
        return abs(JOINT_PLACE[site] - JOINT_PLACE[other])
    order = MEASURED_SEGMENTS if place == "sensor" else SEGMENTS
    return abs(order.index(site) - order.index(other))
