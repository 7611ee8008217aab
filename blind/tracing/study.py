"""The study: every record is traced and its answer stored, all answers are sealed, and only then truths are drawn."""

from __future__ import annotations

import hashlib
import itertools
import json
import lzma
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from world.effects.draw import SCORING, Split
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
Report = Callable[[str], None]
Call = tuple[Callable[..., Any], tuple[Any, ...]]
Execute = Callable[[Sequence[Call]], Iterator[Any]]
"""Executes calls in any order and yields results when they are ready."""

Answering = Callable[[Drawing, Sequence[int], int, Split], list[Answer]]
"""Draws records of one row by their numbers, seed and split, and traces them; an answer has no part of the truth."""

Scoring = Callable[[Drawing, Sequence[Answer], int, Split], list[Score]]
"""Draws the same records again with their truths, and scores the answers."""

ANSWERS: Final = "answers.jsonl"
ARCHIVE: Final = "answers.jsonl.xz"
"""The answers of a run as the repository keeps them."""

SEAL: Final = "answers.sha256"
SCORES: Final = "scores.jsonl"
PLAN: Final = "plan.json"
PROCESSES: Final = 2
MOST_BATCHES: Final = 4
"""A row with too few records after this number of batches is published as it is."""


class BrokenSeal(RuntimeError):
    """The files in the folder of a run do not belong to this run; a message of one line."""


@dataclass(frozen=True)
class Run:
    """One run: its seed, drawings and split, its commit, and the folder of its files.

    filled: rows for which further records are drawn if they have too few.
    """

    seed: int
    drawings: tuple[Drawing, ...]
    folder: Path
    split: Split = SCORING
    commit: str = ""
    filled: tuple[Condition, ...] = ()

    @property
    def tasks(self) -> list[Task]:
        """Every record of the first batch."""
        return [(drawing, number) for drawing in self.drawings for number in range(drawing.count)]

    def more(self, tasks: Sequence[Task], outcomes: Sequence[Outcome]) -> list[Task]:
        """The records of the next batch; their number depends on ratios of records, never on answers."""
        needed = lacking(self.filled, outcomes)
        held = {name: sum(one.name == name for one, _ in tasks) for name in needed}
        return [
            (drawing, held[drawing.name] + number)
            for drawing in self.drawings
            for number in range(needed.get(drawing.name, 0))
        ]

    @property
    def plan(self) -> str:
        """The facts that must not change during a run."""
        rows = {drawing.name: drawing.count for drawing in self.drawings}
        return json.dumps({"seed": self.seed, "split": self.split, "commit": self.commit, "rows": rows}) + "\n"


def run(
    spec: Run,
    execute: Execute,
    answer: Answering | None = None,
    score: Scoring | None = None,
    report: Report = lambda text: None,
) -> list[Outcome]:
    """Do a whole run, or continue an interrupted one; raises BrokenSeal if that is not possible.

    The ratio of a record is known only with its truth. Therefore rows by ratio get further records in batches, each
    sealed before its truths are drawn.
    """
    begin(spec)
    tasks = spec.tasks
    for batch in itertools.count(1):
        answers = all_answers(spec, tasks, batch, execute, answer or answer_records, report)
        report(f"{len(answers)} answers are sealed: sha256 {seal(spec, tasks, batch)}")
        # Their truths are drawn only after this line.
        scores = all_scores(spec, answers, execute, score or score_records, report)
        outcomes = [Outcome(one, known) for one, known in zip(answers, scores, strict=True)]
        more = spec.more(tasks, outcomes)
        if not more or batch == MOST_BATCHES:
            break
        tasks = [*tasks, *more]
    return outcomes


def begin(spec: Run) -> None:
    """Make the folder, or check that it belongs to the same run."""
    path = spec.folder / PLAN
    spec.folder.mkdir(parents=True, exist_ok=True)
    unpack(spec.folder)
    if not path.exists():
        path.write_text(spec.plan, encoding="utf-8")
    if path.read_text(encoding="utf-8") != spec.plan:
        raise BrokenSeal(f"{path} is of another run, with other rows, counts or commit; take another seed")


def unpack(folder: Path) -> None:
    """Restore the answers from the archive of the folder, if it has one and they are not there."""
    path, archive = folder / ANSWERS, folder / ARCHIVE
    if archive.exists() and not path.exists():
        path.write_bytes(lzma.decompress(archive.read_bytes()))


def all_answers(
    spec: Run,
    tasks: Sequence[Task],
    batch: int,
    execute: Execute,
    answer: Answering,
    report: Report = lambda text: None,
) -> list[Answer]:
    """Answers to all records up to this batch, in their order; stored answers are not computed again."""
    path = spec.folder / ANSWERS
    done = _read(path, Answer.of)
    left = [task for task in tasks if (task[0].name, task[1]) not in done]
    if left and len(seals(spec)) >= batch:
        raise BrokenSeal(f"{spec.folder / SEAL} exists, but answers are missing: the truths have been drawn")
    calls = [(answer, (drawing, numbers, spec.seed, spec.split)) for drawing, numbers in _together(left)]
    for count, one in enumerate(_kept(path, execute(calls)), 1):
        report(f"traced {count} of {len(left)}: {one.row} {one.number}, {one.verdict}, {one.seconds:.0f} s{_why(one)}")
    done = _read(path, Answer.of)
    return [done[drawing.name, number] for drawing, number in tasks]


def seal(spec: Run, tasks: Sequence[Task], batch: int) -> str:
    """The hash of all answers up to this batch, sorted; it is written once and must not change."""
    wanted: set[Key] = {(drawing.name, number) for drawing, number in tasks}
    lines = sorted(line for line in _whole_lines(spec.folder / ANSWERS) if _key(Answer.of(line)) in wanted)
    found = hash_of(lines)
    path, known = spec.folder / SEAL, seals(spec)
    if len(known) < batch:
        known = [*known, found]
        path.write_text("".join(f"{one}\n" for one in known), encoding="utf-8")
    if known[batch - 1] != found:
        raise BrokenSeal(f"{path} does not match {ANSWERS}: answers have been changed")
    return found


def hash_of(lines: Sequence[str]) -> str:
    """The SHA-256 of sorted lines."""
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def seals(spec: Run) -> list[str]:
    """The seals of all batches so far; each is of all answers up to that batch."""
    path = spec.folder / SEAL
    return path.read_text(encoding="utf-8").split() if path.exists() else []


def all_scores(
    spec: Run, answers: Sequence[Answer], execute: Execute, score: Scoring, report: Report = lambda text: None
) -> list[Score]:
    """Scores of all answers; stored scores are not computed again."""
    path = spec.folder / SCORES
    drawings = {drawing.name: drawing for drawing in spec.drawings}
    done = _read(path, Score.of)
    left = [(drawings[one.row], one) for one in answers if _key(one) not in done]
    calls = [(score, (drawing, some, spec.seed, spec.split)) for drawing, some in _together(left)]
    for count, one in enumerate(_kept(path, execute(calls)), 1):
        report(f"scored {count} of {len(left)}: {one.row} {one.number}")
    done = _read(path, Score.of)
    return [done[_key(one)] for one in answers]


def answer_records(
    drawing: Drawing, numbers: Sequence[int], seed: int, split: Split, tracer: Tracer = traced
) -> list[Answer]:
    """Draw some records, and trace the known part of each."""
    drawn = sittings(drawing, numbers, seed, split)
    return [
        answered(drawing.name, number, record(one, drawing.coloured), tracer)
        for number, one in zip(numbers, drawn, strict=True)
    ]


def score_records(drawing: Drawing, answers: Sequence[Answer], seed: int, split: Split) -> list[Score]:
    """Draw some records again, and score their answers."""
    drawn = sittings(drawing, [answer.number for answer in answers], seed, split)
    return [scored(drawing, answer, one) for answer, one in zip(answers, drawn, strict=True)]


def _together(left: Sequence[tuple[Drawing, T]]) -> list[tuple[Drawing, list[T]]]:
    """The remaining records in groups of one row, which are simulated together in little more time than one."""
    rows = {drawing.name: drawing for drawing, _ in left}
    found = []
    for name, drawing in rows.items():
        mine = [one for row, one in left if row.name == name]
        found += [(drawing, mine[begin : begin + TOGETHER]) for begin in range(0, len(mine), TOGETHER)]
    return found


def in_processes(calls: Sequence[Call]) -> Iterator[Any]:
    """Execute calls in two processes with linear algebra on one thread each, and yield results when they are ready.

    A failing call does not stop the others, which take hours; its error is raised after them.
    """
    failed: Exception | None = None
    with executor_of(f"processes:{PROCESSES}") as executor:
        for number, future in as_done(executor, calls):
            drawing, *_ = calls[number][1]
            try:
                found = result_of(future, f"{drawing.name}, call {number}")
            except Exception as error:  # noqa: BLE001 - raised at the end
                failed = failed or error
                continue
            yield from found
    if failed is not None:
        raise failed


def _why(answer: Answer) -> str:
    return f", {answer.why}" if answer.verdict == FAILED else ""


def _kept(path: Path, found: Iterable[T]) -> Iterator[T]:
    """The results, each stored before it is yielded."""
    with path.open("a", encoding="utf-8") as file:
        for one in found:
            file.write(line_of(one) + "\n")
            file.flush()
            yield one


def _read(path: Path, of: Callable[[str], T]) -> dict[Key, T]:
    """The stored results by row and number."""
    return {_key(one): one for one in map(of, _whole_lines(path))}


def _key(one: Answer | Score) -> Key:
    return one.row, one.number


def _whole_lines(path: Path) -> list[str]:
    """The lines of a file; an incomplete last line is removed."""
    if not path.exists():
        return []
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    return whole.splitlines()
