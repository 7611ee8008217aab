"""A subject, answers and scores of a few records, and runs of them one after the other, for tests of blind runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from outcomes import SKIN

from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from blind.tracing.outcome import Answer, Score
from blind.tracing.rows import Drawing
from blind.tracing.study import Call

SUBJECT = Subject("blind", 70.0, 1.75, "segment", Parameters.from_vector(0.5 * (LOWER + UPPER)))
FEW = (Drawing("nothing", 2, effects=0), Drawing("strong", 3))


def an_answer(drawing: Drawing, number: int) -> Answer:
    return Answer(drawing.name, number, "effect", (SKIN,), (), (1.0,) * 15, (2.0,) * 15, ({"name": "skin"},), 2.0, 1.0)


def a_score(drawing: Drawing, answer: Answer) -> Score:
    ratio = {"medium": 0.5, "weak": 0.2}.get(drawing.name, 1.5)
    return Score(drawing.name, answer.number, (SKIN,), ratio=ratio, recovered=0.5)


def answers(drawing: Drawing, numbers: Sequence[int], seed: int, split: str) -> list[Answer]:
    return [an_answer(drawing, number) for number in numbers]


def scores(drawing: Drawing, given: Sequence[Answer], seed: int, split: str) -> list[Score]:
    return [a_score(drawing, answer) for answer in given]


def in_sequence(calls: Sequence[Call]) -> Iterator[Any]:
    """Execute calls one after the other."""
    for function, arguments in calls:
        yield from function(*arguments)
