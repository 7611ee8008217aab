"""The ceiling of a record: the answer of the same decision as if the catalogue had the true law."""

from __future__ import annotations

from biodyn_core.body.subject import Subject
from biodyn_core.tracing import data_checks
from biodyn_core.tracing.probability import Probabilities, probabilities
from biodyn_core.tracing.rounds import search
from biodyn_core.tracing.settings import TraceSettings
from blind.tracing.answer import TRACE_SEED
from blind.tracing.outcome import Cause
from blind.tracing.records import Record
from blind.tracing.true_law import with_true_law


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
    return None if bent is None else probabilities(bent.evidence(s, bent.diagnostics(s)))
