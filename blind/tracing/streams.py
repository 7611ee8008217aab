"""The row of effects hidden in measured streams: the records of `blind.measured` as outcomes of this study."""

from __future__ import annotations

from typing import Final

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.findings import NAMING
from blind import measured
from blind.tracing.outcome import Answer, Cause, Outcome, Score

RECORDS: Final = 290
NOTHING: Final = "none"


def outcomes(seed: int, count: int = RECORDS) -> list[Outcome]:
    """Run that row."""
    return [outcome(number, one) for number, one in enumerate(measured.run(count, seed))]


def outcome(number: int, checked: measured.CheckedRecord) -> Outcome:
    """One record: `found` with verdict, name and ambiguous_with, the `fault` that was hidden, and its `ratio`."""
    found, hidden = checked.found, checked.fault != NOTHING
    row = "measured" if hidden else "measured_nothing"
    named = (cause(found.name),) if found.verdict in NAMING and found.name else ()
    beside = tuple(cause(name) for name in found.ambiguous_with)
    true = (cause(checked.fault),) if hidden else ()
    return Outcome(
        Answer(row, number, found.verdict, named, beside, likely=tuple(one.mechanism for one in (*named, *beside))),
        Score(row, number, true, ratio=float(checked.ratio) if hidden else None),
    )


def cause(name: str) -> Cause:
    """A fault by its class; its site is known."""
    return Cause(name, "", CATALOGUE[name].family if name in CATALOGUE else name)
