"""The rows of the study as data: drawings, conditions with their records, and the required marks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, Literal

from world.effects.mixture import PAPER

from biodyn_core.effects import CATALOGUE
from blind.tracing.outcome import Outcome

Kind = Literal["share", "mean", "median"]
Needs = Literal["causes", "ratio", "all"]
"""Contents of a score: the truth alone, also the ratio (two refits), or also all errors."""

KINDS: Final = tuple(sorted(CATALOGUE))
"""Every class of the catalogue. The simulation's saturation is not among them: it is masked, never fitted."""

STRONG: Final = 0.8
WEAK: Final = 0.4
"""Between these ratios the truth has only to be in the reported set."""


FILLING: Final = 3
"""Records drawn for each missing one, because every second or third has the intended ratio."""


@dataclass(frozen=True)
class Drawing:
    """A group of records: their number, number and kinds of effects, and level of the background.

    ratio: intended by the simulation's linear estimate; the score's ratio decides the row of a record. It is usually
    half to twice the intended one. Counts give about forty records for each row by ratio, and a row with fewer gets
    further ones. coloured: adds noise of 0.3 m/s^2 that does not follow the input. background: kinds of
    `mixture.KINDS`; the paper's alone has scale 1, else scales are drawn; level multiplies them.
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
    Drawing("sensor_noise", 42, level=0.0, needs="all"),
    Drawing("strong", 54, ratio=(1.5, 4.0), needs="all"),
    Drawing("medium", 64, ratio=(0.45, 0.85), needs="all"),
    Drawing("weak", 36, ratio=(0.15, 0.5), needs="all"),
    Drawing("outside", 54, ratio=(1.5, 4.0), kinds=("outside",), needs="ratio"),
    Drawing("two", 42, effects=2, level=0.0),
)


@dataclass(frozen=True)
class Rule:
    """One mark: a limit for the share, mean or median of a value of each record.

    of: the value, None for a record that does not count.
    """

    what: str
    of: Callable[[Outcome], float | None]
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


def _alarmed(one: Outcome) -> float:
    return one.alarmed or one.added


def _exact_site(one: Outcome) -> float:
    return one.site_distance == 0


def _near_site(one: Outcome) -> float:
    return one.site_distance is not None and one.site_distance <= 1


def _over_floor(one: Outcome) -> float | None:
    """Error over the floor; a record without an answer counts as infinite."""
    if one.score.floor_percent is None:
        return None
    after = one.score.after_percent
    return float("inf") if after is None else after / one.score.floor_percent


def _set_size(one: Outcome) -> float | None:
    return float(one.set_size) or None


def _unexplained(one: Outcome) -> float:
    return one.answer.verdict == "unexplained" or one.family_right


def _both_found(one: Outcome) -> float:
    return one.found == len(one.true_names)


def _one_found(one: Outcome) -> float:
    return one.found > 0


WITH_BACKGROUND: Final = ("strong", "medium", "weak")

CONDITIONS: Final = (
    Condition(
        "nothing hidden, with and without coloured noise", ("nothing", "nothing_coloured"), 100,
        (Rule("false alarms", _alarmed, 0.05, "<="),),
    ),
    Condition(
        "background only, nothing hidden", ("background",), 60,
        (
            Rule("a single cause named", attrgetter("single"), 0.10, "<="),
            Rule("an effect added to the subject", attrgetter("added"), 0.05, "<="),
        ),
    ),
    Condition(
        "catalogue effect, sensor noise", ("sensor_noise",), 40,
        (
            Rule("class", attrgetter("class_right"), 0.95, ">="),
            Rule("exact site", _exact_site, 0.85, ">="),
            Rule("within one joint", _near_site, 0.95, ">="),
            Rule("held-out error after over the floor, median", _over_floor, 1.15, "<=", "median"),
        ),
    ),
    Condition(
        "with background, ratio > 0.8", WITH_BACKGROUND, 40,
        (
            Rule("class", attrgetter("class_right"), 0.85, ">="),
            Rule("family", attrgetter("family_right"), 0.92, ">="),
            Rule("energy recovered, median", attrgetter("score.recovered"), 0.70, ">=", "median"),
        ),
        (STRONG, float("inf")), "strong",
    ),
    Condition(
        "with background, ratio 0.4 to 0.8", WITH_BACKGROUND, 40,
        (
            Rule("truth in the reported set", attrgetter("in_set"), 0.92, ">="),
            Rule("size of the set where there is one, mean", _set_size, 3.0, "<=", "mean"),
        ),
        (WEAK, STRONG), "medium",
    ),
    Condition(
        "with background, ratio < 0.4", WITH_BACKGROUND, 40,
        (Rule("a wrong single cause named", attrgetter("wrong_single"), 0.10, "<="),),
        (-1.0, WEAK), "weak",
    ),
    Condition(
        "effect outside the catalogue, ratio > 0.8", ("outside",), 40,
        (
            Rule("unexplained, or the right family", _unexplained, 0.80, ">="),
            Rule("a wrong single cause named", attrgetter("wrong_single"), 0.10, "<="),
        ),
        (STRONG, float("inf")), "outside",
    ),
    Condition(
        "two effects", ("two",), 40,
        (
            Rule("both found", _both_found, 0.60, ">="),
            Rule("at least one right", _one_found, 0.90, ">="),
        ),
    ),
)  # fmt: skip

MEASURED: Final = (
    Condition(
        "in measured streams, nothing hidden", ("measured_nothing",), 40,
        (Rule("a single cause named", attrgetter("single"), 0.10, "<="),),
    ),
    Condition(
        "in measured streams, ratio > 0.8", ("measured",), 40,
        (Rule("class", attrgetter("class_right"), 0.85, ">="), Rule("family", attrgetter("family_right"), 0.92, ">=")),
        (STRONG, float("inf")),
    ),
    Condition(
        "in measured streams, ratio 0.4 to 0.8", ("measured",), 40,
        (
            Rule("truth in the reported set", attrgetter("in_set"), 0.92, ">="),
            Rule("size of the set where there is one, mean", _set_size, 3.0, "<=", "mean"),
        ),
        (WEAK, STRONG),
    ),
    Condition(
        "in measured streams, ratio < 0.4", ("measured",), 40,
        (Rule("a wrong single cause named", attrgetter("wrong_single"), 0.10, "<="),),
        (-1.0, WEAK),
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
