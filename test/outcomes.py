"""Outcomes of blind traces for tests: answer, truth and score."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from blind.tracing.outcome import Answer, Cause, Outcome, Score
from blind.tracing.rows import CONDITIONS, MEASURED

ROWS = {row.name: row for row in (*CONDITIONS, *MEASURED)}
SKIN = Cause("skin", "head", "sensor")
CLOCK = Cause("clock", "head", "sensor")
STOP = Cause("stop", "pelvis", "stiffening")


def outcome(
    row: str, verdict: str, effects: Sequence[Cause] = (), true: Sequence[Cause] = (), beside: Sequence[Cause] = (),
    number: int = 0, applied: bool = True, **score: Any,
) -> Outcome:  # fmt: skip
    added = ({"name": effects[0].name},) if effects and applied else ()
    answer = Answer(row, number, verdict, tuple(effects), tuple(beside), applied=added)
    return Outcome(answer, Score(row, number, tuple(true), **score))
