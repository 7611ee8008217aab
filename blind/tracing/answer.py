"""Answers: the only module that calls the tracer."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.findings import Trace
from biodyn_core.tracing.probability import learned_text, packaged
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.trace import trace
from blind.tracing.outcome import FAILED, Answer, Cause
from blind.tracing.records import Record

Tracer = Callable[[Record], Trace]

TRACE_SEED: Final = 0


def traced(known: Record) -> Trace:
    """The trace of a record by the package, with default settings."""
    return trace(known.train, known.held_out, known.subject, TraceSettings(), TRACE_SEED)


def decision() -> str:
    """A hash of all that decides: the default settings and the learned model."""
    text = repr(dataclasses.asdict(TraceSettings())) + learned_text(packaged())
    return hashlib.sha256(text.encode()).hexdigest()


def answered(row: str, number: int, known: Record, tracer: Tracer = traced) -> Answer:
    """The tracer's answer as plain data."""
    begin = time.process_time()  # what else runs on the machine, and pauses, do not count
    try:
        found = tracer(known)
    except InputError as error:
        return _without(row, number, begin, "not_decidable", str(error))
    except Exception as error:  # noqa: BLE001 - one failing record counts as wrong and does not stop the run
        return _without(row, number, begin, FAILED, f"{type(error).__name__}: {error}")
    held_out = [event for event in found.events if event.use == "held_out"]
    before, after = (
        float(np.mean([getattr(event, side).mean_percent for event in held_out])) if held_out else None
        for side in ("before", "after")
    )
    first = found.rounds[0] if found.rounds else None
    return Answer(
        row, number, found.verdict,
        effects=_causes(found.effects),
        ambiguous_with=_causes(found.ambiguous_with),
        before=tuple(found.before.parameters.vector().tolist()),
        after=tuple(found.after.parameters.vector().tolist()),
        applied=tuple(one.to_dict() for one in found.after.effects),
        unseen=tuple(event.name for event in held_out),
        before_percent=before,
        after_percent=after,
        p_value=found.p_value,
        seconds=time.process_time() - begin,
        why="; ".join([*found.reasons, *known.left_out]),
        probabilities={name: float(f"{p:.4g}") for name, p in first.answers.items()} if first else {},
        likely=first.likely if first else (),
    )  # fmt: skip


def _without(row: str, number: int, begin: float, verdict: str, why: str) -> Answer:
    return Answer(row, number, verdict, seconds=time.process_time() - begin, why=" ".join(why.split()))


def _causes(effects: Iterable[AppliedEffect]) -> tuple[Cause, ...]:
    return tuple(Cause(one.effect.name, one.site, one.effect.family) for one in effects)
