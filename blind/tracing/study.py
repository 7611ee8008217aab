"""Runs the study: every record traced and its verdict kept at once, all of them sealed, and only then truths drawn."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from world.effects.draw import Split

from biodyn_ros.executors import as_done, executor_of, result_of
from blind.tracing.answer import Tracer, answered, traced
from blind.tracing.outcome import FAILED, Answer, Outcome, Score, line_of
from blind.tracing.records import record, sitting
from blind.tracing.rows import Drawing
from blind.tracing.score import scored

T = TypeVar("T", Answer, Score)
Say = Callable[[str], None]
Call = tuple[Callable[..., Any], tuple[Any, ...]]
Doing = Callable[[Sequence[Call]], Iterator[Any]]
"""Does calls in any order and gives their results as they come."""

ANSWERS: Final = "answers.jsonl"
SEAL: Final = "answers.sha256"
SCORES: Final = "scores.jsonl"
PLAN: Final = "plan.json"
PROCESSES: Final = 2


class BrokenSeal(RuntimeError):
    """What was found in the folder of a run is not what this run would go on from; told in one line."""


class Answering(Protocol):
    """Draws one record and asks for an answer to it."""

    def __call__(self, drawing: Drawing, number: int, seed: int, split: Split) -> Answer:
        """Answer one record; nothing of its truth is in the answer."""


class Scoring(Protocol):
    """Draws one record again, truth and all, and scores the answer to it."""

    def __call__(self, drawing: Drawing, answer: Answer, seed: int, split: Split) -> Score:
        """Score one answer."""


@dataclass(frozen=True)
class Run:
    """One run: its seed, what is drawn from which split, the commit it is of, and where it writes."""

    seed: int
    drawings: tuple[Drawing, ...]
    folder: Path
    split: Split = "blind"
    commit: str = ""

    @property
    def tasks(self) -> list[tuple[Drawing, int]]:
        """Every record."""
        return [(drawing, number) for drawing in self.drawings for number in range(drawing.count)]

    @property
    def plan(self) -> str:
        """All that must not change while a run goes on."""
        rows = {drawing.name: drawing.count for drawing in self.drawings}
        return json.dumps({"seed": self.seed, "split": self.split, "commit": self.commit, "rows": rows}) + "\n"


def run(
    what: Run,
    doing: Doing,
    answer: Answering | None = None,
    score: Scoring | None = None,
    say: Say = lambda text: None,
) -> list[Outcome]:
    """Go through a whole run, from where it was interrupted; raises BrokenSeal where that is not possible."""
    begin(what)
    answers = all_answers(what, doing, answer or answer_record, say)
    say(f"{len(answers)} answers are sealed: sha256 {seal(what)}")
    # Truths are drawn from here on, and not before.
    scores = all_scores(what, answers, doing, score or score_record, say)
    keys = {(one.row, one.number): one for one in scores}
    return [Outcome(one, keys[one.row, one.number]) for one in answers]


def begin(what: Run) -> None:
    """Make the folder, or see that it is of the same run."""
    path = what.folder / PLAN
    what.folder.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.write_text(what.plan, encoding="utf-8")
    if path.read_text(encoding="utf-8") != what.plan:
        raise BrokenSeal(f"{path} is of another run, with other rows, counts or commit: take another seed")


def all_answers(what: Run, doing: Doing, answer: Answering, say: Say = lambda text: None) -> list[Answer]:
    """Answers to all records in the order of the tasks; those that are on file are not asked for again."""
    path = what.folder / ANSWERS
    done = _read(path, Answer.of)
    left = [task for task in what.tasks if (task[0].name, task[1]) not in done]
    if left and (what.folder / SEAL).exists():
        raise BrokenSeal(f"{what.folder / SEAL} is there, but answers are missing: the truth has been looked at")
    calls = [(answer, (drawing, number, what.seed, what.split)) for drawing, number in left]
    for count, one in enumerate(_kept(path, doing(calls)), 1):
        say(f"traced {count} of {len(left)}: {one.row} {one.number}, {one.verdict}, {one.seconds:.0f} s{_why(one)}")
    done = _read(path, Answer.of)
    return [done[drawing.name, number] for drawing, number in what.tasks]


def seal(what: Run) -> str:
    """The hash of all answers, sorted; written the first time, and from then on it may not change."""
    lines = sorted((what.folder / ANSWERS).read_text(encoding="utf-8").splitlines())
    found = hashlib.sha256("\n".join(lines).encode()).hexdigest()
    path = what.folder / SEAL
    if not path.exists():
        path.write_text(f"{found}\n", encoding="utf-8")
    if path.read_text(encoding="utf-8").strip() != found:
        raise BrokenSeal(f"{path} is of other answers than are in {ANSWERS}: they have been changed")
    return found


def all_scores(
    what: Run, answers: Sequence[Answer], doing: Doing, score: Scoring, say: Say = lambda text: None
) -> list[Score]:
    """Scores of all answers; those that are on file are not made again."""
    path = what.folder / SCORES
    drawings = {drawing.name: drawing for drawing in what.drawings}
    done = _read(path, Score.of)
    left = [one for one in answers if (one.row, one.number) not in done]
    calls = [(score, (drawings[one.row], one, what.seed, what.split)) for one in left]
    for count, one in enumerate(_kept(path, doing(calls)), 1):
        say(f"scored {count} of {len(left)}: {one.row} {one.number}")
    done = _read(path, Score.of)
    return [done[one.row, one.number] for one in answers]


def answer_record(drawing: Drawing, number: int, seed: int, split: Split, tracer: Tracer = traced) -> Answer:
    """Draw one record, keep what may be known of it, and ask the tracer."""
    known = record(sitting(drawing, number, seed, split), drawing.coloured)
    return answered(drawing.name, number, known, tracer)


def score_record(drawing: Drawing, answer: Answer, seed: int, split: Split) -> Score:
    """Draw one record again, and score the answer to it."""
    return scored(drawing, answer, sitting(drawing, answer.number, seed, split))


def here(calls: Sequence[Call]) -> Iterator[Any]:
    """Do calls one after the other."""
    for function, arguments in calls:
        yield function(*arguments)


def in_processes(calls: Sequence[Call]) -> Iterator[Any]:
    """Do calls in two processes with linear algebra on one thread each; none holds more than one record."""
    with executor_of(f"processes:{PROCESSES}") as executor:
        for number, future in as_done(executor, calls):
            drawing, *_ = calls[number][1]
            yield result_of(future, f"{drawing.name}, call {number}")


def _why(answer: Answer) -> str:
    return f", {answer.why}" if answer.verdict == FAILED else ""


def _kept(path: Path, found: Iterable[T]) -> Iterator[T]:
    """Results, each of them on file before it is given on."""
    with path.open("a", encoding="utf-8") as file:
        for one in found:
            file.write(line_of(one) + "\n")
            file.flush()
            yield one


def _read(path: Path, of: Callable[[str], T]) -> dict[tuple[str, int], T]:
    """What is on file, by row and number; half a line, which a cut leaves at the end, is taken off."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    found = [of(line) for line in whole.splitlines()]
    return {(one.row, one.number): one for one in found}
