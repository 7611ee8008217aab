"""Records of the blind tracing study: their truths, sittings and events, and what a trace of them becomes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from blind_answers import FEW, SUBJECT
from outcomes import SKIN
from world.effects.sitting import Plan, Sitting
from world.effects.sitting import drawn as sittings_drawn

from biodyn_core.base.errors import InputError
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.problem import Errors
from biodyn_core.tracing.findings import ComparedEvent, RankedCandidate, Round, Trace
from blind.tracing.answer import answered
from blind.tracing.outcome import Answer, Cause, Outcome, Score, line_of
from blind.tracing.records import Record, causes, record, sittings
from blind.tracing.rows import Drawing


def test_truths_have_the_names_of_the_catalogue() -> None:
    def cause_of(kind: str, family: str, site: int) -> Cause:
        (found,) = causes([SimpleNamespace(kind=kind, family=family, site=site)])
        return found

    assert cause_of("cubic", "elastic", 4) == Cause("cubic", "neck", "stiffening")
    assert cause_of("skin", "sensor", 4) == Cause("skin", "upper_torso", "sensor")  # sensors count from the seat on
    assert cause_of("pitch", "sideways", -1) == Cause("pitch", "", "horizontal")
    assert cause_of("outside", "rubbing", 2) == Cause("outside", "", "dry_friction")
    assert cause_of("outside", "outside", 2) == Cause("outside", "", "outside")


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


@cache
def short_sitting() -> Sitting:
    """A real one of the world: a stretch of made road to fit to, and one held out; with `brief_rest`."""
    plan = Plan(counts=(1, 0, 0), seconds=(3.0, 0.0, 0.0), uses=("fit", "held"), recorded=False)
    drawing = Drawing("nothing_coloured", 1, effects=0, level=0.0, coloured=True)
    return sittings(drawing, [1], 3, "development", plan)[0]


def test_a_sitting_becomes_a_record_with_noise_that_does_not_follow_the_seat(brief_rest: None) -> None:
    plain, noisy = record(short_sitting()), record(short_sitting(), coloured=True)
    assert [case.name for case in plain.cases] == ["fit/road_1", "held/road_1"]
    assert (plain.subject.mass_matrix, plain.left_out, noisy.left_out) == ("cascade", (), ())
    assert {"seat.x", "seat.rate_y", "head.x"} <= set(plain.train[0].channels)
    for one, other in zip(plain.cases, noisy.cases, strict=True):
        assert np.array_equal(one.seat_mps2, other.seat_mps2)
        moving = slice(round(2.0 * one.rate_hz), round(3.5 * one.rate_hz))
        added = (other.measured_mps2 - one.measured_mps2)[moving]
        assert np.sqrt((added**2).mean(axis=0)) == pytest.approx(0.3, rel=0.35)


@pytest.mark.slow
def test_a_sitting_is_the_same_alone_and_among_others(brief_rest: None) -> None:
    plan = Plan(counts=(1, 0, 0), seconds=(0.5, 0.0, 0.0), uses=("fit",), recorded=False)
    drawn = partial(sittings_drawn, seed=3, effects=0, plan=plan)
    _, second = drawn(2)
    (alone,) = drawn(1, first=1)
    assert np.array_equal(alone.theta, second.theta) and alone.seed == second.seed
    assert np.array_equal(alone.streams(0)["head"][1], second.streams(0)["head"][1])


def test_unreadable_events_are_reported(brief_rest: None) -> None:
    streams_of = {name: tuple(part[:40] for part in stream) for name, stream in short_sitting().streams(0).items()}
    cut = SimpleNamespace(
        events=short_sitting().events, streams=lambda index, with_effects: streams_of, seed=0,
        body_mass_kg=70.0, mass_matrix="segment",
    )  # fmt: skip
    found = record(cut)
    assert (found.cases, len(found.left_out)) == ((), 2)
    assert found.left_out[0].startswith("fit/road_1: ")
    answer = answered("strong", 0, found, lambda known: a_trace(dataclasses.replace(known, subject=SUBJECT)))
    assert "held/road_1: " in answer.why
