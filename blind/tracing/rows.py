"""The rows of the study as data: drawings, conditions with their records, and the required marks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Final, Literal

from world.effects.mixture import PAPER, UNSEEN

from biodyn_core.effects import CATALOGUE
from blind.tracing.outcome import FAILED, LEAST_RATIO, Outcome

Kind = Literal["share", "mean", "median", "calibration"]
Needs = Literal["causes", "ceilings", "ratio", "all"]
"""Contents of a score: the truth alone, or with the ceiling of each effect, the ratio (two refits), or all errors."""

KINDS: Final = tuple(sorted(CATALOGUE))
"""Every class of the catalogue. The simulation's saturation is not among them: it is masked, never fitted."""

STRONG: Final = 0.8
WEAK: Final = 0.4
"""Limits of ratios between rows."""


FILLING: Final = 3
"""Records drawn for each missing one, because every second or third has the intended ratio."""


@dataclass(frozen=True)
class Drawing:
    """A group of records: their number, number and kinds of effects, and level of the background.

    ratio: intended by the simulation's linear estimate; the score's ratio decides the row of a record. It is usually
    half to twice the intended one. Counts give about forty records for each row by ratio, and a row with fewer gets
    further ones. coloured: adds noise of 0.3 m/s^2 that does not follow the input. background: kinds of
    `mixture.KINDS` or `mixture.UNSEEN`; the paper's alone has scale 1, else scales are drawn; level multiplies them.
    """

    name: str
    count: int
    effects: int = 1
    level: float = 1.0
    ratio: tuple[float, float] | None = None
    kinds: tuple[str, ...] = KINDS
    coloured: bool = False
    needs: Needs = "causes"
    background: tuple[str, ...] = (PAPER,)


DRAWINGS: Final = (
    Drawing("nothing", 50, effects=0, level=0.0),
    Drawing("nothing_coloured", 50, effects=0, level=0.0, coloured=True),
    Drawing("background", 60, effects=0),
    Drawing("background_unseen", 60, effects=0, background=UNSEEN),
    Drawing("sensor_noise", 42, level=0.0, needs="all"),
    Drawing("strong", 54, ratio=(1.5, 4.0), needs="all"),
    Drawing("medium", 64, ratio=(0.45, 0.85), needs="all"),
    Drawing("weak", 36, ratio=(0.15, 0.5), needs="all"),
    Drawing("outside", 54, ratio=(1.5, 4.0), kinds=("outside",), needs="ratio"),
    Drawing("two", 42, effects=2, level=0.0, needs="ceilings"),
)


@dataclass(frozen=True)
class Rule:
    """One mark: a limit for the share, mean or median of a value of each record, or for the calibration of all.

    of: the value, None for a record that does not count; for calibration the probability of the most probable answer
    and whether it is right.
    """

    what: str
    of: Callable[[Outcome], Any]
    limit: float
    sense: Literal[">=", "<="]
    kind: Kind = "share"

    @property
    def required(self) -> str:
        """The limit as text."""
        return f"{self.sense} {100.0 * self.limit:g} %" if self.kind == "share" else f"{self.sense} {self.limit:g}"


@dataclass(frozen=True)
class Condition:
    """A row of the table: records of some drawings within a range of ratios, their least number, and marks.

    ratio: without its lower end, with its upper one; records without a ratio are left out. filled_from: the drawing of
    further records if there are too few.
    """

    name: str
    drawings: tuple[str, ...]
    least: int
    rules: tuple[Rule, ...]
    ratio: tuple[float, float] | None = None
    filled_from: str = ""

    def chosen(self, outcomes: Sequence[Outcome]) -> list[Outcome]:
        """The outcomes of this row."""
        mine = [one for one in outcomes if one.answer.row in self.drawings]
        if self.ratio is None:
            return mine
        low, high = self.ratio
        return [one for one in mine if one.score.ratio is not None and low < one.score.ratio <= high]


def _near_site(one: Outcome) -> float:
    return one.site_distance is not None and one.site_distance <= 1


def _is_answered(one: Outcome) -> float:
    return one.answer.verdict not in ("not_decidable", FAILED)


def _over_floor(one: Outcome) -> float | None:
    """Error over the floor; a record without an answer counts as infinite."""
    if one.score.floor_percent is None:
        return None
    after = one.score.after_percent
    return float("inf") if after is None else after / one.score.floor_percent


def _closed_by_answer(one: Outcome) -> float | None:
    return one.score.closed(one.score.after_percent)


def _closed_by_oracle(one: Outcome) -> float | None:
    found = one.score.oracle_percent
    return None if found is None else one.score.closed(found)


def _set_size(one: Outcome) -> float | None:
    return float(one.set_size) or None


def _both_found(one: Outcome) -> float:
    return one.found == len(one.score.causes)


def _one_found(one: Outcome) -> float:
    return one.found > 0


def _right_if_sure(one: Outcome) -> float | None:
    """Whether the most probable answer is right, for those with at least `SURE`."""
    return float(one.most_probable_right) if one.probability >= SURE else None


def _is_quick(one: Outcome) -> float:
    return one.answer.seconds < LONG_S


WITH_BACKGROUND: Final = ("strong", "medium", "weak")
NOTHING_HIDDEN: Final = ("nothing", "nothing_coloured", "background", "background_unseen")
BY_PROBABILITY: Final = (*NOTHING_HIDDEN, "sensor_noise", *WITH_BACKGROUND, "outside")
"""Drawings whose answers are counted for calibration: those with at most one effect."""

SURE: Final = 0.8
MEDIAN_S: Final = 60.0
LONG_S: Final = 180.0
"""Limits of the time of a trace: of its duration on two cores, and here of its processor time, which is more."""

NO_CAUSE: Final = (
    Rule("a single cause named", attrgetter("single"), 0.05, "<="),
    Rule("a verdict is given", _is_answered, 1.0, ">="),
)

CONDITIONS: Final = (
    Condition("nothing hidden, sensor noise", ("nothing",), 50, NO_CAUSE),
    Condition("nothing hidden, loud coloured noise", ("nothing_coloured",), 50, NO_CAUSE),
    Condition("nothing hidden, background", ("background",), 60, NO_CAUSE),
    Condition("nothing hidden, background of kinds never trained on", ("background_unseen",), 60, NO_CAUSE),
    Condition(
        "sensor noise, ratio > 0.3", ("sensor_noise",), 40,
        (
            Rule("class", attrgetter("class_right"), 0.85, ">="),
            Rule("class, and within one joint", _near_site, 0.90, ">="),
            Rule("held-out error after over the floor, median", _over_floor, 1.2, "<=", "median"),
            Rule("truth refitted: closed share of the gap, median", _closed_by_oracle, 0.9, ">=", "median"),
        ),
        (LEAST_RATIO, float("inf")), "sensor_noise",
    ),
    Condition(
        "with background, ratio > 0.8", WITH_BACKGROUND, 40,
        (
            Rule("class", attrgetter("class_right"), 0.80, ">="),
            Rule("in the 90 % set", attrgetter("in_set"), 0.90, ">="),
            Rule("size of the set, mean", _set_size, 3.0, "<=", "mean"),
            Rule("closed share of the gap, median", _closed_by_answer, 0.85, ">=", "median"),
            Rule("truth refitted: closed share of the gap, median", _closed_by_oracle, 0.9, ">=", "median"),
        ),
        (STRONG, float("inf")), "strong",
    ),
    Condition(
        "with background, ratio 0.4 to 0.8", WITH_BACKGROUND, 40,
        (
            Rule("class", attrgetter("class_right"), 0.50, ">="),
            Rule("in the 90 % set", attrgetter("in_set"), 0.85, ">="),
        ),
        (WEAK, STRONG), "medium",
    ),
    Condition(
        "effect outside the catalogue, ratio > 0.8", ("outside",), 40,
        (Rule("a wrong single cause named", attrgetter("wrong_single"), 0.15, "<="),),
        (STRONG, float("inf")), "outside",
    ),
    Condition(
        "two effects", ("two",), 40,
        (
            Rule("one right", _one_found, 0.85, ">="),
            Rule("both found", _both_found, 0.45, ">="),
        ),
    ),
    Condition(
        "calibration", BY_PROBABILITY, 300,
        (
            Rule(f"answers with a probability of {SURE:g} and more are right", _right_if_sure, 0.8, ">="),
            Rule("expected calibration error", attrgetter("confidence"), 0.05, "<=", "calibration"),
        ),
    ),
    Condition(
        "speed", tuple(one.name for one in DRAWINGS), 400,
        (
            Rule("processor seconds of a trace, median", attrgetter("answer.seconds"), MEDIAN_S, "<=", "median"),
            Rule(f"traces below {LONG_S:g} s of processor time", _is_quick, 0.95, ">="),
        ),
    ),
)  # fmt: skip

MEASURED: Final = (
    Condition(
        "in measured streams, nothing hidden", ("measured_nothing",), 40,
        (Rule("a single cause named", attrgetter("single"), 0.05, "<="),),
    ),
    Condition(
        "in measured streams, ratio > 0.8", ("measured",), 40,
        (
            Rule("class", attrgetter("class_right"), 0.85, ">="),
            Rule("in the set", attrgetter("in_set"), 0.92, ">="),
        ),
        (STRONG, float("inf")),
    ),
)  # fmt: skip
"""Effects hidden in measured streams: those marks of the background rows that need no subject."""


def lacking(conditions: Sequence[Condition], outcomes: Sequence[Outcome]) -> dict[str, int]:
    """The number of further records by drawing, for rows with too few."""
    short = {row.filled_from: row.least - len(row.chosen(outcomes)) for row in conditions if row.filled_from}
    return {name: FILLING * missing for name, missing in short.items() if missing > 0}


def drawings(names: Sequence[str] = (), count: int | None = None) -> list[Drawing]:
    """The drawings of these names (all without names), each with count records; ValueError for an unknown name."""
    known = {one.name: one for one in DRAWINGS}
    for name in names:
        if name not in known:
            raise ValueError(f"row {name!r} is unknown, known are {', '.join(known)}")
    chosen = [known[name] for name in names] if names else list(DRAWINGS)
    return [one if count is None else dataclasses.replace(one, count=count) for one in chosen]
