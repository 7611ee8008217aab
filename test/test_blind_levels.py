"""Louder recordings of the records of a run: their motion, their groups, and the table."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from blind_answers import FEW, a_score, an_answer
from outcomes import SKIN
from world.effects.sitting import Plan, draft_of

from biodyn_core.tracing.findings import LouderRecordings
from blind import levels
from blind.levels import Louder, louder, table
from blind.tracing import study
from blind.tracing.outcome import Outcome, line_of
from blind.tracing.study import BrokenSeal

ONE = Louder("strong", 3, "skin", 1.2, True, True, True, True, (False, True, False, True))


OTHER = dataclasses.replace(ONE, number=4)


def test_roads_and_shocks_have_their_own_level() -> None:
    draft = draft_of(3, 7, Plan((1, 1, 1), (0.2, 4.0, 4.0), ("fit",), recorded=False), np.random.default_rng(1))
    for was, now in zip(draft.events, louder(draft, 1.5, 3.0).events, strict=True):
        level = 1.5 if was.event.case == "road" else 3.0
        np.testing.assert_allclose(now.event.accel_mps2, level * was.event.accel_mps2)
        assert now.event.begin_s == was.event.begin_s and now.name == was.name


def test_records_are_drawn_in_groups_of_close_numbers() -> None:
    found = [Outcome(an_answer(FEW[1], number), a_score(FEW[1], an_answer(FEW[1], number))) for number in (9, 0, 5, 6)]
    assert [[one.answer.number for one in group] for group in levels._groups(found)] == [[0, 5], [6, 9]]
    assert not list(levels._groups([]))


def test_the_table_counts_both_recordings() -> None:
    other = dataclasses.replace(ONE, number=4, mechanism="gain", named=False, named_by_ceiling=False)
    lines = table([ONE, other]).splitlines()
    assert lines[2].startswith("| named | 0.0 % (0.0 to 65.8) | 50.0 %")
    assert lines[4].startswith("| named by the ceiling | 0.0 %") and "| 50.0 %" in lines[4]
    assert lines[-2:] == ["| gain: named by the ceiling | 0 of 1 | 0 |", "| skin: named by the ceiling | 0 of 1 | 1 |"]


def test_the_published_counts_are_those_of_each_mechanism() -> None:
    other = dataclasses.replace(ONE, number=4, named=False, before=(True, True, True, True))
    gain = dataclasses.replace(ONE, mechanism="gain", named_by_ceiling=False)
    assert levels.by_mechanism([ONE, other, gain], 1.5) == [
        LouderRecordings("gain", 1.5, 1, 0, 1, 0, 0), LouderRecordings("skin", 1.5, 2, 1, 1, 1, 2),
    ]  # fmt: skip


def test_results_are_stored_and_a_run_is_read(tmp_path: Path) -> None:
    path = tmp_path / "louder.jsonl"
    assert not list(levels._stored(path, "this")) and not list(levels._stored(None, "this"))
    for one in (ONE, OTHER):
        levels._store(path, "this", json.dumps(asdict(one)) + "\n")
    assert list(levels._stored(path, "this")) == [ONE, OTHER]
    with pytest.raises(BrokenSeal, match="the results of this, not of that"):
        list(levels._stored(path, "that"))
    answer = an_answer(FEW[1], 2)
    score = dataclasses.replace(a_score(FEW[1], answer), causes=(SKIN,))
    (tmp_path / study.ANSWERS).write_text(line_of(answer) + "\n", encoding="utf-8")
    (tmp_path / study.SCORES).write_text(line_of(score) + "\n", encoding="utf-8")
    assert levels.outcomes(tmp_path) == [Outcome(answer, score)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["folder", "--condition", "two effects"], "invalid choice"),
        (["nowhere"], "nowhere is no folder of a run: it has no plan.json"),
        (["nowhere", "--road", "2", "--publish"], "--publish needs one level"),
    ],
)
def test_wrong_commands_are_refused(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        levels.main(arguments)
    assert ended.value.code == 2 and message in capsys.readouterr().err
