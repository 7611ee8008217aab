"""Marks of the rows with their intervals, results by class beside the simplest baseline, and the confusion matrix."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from blind.tracing.outcome import TRUE_CLASS_RESULTS, Outcome, Score
from blind.tracing.reliability import calibration_error
from blind.tracing.rows import CONDITIONS, Condition, Kind, Rule
from blind.tracing.shares import wilson

NO_ANSWER: Final = "no answer"
"""Of a record without probabilities, in the confusion matrix."""


@dataclass(frozen=True)
class Mark:
    """One mark of one row: the required and the reached value; the point estimate decides.

    reached: a share, mean or median, None without a value; lower, upper: Wilson's 95 % interval of a share. records:
    number of the row's records; values: number of those with a value. A row with fewer records than `least` misses its
    marks.
    """

    row: str
    what: str
    required: str
    reached: float | None
    records: int
    values: int
    met: bool
    least: int = 0
    kind: str = "share"
    lower: float | None = None
    upper: float | None = None
    baseline: float | None = None

    @property
    def text(self) -> str:
        """The reached value as text."""
        if self.reached is None:
            return "-"
        if self.kind != "share":
            return f"{self.reached:.3f} of {self.values}"
        return f"{100.0 * self.reached:.1f} % ({_percent(self.lower)} to {_percent(self.upper)}) of {self.values}"


@dataclass(frozen=True)
class ByClass:
    """Results of the records of one true class."""

    name: str
    records: int
    class_right: int
    family_right: int
    site_right: int
    in_set: int
    named: tuple[tuple[str, int], ...]


def marks(outcomes: Sequence[Outcome], conditions: Sequence[Condition] = CONDITIONS) -> list[Mark]:
    """All marks of all rows."""
    return [_mark(row, rule, row.chosen(outcomes)) for row in conditions for rule in row.rules]


def _mark(row: Condition, rule: Rule, chosen: Sequence[Outcome]) -> Mark:
    values = [value for one in chosen if (value := rule.of(one)) is not None]
    if not values:
        return Mark(row.name, rule.what, rule.required, None, len(chosen), 0, False, row.least, rule.kind)
    reached = float(REDUCTIONS[rule.kind](values))
    enough = len(chosen) >= row.least
    good = reached >= rule.limit if rule.sense == ">=" else reached <= rule.limit
    low, high = wilson(round(sum(values)), len(values)) if rule.kind == "share" else (None, None)
    baseline = most_frequent(chosen)[1] if rule.what == "class" else None
    return Mark(
        row.name, rule.what, rule.required, reached, len(chosen), len(values), bool(enough and good), row.least,
        rule.kind, low, high, baseline,
    )  # fmt: skip


REDUCTIONS: Final[dict[Kind, Callable[[Sequence[Any]], Any]]] = {
    "share": np.mean,
    "mean": np.mean,
    "median": np.median,
    "calibration": calibration_error,
}


def most_frequent(outcomes: Sequence[Outcome]) -> tuple[str, float]:
    """The most frequent true class, the first by name of several, and its share."""
    counts = Counter(name for one in outcomes for name in one.true_names)
    if not counts:
        return "", 0.0
    name = min(counts, key=lambda key: (-counts[key], key))
    return name, counts[name] / len(outcomes)


def by_class(outcomes: Sequence[Outcome]) -> list[ByClass]:
    """Results of records with one true class, by that class; named: classes and verdicts, the most frequent first."""
    found = []
    for name in sorted({next(iter(one.true_names)) for one in outcomes if len(one.true_names) == 1}):
        mine = [one for one in outcomes if one.true_names == {name}]
        named = Counter(one.named for one in mine)
        found.append(
            ByClass(
                name, len(mine),
                class_right=sum(one.class_right for one in mine),
                family_right=sum(one.family_right for one in mine),
                site_right=sum(one.site_distance == 0 for one in mine),
                in_set=sum(one.in_set for one in mine),
                named=tuple(sorted(named.items(), key=lambda pair: (-pair[1], pair[0]))),
            )
        )  # fmt: skip
    return found


def confusion(outcomes: Sequence[Outcome]) -> dict[str, Counter[str]]:
    """The most probable answers to records with one true class, counted by that class."""
    found: dict[str, Counter[str]] = {}
    for one in outcomes:
        if len(one.true_names) == 1:
            (name,) = one.true_names
            found.setdefault(name, Counter())[one.answer.most_probable or NO_ANSWER] += 1
    return found


def true_class_results(outcomes: Sequence[Outcome]) -> dict[str, tuple[int, int, int]]:
    """The results for the true classes: numbers of records that the oracle can explain, with an oracle, and of all.

    The oracle can explain a record if it removes half of the squared error before beyond the squared floor.
    """
    found = dict.fromkeys(TRUE_CLASS_RESULTS, (0, 0, 0))
    for one in outcomes:
        closed, known, every = found[one.true_class_result]
        known += one.score.oracle_percent is not None
        found[one.true_class_result] = closed + _can_close(one.score), known, every + 1
    return found


def _can_close(score: Score) -> bool:
    before, floor, best = (
        np.nan if percent is None else percent**2
        for percent in (score.before_percent, score.floor_percent, score.oracle_percent)
    )
    return bool(before - best >= 0.5 * (before - floor) > 0.0)


def verdicts(outcomes: Sequence[Outcome]) -> dict[str, Counter[str]]:
    """The number of each verdict, by drawing."""
    found: dict[str, Counter[str]] = {}
    for one in outcomes:
        found.setdefault(one.answer.row, Counter())[one.answer.verdict] += 1
    return found


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f}"
