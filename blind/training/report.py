"""The page of a learned model: how often its answers are right for bodies that it was not learned from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.tracing.probability import NONE, OUTSIDE, LearnedModel
from blind.tracing.reliability import Confidence, bin_table, calibration_error
from blind.tracing.shares import share_text
from blind.training.calibrate import Learned, Prediction
from blind.training.recordings import AMOUNTS, Answers
from conformance.table import cells

STRONG: Final = 0.8
WEAK: Final = 0.4
RATIOS: Final = (0.4, 0.8, 1.5, 3.0, 6.0)
"""Limits of the rows of the ceiling."""

HEAD: Final = """\
# The learned model of tracing

Made by `make train`. Do not edit.

`biodyn trace` turns the evidence of all candidates into probabilities by a model that was learned from simulated
bodies (`test/world`). This page shows its answers to bodies in cross-validation: no body has a form of a hidden effect
that its model was learned from. The ridge, the precision of an effect's own weights, the weight of examples without
their mechanism, the temperature and the limit of the 90 % set were chosen on these same answers. So the figures are
optimistic. The blind study ([tracing_study.md](tracing_study.md)) uses further
forms.

Nothing hidden still leaves a background of several kinds of mechanisms. No kind has more than 40 % of the squares
before the refit of theta. The refit absorbs some kinds more than others, so one kind may dominate the residual. The
wrong name of such a body may be the mechanism of that kind.
"""


@dataclass(frozen=True)
class Group:
    """Bodies of one row of the table."""

    name: str
    holds: Callable[[Prediction], bool]


def _single(low: float, high: float, background: bool | None) -> Callable[[Prediction], bool]:
    def holds(one: Prediction) -> bool:
        of = one.labelled
        right_ground = background is None or bool(of.background) == background
        return len(of.forms) == 1 and bool(of.mechanism) and low < of.ratio <= high and right_ground

    return holds


GROUPS: Final = (
    Group("nothing hidden, no background", lambda one: not one.labelled.forms and not one.labelled.background),
    Group("nothing hidden, with a background", lambda one: not one.labelled.forms and bool(one.labelled.background)),
    Group("one effect, no background, ratio > 0.3", _single(0.3, np.inf, False)),
    Group("one effect, with a background, ratio > 0.8", _single(STRONG, np.inf, True)),
    Group("one effect, with a background, ratio 0.4 to 0.8", _single(WEAK, STRONG, True)),
    Group("one effect, ratio < 0.4", _single(0.0, WEAK, None)),
    Group(
        "outside the catalogue, ratio > 0.8",
        lambda one: bool(one.labelled.forms) and not one.labelled.mechanism and one.labelled.ratio > STRONG,
    ),
    Group("two effects", lambda one: len(one.labelled.forms) == 2),
    Group("all, those of no other row included", lambda one: True),
)


def rendered(learned: Learned, named_from: float, more: Sequence[str]) -> str:
    """The whole page; more: lines of further sections, after the groups."""
    model, found = learned.model, learned.found
    lines = [
        HEAD,
        *_provenance(model),
        *_scores(model, found, named_from),
        *_groups(model, found, named_from),
        *more,
        *_reliability(found),
        *_confusion(found),
    ]
    return "\n".join(lines).rstrip() + "\n"


def background_lines(found: Mapping[str, Sequence[Prediction]], named_from: float) -> list[str]:
    """The table of kinds of background; found: answers by models that were learned without that kind."""
    rows = [
        cells(kind, str(len(mine)), share_text(sum(one.names(named_from) for one in mine), len(mine)))
        for kind, mine in found.items()
    ]
    words = (
        "Each kind of background is left out in turn: the model is learned from bodies without it, and answers those"
        " that have it and nothing hidden."
    )
    head = ("kind", "bodies with nothing hidden", "a cause named")
    return ["## Backgrounds of a kind that was not learned", "", words, "", *table(head, rows), ""]


def recordings_lines(found: Mapping[str, Answers], named_from: float) -> list[str]:
    """The table of further recordings; found: the answers by the names of `AMOUNTS`."""
    ratios = [one.labelled.ratio for one in found[AMOUNTS[0].name].catalogue]
    rows = []
    for low, high in zip(RATIOS[:3], (*RATIOS[1:3], np.inf), strict=True):
        mine = [i for i, ratio in enumerate(ratios) if low < ratio <= high]
        for amount in AMOUNTS if mine else ():
            of = found[amount.name]
            each = [[every[i] for i in mine] for every in (of.catalogue, of.true_law, of.learned)]
            named, right = [_named_right(one, named_from) for one in each], [_best_right(one) for one in each]
            sure = [f"{np.mean([one.p_right for one in answers]):.2f}" for answers in each]
            rows.append(cells(f"{_span(low, high)}: {amount.words}", str(len(mine)), *named, *right, *sure))
    words = (
        "Each body has one effect of the catalogue and a background. All its recordings come from one sitting, of which"
        " a part is traced. Events for fitting and held-out events grow alike. The ratio is that of the least data."
        " None of these bodies was learned from, but bodies with the same forms of laws were."
    )
    head = ("ratio: recordings", "bodies", *_beside_true_law("right cause named", "most probable answer right",
            "mean probability of the right answer"))  # fmt: skip
    return ["## Further recordings", "", words, "", *table(head, rows), ""] if rows else []


def _beside_true_law(*names: str) -> Sequence[str]:
    """Each name followed by those of the same with the true law, and by a decision that was learned with it."""
    return [text for name in names for text in (name, "with the true law", "... and learned with it")]


def _span(low: float, high: float) -> str:
    return f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}"


def _provenance(model: LearnedModel) -> list[str]:
    return ["## Origin", "", *(f"- {name}: {value}" for name, value in model.provenance.items()), ""]


def _scores(model: LearnedModel, found: Sequence[Prediction], named_from: float) -> list[str]:
    sure = [one for one in found if one.p >= named_from]
    right = sum(one.best in one.right for one in sure)
    covered = sum(bool(set(one.likely(model.set_threshold)) & set(one.right)) for one in found)
    loss = -np.mean([np.log(max(one.p_of_right, 1e-300)) for one in found])
    return [
        "## Calibration", "",
        f"- Expected calibration error: {calibration_error(_confidences(found)):.3f}.",
        f"- Answers with a probability of {named_from:g} and more: {share_text(right, len(sure))} are right.",
        f"- The 90 % set has a right answer in {share_text(covered, len(found))}.",
        f"- Its mean size is {np.mean([len(one.likely(model.set_threshold)) for one in found]):.2f}.",
        f"- Mean negative log probability of the right answers: {loss:.3f}.",
        *(
            f"- Named of bodies with a background and a ratio within half an octave of {one.ratio:g}:"
            f" {share_text(one.named, one.bodies)}, {one.named} of {one.bodies}."
            for one in model.named
        ),
        "",
    ]  # fmt: skip


def _named_right(found: Sequence[Prediction], named_from: float) -> str:
    return share_text(sum(one.names_right(named_from) for one in found), len(found))


def _best_right(found: Sequence[Prediction]) -> str:
    return share_text(sum(one.best in one.right for one in found), len(found))


def group_rows(found: Sequence[Prediction], threshold: float, named_from: float) -> list[str]:
    """A row of the table for each group with bodies."""
    rows = []
    for group in GROUPS:
        mine = [one for one in found if group.holds(one)]
        if mine:
            n = len(mine)
            rows.append(cells(
                group.name, str(n), _named_right(mine, named_from),
                share_text(sum(one.names(named_from) and not one.names_right(named_from) for one in mine), n),
                _best_right(mine),
                share_text(sum(bool(set(one.likely(threshold)) & set(one.right)) for one in mine), n),
                f"{np.mean([len(one.likely(threshold)) for one in mine]):.2f}",
            ))  # fmt: skip
    return rows


HEADER: Final = (
    "bodies", "number", "right cause named", "wrong cause named", "most probable answer right", "in the 90 % set",
    "size of the set",
)  # fmt: skip


def _groups(model: LearnedModel, found: Sequence[Prediction], named_from: float) -> list[str]:
    words = (
        "A cause is named from a probability of"
        f" {named_from:g}. Right answers: the hidden mechanisms, `{OUTSIDE}` for an effect of no class, `{NONE}` for"
        " nothing and for ratios below 0.3. Of two effects one suffices. Intervals are Wilson's, 95 %."
    )
    return [
        "## Answers by group",
        "",
        words,
        "",
        *table(HEADER, group_rows(found, model.set_threshold, named_from)),
        "",
    ]


def ceiling_lines(
    found: Sequence[Prediction], ceilings: Sequence[Sequence[Prediction]], named_from: float
) -> list[str]:  # fmt: skip
    """The answers with the catalogue's laws beside those with true laws, by ratio.

    found: with the catalogue's laws; ceilings: with true laws, by the same decision and by one learned with them.
    """
    by_number = [{one.labelled.number: one for one in every} for every in (found, *ceilings)]
    numbers = [n for n in by_number[1] if all(n in one for one in by_number) and by_number[1][n].labelled.background]
    rows = []
    for low, high in zip(RATIOS, (*RATIOS[1:], np.inf), strict=True):
        mine = [n for n in numbers if low < by_number[1][n].labelled.ratio <= high]
        each = [[one[n] for n in mine] for one in by_number]
        named, right = [_named_right(one, named_from) for one in each], [_best_right(one) for one in each]
        rows.append(cells(_span(low, high), str(len(mine)), *named, *right))
    words = (
        "The ceiling: the same models answer the same bodies, those with one effect of the catalogue and a background,"
        " as if the catalogue had the true law. It predicts exactly what the effect changes, which no fit does: models"
        " that were learned from fits may name it less often. The third figure is of models that were learned with true"
        " laws too, without the features in which a true law is unlike a fit. What they miss, better laws alone would"
        " not name."
    )
    head = ("ratio", "bodies", *_beside_true_law("right cause named", "most probable answer right"))
    return ["## The true law in the catalogue", "", words, "", *table(head, rows), ""]


def table(head: Sequence[str], rows: Sequence[str]) -> list[str]:
    """The lines of a table."""
    return [cells(*head), cells("---", *["---:"] * (len(head) - 1)), *rows]


def _confidences(found: Sequence[Prediction]) -> list[Confidence]:
    return [(one.p, one.best in one.right) for one in found]


def _reliability(found: Sequence[Prediction]) -> list[str]:
    """Confidence and share of right answers by tenths of the probability of the most probable answer."""
    return ["## Reliability", "", *bin_table(_confidences(found), "bodies"), ""]


def _confusion(found: Sequence[Prediction]) -> list[str]:
    """The most probable answers by true mechanism, for ratios above `STRONG`."""
    groups: dict[str, list[Prediction]] = {}
    for one in found:
        of = one.labelled
        if len(of.forms) == 1 and of.ratio > STRONG:
            groups.setdefault(of.mechanism or OUTSIDE, []).append(one)
        elif not of.forms:
            groups.setdefault(NONE, []).append(one)
    rows = []
    for name, mine in sorted(groups.items()):
        counts = Counter(one.best for one in mine).most_common()
        rows.append(cells(name, str(len(mine)), ", ".join(f"{best} {count}" for best, count in counts)))
    return [
        f"## Most probable answer by truth, ratio > {STRONG:g}",
        "",
        *table(("truth", "bodies", "answers"), rows),
        "",
    ]
