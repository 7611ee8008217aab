"""The page of the latest full run: marks, verdicts, probabilities, errors, speed, and results by class."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from blind.tracing.marks import Mark, by_class, most_frequent, true_class_results, verdicts
from blind.tracing.outcome import Outcome, Score
from blind.tracing.rows import CONDITIONS, DRAWINGS, MEASURED, Condition
from blind.tracing.score import PLACEBOS
from blind.tracing.sections import (
    ceiling_lines,
    confusion_lines,
    own_law_lines,
    ratio_lines,
    reliability_lines,
    speed_lines,
)
from conformance.table import table

HEAD: Final = """\
# Blind study of tracing

Made by `make blind`, which fails if a mark is missed. Do not edit. All runs are in
[tracing_runs.md](tracing_runs.md).

`test/world` simulates people, seats, sensors and hidden effects, whose functional forms differ from the catalogue's.
Each run has a new seed. All verdicts and their hash are written before any truth is drawn again from the seed. Scored
forms differ from those that the learned model and the settings come from.

Ratio is the rms of the effect's change of the base refit's residual, over the rms without the effect, each record
refitted with and without it; it is known only with the truth. A row by ratio with too few records gets further ones in
batches, each sealed before its truths are drawn; their number depends on ratios, never on verdicts.

The point estimate decides a mark; intervals are Wilson's, 95 %. A class is right if it is named first and alone, so
`ambiguous` is not right. Both joints of the central torso (3 and 4), which has no sensor, count as one.
"""


def rendered(outcomes: Sequence[Outcome], found: Sequence[Mark], about: str) -> str:
    """The whole page; about: the line of the run."""
    parts = (
        _marks(found),
        ceiling_lines(outcomes, found),
        own_law_lines(outcomes),
        _verdicts(outcomes),
        reliability_lines(outcomes),
        ratio_lines(outcomes),
        _errors(outcomes),
        speed_lines(outcomes),
        *(_true_classes(outcomes, row) for row in CONDITIONS if _asks_for_class(row)),
        *(_classes(outcomes, row) for row in (*CONDITIONS, *MEASURED) if row.ratio is not None),
    )
    lines = [line for part in parts for line in part]
    return "\n".join([HEAD, about, "", *lines]).rstrip() + "\n"


def marks_table(found: Sequence[Mark]) -> list[str]:
    """The lines of the table of marks."""
    rows = [
        (m.row, m.what, m.required, m.text, "-" if m.baseline is None else f"{100.0 * m.baseline:.1f} %", _met(m))
        for m in found
    ]
    return table(("condition", "mark", "required", "reached", "always the most frequent class", ""), rows)


def _met(mark: Mark) -> str:
    few = f", as it has fewer than {mark.least} records" if mark.records < mark.least else ""
    return "met" if mark.met else f"**missed**{few}"


def _marks(found: Sequence[Mark]) -> list[str]:
    met = sum(mark.met for mark in found)
    words = (
        f"{met} of {len(found)} are met. Rows of measured streams are no traces: they are answers of"
        " `biodyn check-sensors` to streams with inserted faults, made after the run and not sealed."
    )
    return ["## Marks", "", words, "", *marks_table(found), ""]


def _verdicts(outcomes: Sequence[Outcome]) -> list[str]:
    counted = verdicts(outcomes)
    names = sorted({name for one in counted.values() for name in one})
    rows = [(row, *(str(one[name]) for name in names)) for row, one in counted.items()]
    return ["## Verdicts", "", *table(("drawn as", *names), rows), ""]


def _errors(outcomes: Sequence[Outcome]) -> list[str]:
    """Medians of the held-out errors, in percent."""
    rows = []
    for drawing in DRAWINGS:
        scores = [one.score for one in outcomes if one.answer.row == drawing.name and one.score.ratio is not None]
        if scores:
            ratio = float(np.median([score.ratio for score in scores if score.ratio is not None]))
            beside = [one for one in scores if one.oracle_percent is not None]
            after = [one.before_percent if one.after_percent is None else one.after_percent for one in scores]
            rows.append((
                drawing.name, f"{ratio:.2f}", str(len(scores)), _median_of(scores, "floor"),
                _median_of(scores, "before"), _median(after), _median_of(scores, "generic"), str(len(beside)),
                _median_of(beside, "before"), _median_of(beside, "oracle"), _median_of(beside, "placebo"),
            ))  # fmt: skip
    words = (
        "Held-out errors in percent, medians. Floor: the base refit of the same record without the effect. Before: the"
        f" base refit. Placebo, in the first {PLACEBOS} records: the median wrong class with as many parameters."
        " Generic: a ridge FIR of the residual on the seat. Oracle: the true class and site, refitted from the"
        " catalogue. Placebo and oracle are refitted where the ratio is above 0.8, or without a background: the second"
        " number of records, which the columns after it are of. A record without an answer has the error before as that"
        " after."
    )
    # A record without a refit has no ratio and no row, so the page lists it.
    without = [f"{one.score.row} {one.score.number}: {one.score.why}" for one in outcomes if one.score.why]
    not_scored = f"Failed refits (without a ratio, a record is in no row by ratio): {'; '.join(without) or 'none'}."
    head = (
        "drawn as", "ratio", "records", "floor", "before", "after", "generic", "with an oracle", "before", "oracle",
        "placebo",
    )  # fmt: skip
    return ["## Errors", "", words, "", *table(head, rows), "", not_scored, ""]


def _true_classes(outcomes: Sequence[Outcome], row: Condition) -> list[str]:
    """The results for the true classes of a row."""
    counted = true_class_results(row.chosen(outcomes))
    words = (
        "In the records of the first column the oracle, the true class at the true site refitted, removes at least half"
        " of the squared error before beyond the squared floor. Records below a ratio of 0.8 have no oracle."
    )
    rows = [(what, *map(str, counts)) for what, counts in counted.items()]
    rows.append(("all", *(str(sum(column)) for column in zip(*counted.values(), strict=True))))
    head = ("the true class", "the oracle removes half", "with an oracle", "records")
    return [f"## Result for the true class: {row.name}", "", words, "", *table(head, rows), ""]


def _median_of(scores: Sequence[Score], name: str) -> str:
    return _median([getattr(score, f"{name}_percent") for score in scores])


def _median(values: Sequence[float | None]) -> str:
    there = [value for value in values if value is not None]
    return f"{np.median(there):.2f}" if there else "-"


def _asks_for_class(row: Condition) -> bool:
    return any(rule.what == "class" for rule in row.rules)


def _classes(outcomes: Sequence[Outcome], row: Condition) -> list[str]:
    """Results by class with the answers, as a matrix or as a list; nothing without records."""
    chosen = row.chosen(outcomes)
    classes = by_class(chosen)
    if not classes:
        return []
    matrix = confusion_lines(chosen) if _asks_for_class(row) else []
    rows = [
        (
            one.name, str(one.records), str(one.class_right), str(one.family_right), str(one.site_right),
            str(one.in_set), ", ".join(f"{name} {count}" for name, count in one.named),
        )
        for one in classes
    ]  # fmt: skip
    name, share = most_frequent(chosen)
    words = f"Naming always {name} is right in {100.0 * share:.1f} %."
    head = ("true class", "records", "class", "family", "class and site", "in the set", "named")
    shown = len(head) - bool(matrix)
    listed = table(head[:shown], [one[:shown] for one in rows])
    return [f"## By class: {row.name}", "", words, "", *listed, "", *matrix]
