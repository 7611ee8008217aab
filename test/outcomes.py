"""Outcomes of blind traces for tests: answer, truth and score."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from blind.tracing.outcome import Answer, Cause, Outcome, Score
from blind.tracing.rows import CONDITIONS, MEASURED

ROWS = {row.name: row for row in (*CONDITIONS, *MEASURED)}
WITHOUT_CAUSE = {"none": "none", "unexplained": "outside"}
SKIN = Cause("skin", "head", "sensor")
CLOCK = Cause("clock", "head", "sensor")
STOP = Cause("stop", "pelvis", "stiffening")


def outcome(
    row: str, verdict: str, effects: Sequence[Cause] = (), true: Sequence[Cause] = (), beside: Sequence[Cause] = (),
    number: int = 0, p: float = 0.9, **score: Any,
) -> Outcome:  # fmt: skip
    """An answer whose most probable answer has probability p; its 90 % set has all that it names, or that answer."""
    added = ({"name": effects[0].name},) if effects else ()
    likely = tuple(dict.fromkeys(one.mechanism for one in (*effects, *beside)))
    if verdict in WITHOUT_CAUSE:
        likely = (WITHOUT_CAUSE[verdict],)
    probabilities = {likely[0]: p, "other": 1.0 - p} if likely else {}
    answer = Answer(
        row, number, verdict, tuple(effects), tuple(beside), applied=added, probabilities=probabilities, likely=likely
    )
    return Outcome(answer, Score(row, number, tuple(true), **score))
