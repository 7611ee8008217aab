"""Runs the study: every record traced and its verdict kept at once, all of them sealed, and only then truths drawn."""

from __future__ import annotations

import hashlib
import itertools
import json
import lzma
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from world.effects.draw import Split
from world.effects.sitting import TOGETHER

from biodyn_ros.work.executors import as_done, executor_of, result_of
from blind.tracing.answer import Tracer, answered, traced
from blind.tracing.outcome import FAILED, Answer, Outcome, Score, line_of
from blind.tracing.records import record, sittings
from blind.tracing.rows import Condition, Drawing, lacking
from blind.tracing.score import scored

T = TypeVar("T", Answer, Score, int)
Key = tuple[str, int]
"""A record: its row and number."""

Task = tuple[Drawing, int]
Say = Callable[[str], None]
Call = tuple[Callable[..., Any], tuple[Any, ...]]
Doing = Callable[[Sequence[Call]], Iterator[Any]]
"""Does calls in any order and gives their results as they come."""

ANSWERS: Final = "answers.jsonl"
ARCHIVE: Final = "answers.jsonl.xz"
"""The answers of a run as the repository keeps them."""

SEAL: Final = "answers.sha256"
SCORES: Final = "scores.jsonl"
PLAN: Final = "plan.json"
PROCESSES: Final = 2
MOST_BATCHES: Final = 4
"""A row that is short of records behind so many is published as it is."""


class BrokenSeal(RuntimeError):
    """What was found in the folder of a run is not what this run would go on from; told in one line."""


class Answering(Protocol):
    """Draws some records of one row, all at once, and asks for answers to them."""

    def __call__(self, drawing: Drawing, numbers: Sequence[int], seed: int, split: Split) -> list[Answer]:
        """Answer each; nothing of its truth is in an answer."""


class Scoring(Protocol):
    """Draws some records of one row again, truths and all, and scores the answers to them."""

    def __call__(self, drawing: Drawing, answers: Sequence[Answer], seed: int, split: Split) -> list[Score]:
        """Score each answer."""


@dataclass(frozen=True)
class Run:
    """One run: its seed, what is drawn from which split, the commit it is of, and where it writes.

    filled: rows that further records are drawn for where they have too few.
    """

    seed: int
    drawings: tuple[Drawing, ...]
    folder: Path
    split: Split = "blind"
    commit: str = ""
    filled: tuple[Condition, ...] = ()

    @property
    def tasks(self) -> list[Task]:
        """Every record of the first batch."""
        return [(drawing, number) for drawing in self.drawings for number in range(drawing.count)]

    def more(self, tasks: Sequence[Task], outcomes: Sequence[Outcome]) -> list[Task]:
        """What the next batch adds to these; how much goes by the ratios of records, never by what was said of them."""
        asked = lacking(self.filled, outcomes)
        held = {name: sum(one.name == name for one, _ in tasks) for name in asked}
        return [
            (drawing, held[drawing.name] + number)
            for drawing in self.drawings
            for number in range(asked.get(drawing.name, 0))
        ]

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
    """Go through a whole run, from where it was interrupted; raises BrokenSeal where that is not possible.

    A record's ratio is known with its truth alone. So rows that go by it are filled up in further batches, each sealed
    before any truth of it is drawn.
    """
    begin(what)
    tasks = what.tasks
    for batch in itertools.count(1):
        answers = all_answers(what, tasks, batch, doing, answer or answer_records, say)
        say(f"{len(answers)} answers are sealed: sha256 {seal(what, tasks, batch)}")
        # Truths of these are drawn from here on, and not before.
        scores = all_scores(what, answers, doing, score or score_records, say)
        outcomes = [Outcome(one, known) for one, known in zip(answers, scores, strict=True)]
        more = what.more(tasks, outcomes)
        if not more or batch == MOST_BATCHES:
            break
        tasks = [*tasks, *more]
    return outcomes


def begin(what: Run) -> None:
    """Make the folder, or see that it is of the same run."""
    path = what.folder / PLAN
    what.folder.mkdir(parents=True, exist_ok=True)
    unpack(what.folder)
    if not path.exists():
        path.write_text(what.plan, encoding="utf-8")
    if path.read_text(encoding="utf-8") != what.plan:
        raise BrokenSeal(f"{path} is of another run, with other rows, counts or commit: take another seed")


def unpack(folder: Path) -> None:
    """Restore the answers from the archive of the folder, if it has one and they are not there."""
    path, archive = folder / ANSWERS, folder / ARCHIVE
    if archive.exists() and not path.exists():
        path.write_bytes(lzma.decompress(archive.read_bytes()))


def all_answers(
    what: Run, tasks: Sequence[Task], batch: int, doing: Doing, answer: Answering, say: Say = lambda text: None
) -> list[Answer]:
    """Answers to all records up to this batch, in their order; those that are on file are not asked for again."""
    path = what.folder / ANSWERS
    done = _read(path, Answer.of)
    left = [task for task in tasks if (task[0].name, task[1]) not in done]
    if left and len(seals(what)) >= batch:
        raise BrokenSeal(f"{what.folder / SEAL} is there, but answers are missing: the truth has been looked at")
    calls = [(answer, (drawing, numbers, what.seed, what.split)) for drawing, numbers in _together(left)]
    for count, one in enumerate(_kept(path, doing(calls)), 1):
        say(f"traced {count} of {len(left)}: {one.row} {one.number}, {one.verdict}, {one.seconds:.0f} s{_why(one)}")
    done = _read(path, Answer.of)
    return [done[drawing.name, number] for drawing, number in tasks]


def seal(what: Run, tasks: Sequence[Task], batch: int) -> str:
    """The hash of all answers up to this batch, sorted; written the first time, and from then on it may not change."""
    wanted: set[Key] = {(drawing.name, number) for drawing, number in tasks}
    lines = sorted(line for line in _whole_lines(what.folder / ANSWERS) if _key(Answer.of(line)) in wanted)
    found = hash_of(lines)
    path, known = what.folder / SEAL, seals(what)
    if len(known) < batch:
        known = [*known, found]
        path.write_text("".join(f"{one}\n" for one in known), encoding="utf-8")
    if known[batch - 1] != found:
        raise BrokenSeal(f"{path} is of other answers than are in {ANSWERS}: they have been changed")
    return found


def hash_of(lines: Sequence[str]) -> str:
    """The SHA-256 of sorted lines."""
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def seals(what: Run) -> list[str]:
    """The seals of all batches so far; each is of all answers up to there."""
    path = what.folder / SEAL
    return path.read_text(encoding="utf-8").split() if path.exists() else []


def all_scores(
    what: Run, answers: Sequence[Answer], doing: Doing, score: Scoring, say: Say = lambda text: None
) -> list[Score]:
    """Scores of all answers; those that are on file are not made again."""
    path = what.folder / SCORES
    drawings = {drawing.name: drawing for drawing in what.drawings}
    done = _read(path, Score.of)
    left = [(drawings[one.row], one) for one in answers if _key(one) not in done]
    calls = [(score, (drawing, some, what.seed, what.split)) for drawing, some in _together(left)]
    for count, one in enumerate(_kept(path, doing(calls)), 1):
        say(f"scored {count} of {len(left)}: {one.row} {one.number}")
    done = _read(path, Score.of)
    return [done[_key(one)] for one in answers]


def answer_records(
    drawing: Drawing, numbers: Sequence[int], seed: int, split: Split, tracer: Tracer = traced
) -> list[Answer]:
    """Draw some records, keep what may be known of each, and ask the tracer."""
    drawn = sittings(drawing, numbers, seed, split)
    return [
        answered(drawing.name, number, record(one, drawing.coloured), tracer)
        for number, one in zip(numbers, drawn, strict=True)
    ]


def score_records(drawing: Drawing, answers: Sequence[Answer], seed: int, split: Split) -> list[Score]:
    """Draw some records again, and score the answers to them."""
    drawn = sittings(drawing, [answer.number for answer in answers], seed, split)
    return [scored(drawing, answer, one) for answer, one in zip(answers, drawn, strict=True)]


def _together(left: Sequence[tuple[Drawing, T]]) -> list[tuple[Drawing, list[T]]]:
    """What is left, so many of one row at a time as are moved at once, which takes little longer than one."""
    rows = {drawing.name: drawing for drawing, _ in left}
    found = []
    for name, drawing in rows.items():
        mine = [one for row, one in left if row.name == name]
        found += [(drawing, mine[begin : begin + TOGETHER]) for begin in range(0, len(mine), TOGETHER)]
    return found


def here(calls: Sequence[Call]) -> Iterator[Any]:
    """Do calls one after the other."""
    for function, arguments in calls:
        yield from function(*arguments)


def in_processes(calls: Sequence[Call]) -> Iterator[Any]:
    """Do calls in two processes with linear algebra on one thread each, and give their results as they come.

    One that fails does not end the others, which take hours: what it was is raised behind them; a run goes on there.
    """
    failed: Exception | None = None
    with executor_of(f"processes:{PROCESSES}") as executor:
        for number, future in as_done(executor, calls):
            drawing, *_ = calls[number][1]
            try:
                found = result_of(future, f"{drawing.name}, call {number}")
            except Exception as error:  # noqa: BLE001 - whatever it was, it is raised at the end
                failed = failed or error
                continue
            yield from found
    if failed is not None:
        raise failed


def _why(answer: Answer) -> str:
    return f", {answer.why}" if answer.verdict == FAILED else ""


def _kept(path: Path, found: Iterable[T]) -> Iterator[T]:
    """Results, each of them on file before it is given on."""
    with path.open("a", encoding="utf-8") as file:
        for one in found:
            file.write(line_of(one) + "\n")
            file.flush()
            yield one


def _read(path: Path, of: Callable[[str], T]) -> dict[Key, T]:
    """What is on file, by row and number."""
    return {_key(one): one for one in map(of, _whole_lines(path))}


def _key(one: Answer | Score) -> Key:
    return one.row, one.number


def _whole_lines(path: Path) -> list[str]:
    """The lines of a file; half a line, which a cut leaves at the end, is taken off."""
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    return whole.splitlines()
