"""The ceiling of a record: the answer as if the catalogue had the true law, by a decision that is learned so.

The decision of the package is learned from fits of laws that are not the true ones. A true law, which predicts exactly
and has no parameters, is unlike such fits, so that decision may name it less often than its fit.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

from biodyn_core.body.subject import Subject
from biodyn_core.tracing import data_checks
from biodyn_core.tracing.probability import LearnedModel, Probabilities, learned_from, probabilities
from biodyn_core.tracing.rounds import search
from biodyn_core.tracing.settings import TraceSettings
from blind.tracing.answer import TRACE_SEED
from blind.tracing.outcome import Cause
from blind.tracing.records import Record
from blind.tracing.true_law import with_true_law

LEARNED: Final = Path(__file__).with_name("learned_with_true_laws.json")
"""The decision, written by `make train`: learned from the same bodies, as if the catalogue had the law of each."""


@cache
def decision_with_true_laws() -> LearnedModel:
    """The stored decision of ceilings."""
    return learned_from(LEARNED.read_text(encoding="utf-8"), str(LEARNED))


def ceiling(hidden: Record, before: Subject, cause: Cause, plain: Record, without: Subject) -> Probabilities | None:
    """The probabilities of the first round with the true law; None if the cause is no candidate.

    before: the subject of the answer before its first round. plain: the record without the effect; without: the subject
    refitted to it. Raises InputError if the record cannot be fitted.
    """
    s = TraceSettings()
    train, held_out, _ = data_checks.usable(hidden.train, hidden.held_out, s.floor)
    choose, _ = data_checks.split_held_out(held_out)
    found = search(before, train, choose, s, TRACE_SEED, lambda stage, share: None)
    bent = with_true_law(found, cause, without, plain.cases)
    return None if bent is None else probabilities(bent.evidence(s, bent.diagnostics(s)), decision_with_true_laws())
