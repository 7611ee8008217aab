"""Verdict of a trace from the probabilities of its first round, and the reasons."""

from __future__ import annotations

from collections.abc import Iterator

from biodyn_core.base.wording import probability_text
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.findings import Round, Verdict
from biodyn_core.tracing.probability import NONE, OUTSIDE

WORDS = {NONE: "nothing visible is missing", OUTSIDE: "an effect outside the catalogue"}


def verdict_of(first: Round, named_from: float) -> Verdict:
    """`effect` if one mechanism has at least this probability, else what the most probable answer says."""
    if first.best == NONE:
        return "none"
    if first.best == OUTSIDE:
        return "unexplained"
    return "effect" if first.answers[first.best] >= named_from else "ambiguous"


def reasons_of(first: Round, named_from: float) -> tuple[str, ...]:
    """The reasons of a verdict, a line each."""
    return (f"most probable: {in_words(first.best)}; {named_from:g} is required to name one cause", *_of_chosen(first))


def in_words(answer: str) -> str:
    """An answer in words."""
    return WORDS.get(answer, answer.replace("_", " "))


def _of_chosen(first: Round) -> Iterator[str]:
    best = first.chosen
    if best is None:
        return
    where = "in events that its size was not fitted to"
    if not best.steady and not best.applied.effect.sized_by_training:
        where = "in events that it was fitted to"
    yield f"{named(best.applied)}: probability {probability_text(best.probability)}, gain {best.gain:.2f} {where}"
    sites = [one for one in first.rivals if one.applied.effect.mechanism == best.applied.effect.mechanism]
    if sites:
        yield f"other sites: {', '.join(f'{named(one.applied)} {probability_text(one.probability)}' for one in sites)}"
    yield from (f"{named(best.applied)}: {remark}" for remark in best.remarks)


def named(applied: AppliedEffect) -> str:
    """An effect and its site in words."""
    return f"{applied.effect.name} at {applied.site}"
