"""The blind tracing study: scores, sealed runs, and their published tables."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from outcomes import CLOCK, ROWS, SKIN, STOP, outcome
from world.effects.sitting import Plan, Sitting
from world.effects.sitting import drawn as sittings_drawn

import blind
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.model import predict
from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.fit import fit_joint
from biodyn_core.identification.problem import Case, Errors
from biodyn_core.tracing.findings import ComparedEvent, RankedCandidate, Round, Trace
from blind.tracing import __main__ as command
from blind.tracing import refits, score, streams, study
from blind.tracing.answer import answered
from blind.tracing.marks import marks
from blind.tracing.outcome import Answer, Cause, Outcome, Score, line_of
from blind.tracing.page import rendered
from blind.tracing.records import Record, causes, record, sittings
from blind.tracing.refits import oracle, placebo
from blind.tracing.rows import CONDITIONS, DRAWINGS, FILLING, MEASURED, Condition, Drawing
from blind.tracing.score import generic_percent, ratio, recovered, sum_of_squares, unseen
from blind.tracing.study import BrokenSeal, Call, Run
from blind.tracing.table import PAGE, RUNS, About, publish

SUBJECT = Subject("blind", 70.0, 1.75, "segment", Parameters.from_vector(0.5 * (LOWER + UPPER)))


# --- scores ----------------------------------------------------------------------------------------------------------


def test_energy_recovered_is_a_share_of_the_oracles() -> None:
    assert recovered(10.0, 4.0, 2.0, right=True) == pytest.approx(0.75)
    assert recovered(10.0, 4.0, 2.0, right=False) == 0.0
    assert recovered(2.0, 1.0, 1.99, right=True) is None


def event(subject: Subject, number: int, seconds: float = 3.5) -> Case:
    """The response of a subject to a synthetic seat motion, with little noise."""
    rate_hz, rng = 250.0, np.random.default_rng(number)
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    tones = rng.uniform(2.0, 20.0, 8)
    seat = (2.0 * np.sin(2.0 * np.pi * tones * time_s[:, None] + rng.uniform(0.0, 6.0, 8))).sum(axis=1)
    measured = predict(subject, seat, rate_hz).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    measured = measured + 0.02 * rng.standard_normal(measured.shape)
    compared = np.zeros(measured.shape, dtype=bool)
    compared[round(2.0 * rate_hz) :] = True
    measured = np.where(compared, measured, 0.0)
    frequency = np.arange(1.0, 30.0)
    nothing = np.zeros((frequency.size, 5))
    return Case(f"road_{number}", "road", rate_hz, seat, measured, compared, (measured**2).sum(axis=0), frequency,
                nothing, nothing, ())  # fmt: skip


@pytest.fixture(scope="module")
def backrest() -> tuple[Record, Record]:
    """A person without and with a backrest, in the same three events."""
    values = {"stiffness_n_per_m": 6000.0, "damping_s": 0.01, "friction_n": 0.0, "smooth_mps": 0.01}
    leans = AppliedEffect(CATALOGUE["backrest"], "upper_torso", values)
    found = []
    for effects in ((), (leans,)):
        cases = [event(dataclasses.replace(SUBJECT, effects=effects), number) for number in range(3)]
        found.append(Record(SUBJECT, tuple(cases[:2]), tuple(cases[2:])))
    return found[0], found[1]


@pytest.mark.slow
def test_refits_give_ratio_oracle_placebo_and_generic(
    backrest: tuple[Record, Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, hidden = backrest
    # Sensors' effects alone, so that no integrators have to be compiled.
    monkeypatch.setattr(refits, "CATALOGUE", {name: CATALOGUE[name] for name in ("backrest", "clock", "skin")})
    fits = [fit_joint(known.train, SUBJECT, 0) for known in (hidden, plain)]
    assert ratio(fits[1].subject, plain.cases, fits[1].subject, plain.cases) == 0.0
    visible = ratio(fits[0].subject, hidden.cases, fits[1].subject, plain.cases)
    assert visible > 1.0
    truth = Cause("backrest", "upper_torso", "backrest")
    before, best, wrong = (
        sum_of_squares(subject, hidden.held_out)
        for subject in (fits[0].subject, oracle(fits[0], hidden.train, truth), placebo(fits[0], hidden.train, truth))
    )
    floor = sum_of_squares(fits[1].subject, plain.held_out)
    assert best < 5.0 * floor < 0.03 * before  # friction, of which it has none, is neared and never reached
    assert wrong > best
    named = Answer("strong", 0, "effect", unseen=("road_2", "gone"))
    both = dataclasses.replace(plain, held_out=plain.cases)
    assert [case.name for case in unseen(named, both).held_out] == ["road_2"]
    assert unseen(dataclasses.replace(named, unseen=()), both).held_out == plain.cases
    assert math.isfinite(generic_percent(fits[0], hidden))


def test_an_unstable_simulation_has_infinite_squares() -> None:
    quiet = event(SUBJECT, 0)
    for factor in (1e5, 1e160):
        wild = dataclasses.replace(quiet, seat_mps2=factor * quiet.seat_mps2)
        assert sum_of_squares(SUBJECT, [quiet]) < 0.01 < sum_of_squares(SUBJECT, [quiet, wild]) == math.inf


def test_the_error_of_an_unstable_oracle_is_infinite(
    backrest: tuple[Record, Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, hidden = backrest
    wild = dataclasses.replace(hidden.held_out[0], seat_mps2=1e160 * hidden.held_out[0].seat_mps2)
    known = dataclasses.replace(hidden, held_out=(wild,))
    fit = fit_joint(hidden.train, SUBJECT, 0)
    monkeypatch.setattr(score, "oracle", lambda *given: SUBJECT)
    monkeypatch.setattr(score, "placebo", lambda *given: None)
    found = score._beside(Score("strong", 0, (Cause("backrest", "upper_torso", "backrest"),)),
                          Answer("strong", 0, "none"), known, fit)  # fmt: skip
    assert (found.oracle_percent, found.placebo_percent) == (math.inf, None)


def test_only_the_first_records_of_a_row_have_a_placebo(
    backrest: tuple[Record, Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, hidden = backrest
    fit = fit_joint(hidden.train, SUBJECT, 0)
    monkeypatch.setattr(score, "oracle", lambda *given: SUBJECT)
    monkeypatch.setattr(score, "placebo", lambda *given: SUBJECT)
    cause = Cause("backrest", "upper_torso", "backrest")
    last, after = (
        score._beside(Score("strong", number, (cause,)), Answer("strong", number, "none"), hidden, fit)
        for number in (score.PLACEBOS - 1, score.PLACEBOS)
    )
    assert last.placebo_percent == last.oracle_percent == after.oracle_percent and after.placebo_percent is None


# --- truths ----------------------------------------------------------------------------------------------------------


def test_truths_have_the_names_of_the_catalogue() -> None:
    def cause_of(kind: str, family: str, site: int) -> Cause:
        (found,) = causes([SimpleNamespace(kind=kind, family=family, site=site)])
        return found

    assert cause_of("cubic", "elastic", 4) == Cause("cubic", "neck", "stiffening")
    assert cause_of("skin", "sensor", 4) == Cause("skin", "upper_torso", "sensor")  # sensors count from the seat on
    assert cause_of("pitch", "sideways", -1) == Cause("pitch", "", "horizontal")
    assert cause_of("outside", "rubbing", 2) == Cause("outside", "", "dry_friction")
    assert cause_of("outside", "outside", 2) == Cause("outside", "", "outside")


# --- runs ------------------------------------------------------------------------------------------------------------

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


# --- the tracer ------------------------------------------------------------------------------------------------------


def a_trace(known: Record) -> Trace:
    """The result of a trace that finds skin at the head."""
    skin = CATALOGUE["skin"]
    applied = AppliedEffect(skin, "head", {p.name: p.size for p in skin.parameters})
    after = dataclasses.replace(known.subject, effects=(applied,))
    late = AppliedEffect(CATALOGUE["clock"], "head", {p.name: p.size for p in CATALOGUE["clock"].parameters})
    best = RankedCandidate(applied, 0.85, 0.4, True, 0.1, 0.0, 2)
    other = RankedCandidate(late, 0.1, 0.3, True, 0.1, 0.0, 1)
    blank = np.zeros((1, 5))
    events = tuple(
        ComparedEvent(use, "road", use, 1.0, blank, blank, blank, _error(before), _error(before / 2.0))
        for use, before in (("train", 90.0), ("choose", 80.0), ("held_out", 4.0), ("held_out", 6.0))
    )
    return Trace(
        verdict="effect", reasons=("it helps", "nothing else does"), given=known.subject, before=known.subject,
        after=after, experiment="", events=events, floor_percent=None, untestable=(), left_out=(), seed=0,
        calibrated="found", effects=(applied,), intervals=((),), family="sensor",
        rounds=(Round((best, other), {"skin": 0.85, "clock": 0.1, "none": 0.05}, ("skin", "clock"), best, (other,)),),
        p_value=0.01,
    )  # fmt: skip


def _error(percent: float) -> Errors:
    return Errors("", "road", np.full(5, percent), np.full(5, percent))


def test_a_trace_becomes_plain_data() -> None:
    known = Record(SUBJECT, (), ())
    answer = Answer.of(line_of(answered("strong", 3, known, a_trace)))
    assert (answer.row, answer.number, answer.verdict) == ("strong", 3, "effect")
    assert answer.effects == (SKIN,)
    assert answer.probabilities == {"skin": 0.85, "clock": 0.1, "none": 0.05}
    assert (answer.most_probable, answer.likely) == ("skin", ("skin", "clock"))
    assert (answer.before_percent, answer.after_percent) == (5.0, 2.5)  # of what is held out
    assert answer.unseen == ("held_out", "held_out")
    assert Subject.from_dict(SUBJECT.to_dict() | {"effects": list(answer.applied)}).effects[0].site == "head"
    assert answer.why == "it helps; nothing else does"


def test_a_failing_trace_is_one_wrong_record() -> None:
    def refusing(known: Record) -> Trace:
        raise InputError("too short")

    def broken(known: Record) -> Trace:
        raise ZeroDivisionError("oh\nno")

    known = Record(SUBJECT, (), ())
    refused = answered("strong", 0, known, refusing)
    assert (refused.verdict, refused.why) == ("not_decidable", "too short")
    failed = answered("strong", 0, known, broken)
    assert (failed.verdict, failed.why) == ("failed", "ZeroDivisionError: oh no")
    assert not Outcome(failed, Score("strong", 0, (SKIN,))).class_right


# --- publishing ------------------------------------------------------------------------------------------------------

ABOUT = About("2026-01-02", "abc", 7, "f" * 64, "e" * 64, 5)


def test_every_full_run_adds_a_row_to_the_table(tmp_path: Path) -> None:
    records = [outcome("two", "effect", [SKIN, STOP], [SKIN, STOP])] * 40
    found = marks(records)
    publish(tmp_path, ABOUT, records, found)
    first = (tmp_path / RUNS).read_text()
    publish(tmp_path, dataclasses.replace(ABOUT, seed=8), records, found)
    both = (tmp_path / RUNS).read_text()
    assert both.startswith(first)
    (row,) = both[len(first) :].splitlines()
    assert row.startswith("| 2026-01-02 | abc | 8 | ffffffffffff | eeeeeeeeeeee | 5 | 2 of ")
    assert row.count("✗") == len(found) - 2
    assert "seed 8" in (tmp_path / PAGE).read_text()


def test_a_partial_run_is_not_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "has_recordings", lambda: True)
    monkeypatch.setattr(command, "publish", lambda *given: pytest.fail("published"))
    monkeypatch.setattr(command, "run", lambda what, doing, report: study.run(what, in_sequence, answers, scores))
    given = ["--rows", "strong", "--count", "2", "--split", "development", "--out", str(tmp_path)]
    assert command.main([*given, "--seed", "11"]) == 1
    assert "seed 11, a partial run" in capsys.readouterr().out
    assert json.loads((tmp_path / "11-partial" / study.PLAN).read_text())["rows"] == {"strong": 2}
    # Its truths have been looked at.
    assert command.main(["--seed", "11", "--out", str(tmp_path)]) == 2
    assert "take another" in capsys.readouterr().err
    assert command.main(given) == 1
    seeds = {path.name for path in tmp_path.iterdir()}
    assert len(seeds) == 2  # the second is fresh


def test_a_full_run_is_published_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    published: list[About] = []
    monkeypatch.setattr(command, "has_recordings", lambda: True)
    monkeypatch.setattr(command, "publish", lambda root, about, outcomes, found: published.append(about))
    monkeypatch.setattr(command, "decision", lambda: "0" * 64)
    few = [dataclasses.replace(one, count=30) if one.name == "medium" else one for one in DRAWINGS]
    monkeypatch.setattr(command, "drawings", lambda names, count: few)
    monkeypatch.setattr(command.streams, "outcomes", lambda seed: [])
    monkeypatch.setattr(command, "run", lambda what, doing, report: study.run(what, in_sequence, answers, scores))
    assert command.main(["--out", str(tmp_path), "--seed", "3"]) == 1
    (about,) = published
    filled_up = FILLING * (ROWS["with background, ratio 0.4 to 0.8"].least - 30)
    assert (about.seed, about.records) == (3, sum(one.count for one in few) + filled_up)
    assert about.sealed == (tmp_path / "3" / study.SEAL).read_text().split()[1]
    commits = iter(["one", "two"])
    monkeypatch.setattr(command, "commit", lambda: next(commits))
    assert command.main(["--out", str(tmp_path), "--seed", "4"]) == 2
    assert len(published) == 1


def test_a_short_run_adds_a_row_and_no_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row with fewer records than a full run requires can meet its marks; no further records are drawn."""
    monkeypatch.setattr(command, "has_recordings", lambda: True)
    monkeypatch.setattr(command, "ROOT", tmp_path)
    monkeypatch.setattr(command, "commit", lambda: "abc")
    monkeypatch.setattr(command.streams, "outcomes", lambda seed: [])
    monkeypatch.setattr(command, "run", lambda what, doing, report: study.run(what, in_sequence, answers, scores))
    assert command.main(["--short", "--out", str(tmp_path), "--seed", "5"]) == 1
    (row,) = [line for line in (tmp_path / RUNS).read_text().splitlines() if "| abc | 5 |" in line]
    assert f"| {len(DRAWINGS) * command.OF_EACH} ({command.OF_EACH}) |" in row
    met = [mark for mark in row.split("|")[8].split("<br>") if "✗" not in mark]
    assert any(mark.startswith("two effects: both found") and f"of {command.OF_EACH}," in mark for mark in met)
    assert not (tmp_path / PAGE).exists()
    # Its truths have been looked at.
    assert command.main(["--out", str(tmp_path), "--seed", "5"]) == 2
    for more in (["--count", "2"], ["--rows", "two"], ["--split", "development"]):
        assert command.main(["--short", *more, "--out", str(tmp_path), "--seed", "6"]) == 2


def test_the_page_has_every_mark_and_class() -> None:
    records = [
        outcome("strong", "effect", [CLOCK], [SKIN], ratio=1.0, before_percent=4.0, floor_percent=2.0),
        outcome("background", "none"),
    ]
    text = rendered(records, marks(records), "Run of today.")
    assert "| skin | 1 | 0 | 1 | 0 | 0 |\n" in text
    assert "| strong | 1.00 | 2.00 | 4.00 | - | - | - | - |" in text
    assert all(rule.what in text for row in CONDITIONS for rule in row.rules)
    assert "**missed**, as it has fewer than 60 records" in text
    assert "| another class named | 0 | 1 |" in text


def test_measured_streams_have_the_marks_of_the_background_rows() -> None:
    def graded(fault: str, size: float, verdict: str, name: str, *beside: str) -> Outcome:
        found = SimpleNamespace(verdict=verdict, name=name, ambiguous_with=beside)
        return streams.outcome(0, SimpleNamespace(found=found, fault=fault, ratio=size))

    records = [
        graded("none", 0.0, "none", ""),
        graded("none", 0.0, "effect", "gain"),
        graded("gain", 1.2, "effect", "gain"),
        graded("gain", 1.2, "effect", "skin"),
        graded("tilt", 0.5, "ambiguous", "gain", "tilt"),
        graded("tilt", 0.1, "unexplained", ""),
    ]
    found = [mark.reached for mark in marks(records, MEASURED)]
    assert found == [0.5, 0.5, 0.5]


def test_a_record_does_not_depend_on_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []

    def drawn(count: int, seed: int, *given: Any, first: int, kinds_behind: Sequence[str]) -> list[tuple[int, int]]:
        asked.append((count, *given, kinds_behind))
        return [(seed, number) for number in range(first, first + count)]

    monkeypatch.setattr("blind.tracing.records.sittings_drawn", drawn)
    seeds = {sittings(FEW[1], [4], seed, "development")[0] for seed in (1, 2)}
    seeds |= set(sittings(FEW[0], [4], 1, "development"))
    assert len({seed for seed, _ in seeds}) == 3 and {number for _, number in seeds} == {4}
    assert {count for count, *_ in asked} == {1}
    some = sittings(FEW[1], [3, 4, 6], 1, "development")
    assert [number for _, number in some] == [3, 4, 6] and some[1] in seeds


@pytest.fixture(scope="module")
def short_sitting() -> Sitting:
    """A real one of the world: a stretch of made road to fit to, and one held out."""
    plan = Plan(counts=(1, 0, 0), seconds=(3.0, 0.0, 0.0), uses=("fit", "held"), recorded=False)
    drawing = Drawing("nothing_coloured", 1, effects=0, level=0.0, coloured=True)
    return sittings(drawing, [1], 3, "development", plan)[0]


def test_a_sitting_becomes_a_record_with_noise_that_does_not_follow_the_seat(short_sitting: Sitting) -> None:
    plain, noisy = record(short_sitting), record(short_sitting, coloured=True)
    assert [case.name for case in plain.cases] == ["fit/road_1", "held/road_1"]
    assert (plain.subject.mass_matrix, plain.left_out, noisy.left_out) == ("cascade", (), ())
    assert {"seat.x", "seat.rate_y", "head.x"} <= set(plain.train[0].channels)
    for one, other in zip(plain.cases, noisy.cases, strict=True):
        assert np.array_equal(one.seat_mps2, other.seat_mps2)
        moving = slice(round(3.0 * one.rate_hz), round(4.5 * one.rate_hz))
        added = (other.measured_mps2 - one.measured_mps2)[moving]
        assert np.sqrt((added**2).mean(axis=0)) == pytest.approx(0.3, rel=0.35)


def test_a_sitting_is_the_same_alone_and_among_others() -> None:
    plan = Plan(counts=(1, 0, 0), seconds=(1.0, 0.0, 0.0), uses=("fit",), recorded=False)
    drawn = partial(sittings_drawn, seed=3, effects=0, plan=plan)
    _, second = drawn(2)
    (alone,) = drawn(1, first=1)
    assert np.array_equal(alone.theta, second.theta) and alone.seed == second.seed
    assert np.array_equal(alone.streams(0)["head"][1], second.streams(0)["head"][1])


def test_unreadable_events_are_reported(short_sitting: Sitting) -> None:
    streams_of = {name: tuple(part[:40] for part in stream) for name, stream in short_sitting.streams(0).items()}
    cut = SimpleNamespace(
        events=short_sitting.events, streams=lambda index, with_effects: streams_of, seed=0,
        body_mass_kg=70.0, mass_matrix="segment",
    )  # fmt: skip
    found = record(cut)
    assert (found.cases, len(found.left_out)) == ((), 2)
    assert found.left_out[0].startswith("fit/road_1: ")
    answer = answered("strong", 0, found, lambda known: a_trace(dataclasses.replace(known, subject=SUBJECT)))
    assert "held/road_1: " in answer.why


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
