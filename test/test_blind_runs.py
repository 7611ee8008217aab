"""Runs of the blind tracing study: verdicts are sealed before truths are drawn, and work goes on where it ended."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from blind_answers import FEW, a_score, an_answer, answers, in_sequence, scores
from outcomes import SKIN

import blind
from blind.tracing import study
from blind.tracing.outcome import Answer, Score, line_of
from blind.tracing.rows import DRAWINGS, Condition, Drawing
from blind.tracing.study import BrokenSeal, Call, Run


def test_lines_are_read_as_they_were_written() -> None:
    answer = an_answer(FEW[1], 2)
    assert Answer.of(line_of(answer)) == answer
    score = a_score(FEW[1], answer)
    assert Score.of(line_of(score)) == score


def test_verdicts_are_sealed_before_any_truth_is_drawn(tmp_path: Path) -> None:
    happened: list[str] = []
    what = Run(5, FEW, tmp_path / "5", "development")

    def answer(drawing: Drawing, numbers: Sequence[int], seed: int, split: str) -> list[Answer]:
        happened.append("answers")
        return answers(drawing, numbers, seed, split)

    def score(drawing: Drawing, given: Sequence[Answer], seed: int, split: str) -> list[Score]:
        assert len((what.folder / study.ANSWERS).read_text().splitlines()) == 5
        assert len((what.folder / study.SEAL).read_text().strip()) == 64
        assert (seed, split) == (5, "development")
        happened.append("truths")
        return scores(drawing, given, seed, split)

    outcomes = study.run(
        what, in_sequence, answer, score, lambda text: happened.append("sealed") if "sealed" in text else None
    )
    assert happened == ["answers"] * 2 + ["sealed"] + ["truths"] * 2  # a row at a time
    assert [(one.answer.row, one.answer.number) for one in outcomes] == [(d.name, n) for d, n in what.tasks]
    assert all(one.answer.row == one.score.row and one.answer.number == one.score.number for one in outcomes)


def test_an_interrupted_run_continues(tmp_path: Path) -> None:
    what, done = Run(5, FEW, tmp_path), []

    def interrupted(calls: Sequence[Call]) -> Iterator[Any]:
        function, (drawing, numbers, *rest) = calls[0]
        done.extend((drawing.name, number) for number in numbers)
        yield from function(drawing, numbers, *rest)
        raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            study.run(what, interrupted, answers, scores)
        with (tmp_path / study.ANSWERS).open("a") as file:
            file.write('{"row": "stro')  # a line that was cut
    assert not (tmp_path / study.SEAL).exists()
    assert done == [("nothing", 0), ("nothing", 1), ("strong", 0), ("strong", 1), ("strong", 2)]
    done.clear()
    assert len(study.run(what, in_sequence, answers, scores)) == 5
    assert len((tmp_path / study.ANSWERS).read_text().splitlines()) == 5

    def nothing_left(calls: Sequence[Call]) -> Iterator[Any]:
        assert not calls
        return iter(())

    assert len(study.run(what, nothing_left, answers, scores)) == 5


def test_changed_answers_break_the_seal(tmp_path: Path) -> None:
    what = Run(5, FEW, tmp_path)
    study.run(what, in_sequence, answers, scores)
    path = tmp_path / study.ANSWERS
    lines = path.read_text().splitlines()
    path.write_text("\n".join(reversed(lines)) + "\n")
    study.run(what, in_sequence, answers, scores)  # the order is that in which they were done
    path.write_text("\n".join(lines).replace('"verdict": "effect"', '"verdict": "none"', 1) + "\n")
    with pytest.raises(BrokenSeal, match="have been changed"):
        study.run(what, in_sequence, answers, scores)
    path.write_text("\n".join(lines[1:]) + "\n")
    with pytest.raises(BrokenSeal, match="the truths have been drawn"):
        study.run(what, in_sequence, answers, scores)
    for other in (dataclasses.replace(what, commit="later"), dataclasses.replace(what, drawings=FEW[:1])):
        with pytest.raises(BrokenSeal, match="of another run"):
            study.run(other, in_sequence, answers, scores)


def ratios(of: Callable[[int], float]) -> study.Scoring:
    """Scores whose ratios go by the number of the record."""

    def given(drawing: Drawing, some: Sequence[Answer], seed: int, split: str) -> list[Score]:
        return [Score(drawing.name, one.number, (SKIN,), ratio=of(one.number)) for one in some]

    return given


FILLED = (
    Condition("strong ones", ("strong",), 4, (), (0.8, math.inf), "strong"),
    Condition("nothing", ("nothing",), 9, ()),  # does not go by the ratio
)


def test_further_records_have_their_own_seal(tmp_path: Path) -> None:
    what, seen = Run(5, FEW, tmp_path, filled=FILLED), []
    scored = ratios(lambda number: 1.0 if number % 3 == 0 else 0.5)

    def score(drawing: Drawing, given: Sequence[Answer], seed: int, split: str) -> list[Score]:
        seen.append((len(study.seals(what)), drawing.name, [one.number for one in given]))
        return scored(drawing, given, seed, split)

    def interrupted(calls: Sequence[Call]) -> Iterator[Any]:
        for function, arguments in calls:
            yield from function(*arguments)
            if arguments[1][0] == 3:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study.run(what, interrupted, answers, score)
    assert len(study.seals(what)) == 1
    outcomes = study.run(what, in_sequence, answers, score)
    # Of three one has the ratio, three are missing, so nine are drawn, of which three have it.
    assert seen == [
        (1, "nothing", [0, 1]),
        (1, "strong", [0, 1, 2]),
        *((2, "strong", some) for some in _at_once(3, 12)),
    ]
    assert [(one.answer.row, one.answer.number) for one in outcomes] == [
        *(("nothing", number) for number in range(2)), *(("strong", number) for number in range(12)),
    ]  # fmt: skip
    first, whole = study.seals(what)
    assert first == study.seal(what, what.tasks, 1) != whole == study.seal(what, [*what.tasks, *_more(9)], 2)
    lines = (tmp_path / study.ANSWERS).read_text().splitlines()
    (tmp_path / study.ANSWERS).write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(BrokenSeal, match="the truths have been drawn"):
        study.run(what, in_sequence, answers, score)


def _at_once(begin: int, end: int) -> list[list[int]]:
    return [list(range(at, min(at + study.TOGETHER, end))) for at in range(begin, end, study.TOGETHER)]


def _more(count: int) -> list[tuple[Drawing, int]]:
    return [(FEW[1], 3 + number) for number in range(count)]


def test_the_number_of_records_depends_on_ratios_alone_and_is_limited(tmp_path: Path) -> None:
    drawn = {}
    for verdict in ("effect", "none"):

        def answer(
            drawing: Drawing, numbers: Sequence[int], seed: int, split: str, stated: str = verdict
        ) -> list[Answer]:
            return [dataclasses.replace(an_answer(drawing, number), verdict=stated) for number in numbers]

        what = Run(5, FEW, tmp_path / verdict, filled=FILLED)
        drawn[verdict] = len(study.run(what, in_sequence, answer, ratios(lambda number: 0.1)))
        assert len(study.seals(what)) == study.MOST_BATCHES
    assert drawn["effect"] == drawn["none"] == 2 + 3 + 3 * 4 * (study.MOST_BATCHES - 1)


def test_records_go_through_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "PROCESSES", 1)
    calls = [(scores, (FEW[1], [an_answer(FEW[1], number)], 0, "")) for number in range(2)]
    assert {one.number for one in study.in_processes(calls)} == {0, 1}


def test_scored_forms_are_not_named_in_the_package() -> None:
    root = Path(blind.__file__).parent
    texts = [path.read_text(encoding="utf-8") for path in root.rglob("*.py")]
    assert not [text for text in texts if "third_forms" in text]


def answered_but_one(drawing: Drawing, numbers: list[int]) -> list[int]:
    """The answer of a process; the second record cannot be drawn."""
    if 1 in numbers:
        raise ValueError("this one cannot be drawn")
    return numbers


@pytest.mark.slow
def test_a_failing_record_is_raised_after_the_others() -> None:
    came: list[int] = []

    def take_all() -> None:
        for one in study.in_processes([(answered_but_one, (DRAWINGS[0], [number])) for number in range(4)]):
            came.append(one)  # noqa: PERF402 - extend would lose what came before the error

    with pytest.raises(ValueError, match="cannot be drawn"):
        take_all()
    assert sorted(came) == [0, 2, 3]
