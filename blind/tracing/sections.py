"""Sections of the page on probabilities and time: reliability, accuracy against the ratio, confusion, and speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter, methodcaller
from typing import Final

import numpy as np

from biodyn_core.tracing.probability import NONE, OUTSIDE
from blind.tracing.curves import MEASURES, Curve, curves
from blind.tracing.marks import NO_ANSWER, Mark, confusion
from blind.tracing.outcome import LEAST_RATIO, Outcome
from blind.tracing.pictures import BY_RATIO, RELIABILITY, ratio_picture, reliability_picture
from blind.tracing.reliability import Confidence, bin_table, calibration_error, error_by_chance
from blind.tracing.rows import (
    BY_PROBABILITY,
    CONDITIONS,
    DRAWINGS,
    LONG_S,
    MEDIAN_S,
    NOTHING_HIDDEN,
    STRONG,
    SURE,
    WEAK,
)
from blind.tracing.shares import share_text
from conformance.table import table

WITHOUT: Final = ("This run has no probabilities.", "")

CEILINGS: Final[Mapping[str, Callable[[Outcome], bool]]] = {
    "class": methodcaller("named_with_true_law", SURE),
    "in the 90 % set": attrgetter("in_set_with_true_law"),
    "one right": lambda one: one.named_alone(SURE) > 0,
    "both found": lambda one: one.named_alone(SURE) == len(one.score.causes),
}
"""By mark: whether a record reaches it with the true law in the catalogue."""


def pictures(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """The pictures of the page by file name, as SVG; none without probabilities."""
    answers, groups = _confidences(outcomes), curves(outcomes)
    found = {RELIABILITY: reliability_picture(answers)} if answers else {}
    return {**found, BY_RATIO: ratio_picture(groups)} if groups else found


def _confidences(outcomes: Sequence[Outcome]) -> list[Confidence]:
    every = (one.confidence for one in outcomes if one.answer.row in BY_PROBABILITY)
    return [one for one in every if one is not None]


def reliability_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """How often answers of each probability are right."""
    title, answers = ["## Reliability", ""], _confidences(outcomes)
    if not answers:
        return [*title, *WITHOUT]
    silent = sum(one.answer.row in BY_PROBABILITY for one in outcomes) - len(answers)
    median, most = error_by_chance(answers)
    words = (
        "The most probable answers to records with at most one hidden effect, by tenths of their probability. Right"
        f" are the true class, `{OUTSIDE}` for an effect of no class, and `{NONE}` for nothing hidden or a ratio below"
        f" {LEAST_RATIO:g}. Further {silent} records have no answer. The expected calibration error is"
        f" {calibration_error(answers):.3f}. Perfectly calibrated answers with these probabilities have {median:.3f} by"
        f" chance (median), and less than {most:.3f} in 95 % of such runs."
    )
    alt = "Reliability diagram: share of right answers against the probability of the most probable answer"
    return [*title, words, "", *_picture(alt, RELIABILITY), *bin_table(answers, "records"), ""]


def ceiling_lines(outcomes: Sequence[Outcome], found: Sequence[Mark]) -> list[str]:
    """The marks for the class beside those with the true law in the catalogue; nothing without such records."""
    rows, covered = [], set()
    for row in CONDITIONS:
        mine = row.chosen(outcomes)
        without = sum(not (one.score.ceiling or one.score.ceilings_alone) for one in mine)
        if without == len(mine):
            continue
        for rule in row.rules:
            if rule.what in CEILINGS:
                reached, ideal = (int(sum(map(of, mine))) for of in (rule.of, CEILINGS[rule.what]))
                shares = (share_text(count, len(mine)) for count in (reached, ideal))
                rows.append((row.name, rule.what, rule.required, *shares, str(without)))
                covered.add((row.name, rule.what))
    if not rows:
        return []
    words = (
        "What a decision reaches in the same records as if the catalogue had the true law, which predicts exactly what"
        " the effect changes. This decision is learned as that of the package is, from the same bodies, but with the"
        " true law of each ([page](tracing_learned.md#the-true-law-in-the-catalogue)). Records without a ceiling count"
        " as missed with the true law: their trace failed, or the true effect was no candidate. Of two effects, each is"
        " named in the same record without the other, so the ceiling is that of a decision that separates them exactly."
        " Whether other recordings would lift a ceiling is in [tracing.md](tracing.md#how-far-to-believe-a-verdict)."
    )
    others = [f"{one.row}: {one.what}" for one in found if not one.met and (one.row, one.what) not in covered]
    missed = f"Missed marks that have no ceiling: {'; '.join(others) or 'none'}."
    head = ("condition", "mark", "required", "reached", "with the true law", "without a ceiling")
    return ["## Ceiling", "", words, "", *table(head, rows), "", missed, ""]


def own_law_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """Causes that are named where nothing is hidden, with the body's own law of that class; nothing without any."""
    named = [one for one in outcomes if one.answer.row in NOTHING_HIDDEN and one.single]
    if not named:
        return []
    words = (
        "The background of a body has laws of its joints and errors of its sensors too. The last column is the ratio"
        " of its own law of the named class at the named site: both bodies, with and without this law, are refitted."
        f" Above {STRONG:g} the name is wrong by the marks, but it describes the body. A dash: the body has no such law"
        " of the paper's background, or it was not refitted."
    )
    rows = []
    for one in named:
        first, own = one.answer.effects[0], one.score.own_ratio
        where = f"{first.name} at {first.site}" if first.site else first.name
        ratio = "-" if own is None else f"{own:.2f}"
        rows.append((f"{one.answer.row} {one.answer.number}", where, f"{one.probability:.2f}", ratio))
    head = ("record", "named", "probability", "ratio of its own law")
    return ["## Causes named where nothing is hidden", "", words, "", *table(head, rows), ""]


def ratio_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """How often an effect is named, most probable, or in the 90 % set, against its ratio."""
    title, groups = ["## Accuracy against ratio", ""], curves(outcomes)
    if not groups:
        return [*title, *WITHOUT]
    words = (
        "Records with one hidden effect of the catalogue, in octaves of its ratio: the share with its interval, and"
        " beside it a logistic curve at the mean ratio of the bin, with its 95 % band. The curve is fitted to the"
        " single records with Firth's penalty. Its log odds are linear in the logarithm of the ratio: where it leaves"
        " the interval of a bin, believe the bin. A record without an answer counts as a miss. In the picture each"
        " point is a bin, each stroke a record (above a hit, below a miss), and the dotted lines are the limits of the"
        f" marks, {WEAK:g} and {STRONG:g}."
    )
    alt = f"Shares of records against the ratio of the hidden effect: {', '.join(MEASURES)}"
    tables = [line for name, found in groups.items() for line in _ratio_table(name, found)]
    return [*title, words, "", *_picture(alt, BY_RATIO), *tables]


def _ratio_table(group: str, found: Sequence[Curve]) -> list[str]:
    head = (f"ratio, {group}", "records", *(text for one in found for text in (one.measure, "curve")))
    columns = zip(*(one.rows for one in found), strict=True)
    rows = [
        (one.text, str(one.records), *(text for pair in pairs for text in pair))
        for one, pairs in zip(found[0].bins, columns, strict=True)
    ]
    return [*table(head, rows), ""]


def confusion_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """The matrix of true class and most probable answer; nothing without probabilities."""
    counts = confusion(outcomes)
    answers = {answer for one in counts.values() for answer in one}
    if answers <= {NO_ANSWER}:
        return []
    others = [name for name in (NONE, OUTSIDE, NO_ANSWER) if name in answers]
    classes = sorted({*counts, *answers}.difference(others))
    numbers = {name: str(number) for number, name in enumerate(classes, 1)}

    def cell(true: str, answer: str) -> str:
        count = counts[true][answer] if true in counts else 0
        return "" if not count else f"**{count}**" if true == answer else str(count)

    rows = [(f"{numbers[true]} {true}", *(cell(true, one) for one in (*classes, *others))) for true in classes]
    words = (
        "Records by true class (rows) and most probable answer (columns, numbered as the rows); right answers are bold."
    )
    return [words, "", *table(("true class", *numbers.values(), *others), rows), ""]


def speed_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """How much processor time a trace takes; nothing without records."""
    names = {one.name for one in DRAWINGS}
    seconds = [one.answer.seconds for one in outcomes if one.answer.row in names]
    if not seconds:
        return []
    median, late = np.quantile(seconds, (0.5, 0.95))
    words = (
        f"{len(seconds)} traces, also those without a verdict: median {median:.1f} s, 95th percentile {late:.1f} s,"
        f" longest {max(seconds):.1f} s. Required are a median of at most {MEDIAN_S:g} s, and 95 % below {LONG_S:g} s."
        " This is the processor time of one trace by the package on the machine above, with the loading of kernels in"
        " the first one of each process, and without the simulation of the record. On one idle core it is the duration;"
        " `biodyn trace` distributes one trace over all cores, and takes less."
    )
    return ["## Speed", "", words, ""]


def _picture(alt: str, name: str) -> list[str]:
    return [f"![{alt}](pictures/{name})", ""]
