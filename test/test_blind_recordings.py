"""Further recordings: parts of one sitting, their storage, and the answers to them."""

from __future__ import annotations

import dataclasses
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_blind_learning import FRICTION, example
from test_probability import EVIDENCE, random_model
from world.effects.sitting import Plan, Sitting, _planned, draft_of
from world.seats import CASES

from biodyn_core.tracing.findings import FurtherRecordings
from blind.tracing.outcome import Cause
from blind.training import collect as collecting
from blind.training import recordings
from blind.training.calibrate import Prediction
from blind.training.ideal import IdealDecision
from blind.training.learn import labelled
from blind.training.recordings import AMOUNTS, SETTINGS, Answers, answered, collect, made, recorded, stored, summary
from blind.training.report import recordings_lines
from blind.training.traced import TracedBody

PLAN = Plan((9, 9, 9), (0.2, 4.0, 4.0), SETTINGS.uses, recorded=False)


BRIEF = dataclasses.replace(SETTINGS, counts=((1, 1),) * 3, seconds=((2.0, 2.0),) * 3, levels=())
"""Settings of bodies of which only the effects are looked at."""


@cache
def sitting() -> Sitting:
    """A sitting that is not simulated: every event has its place as its motion."""
    draft = draft_of(3, 7, PLAN, np.random.default_rng(1))
    kept = tuple(one for one in draft.events if one.use == "fit" or one.name[-1] in "13579")
    places = tuple(np.array([i]) for i in range(len(kept)))
    return dataclasses.replace(draft, events=kept, plain=places, hidden=places)


def test_each_amount_is_a_part_of_one_sitting() -> None:
    """... of which every second held-out event is for choosing."""
    whole = sitting()
    parts = {amount.name: recorded(whole, amount) for amount in AMOUNTS}
    counts = {name: Counter((one.use, one.event.case) for one in part.events) for name, part in parts.items()}
    assert [counts["least"]["fit", case] for case in CASES] == [3, 3, 3]
    assert [counts["least"]["held", case] for case in CASES] == [2, 2, 2]
    assert [counts[name]["fit", "road"] for name in ("road", "shocks", "levels", "all")] == [6, 3, 6, 9]
    assert [counts[name]["fit", "rail"] for name in ("road", "shocks", "levels", "all")] == [3, 6, 6, 9]
    for part in parts.values():
        places = [int(one[0]) for one in part.hidden]
        assert part.events == tuple(whole.events[i] for i in places) and part.plain == part.hidden
    assert parts["all"].events == whole.events


def test_the_last_events_have_half_the_motion() -> None:
    plan = Plan((4, 0, 0), (0.2, 0.1, 0.1), ("fit",), recorded=False)
    full, half = (
        [one.event for one in _planned(dataclasses.replace(plan, levels=levels), np.random.default_rng(1))]
        for levels in ((), (1.0, 1.0, 0.5))
    )
    for i, level in enumerate((1.0, 1.0, 0.5, 1.0)):
        np.testing.assert_array_equal(half[i].accel_mps2, level * full[i].accel_mps2)
        np.testing.assert_array_equal(half[i].angle_rad, level * full[i].angle_rad)
        assert half[i].begin_s == full[i].begin_s


def test_every_body_has_an_example_of_each_amount(monkeypatch: pytest.MonkeyPatch) -> None:
    """... with the evidence of that part and the body's own cause, and none if the body runs away."""
    seen = []

    def traced(one: Sitting, cause: Cause) -> TracedBody:
        seen.append((len(one.events), cause))
        return TracedBody(0.7, EVIDENCE, None)

    wild = dataclasses.replace(sitting(), hidden=tuple(np.array([np.nan]) for _ in sitting().events))
    monkeypatch.setattr(recordings, "traced", traced)
    monkeypatch.setattr(recordings, "sittings", lambda *_: iter([sitting(), wild]))
    first, second = made([5, 6], 7, BRIEF)
    assert [count for count, _ in seen] == [len(recorded(sitting(), amount).events) for amount in AMOUNTS]
    assert list(first) == [amount.name for amount in AMOUNTS]
    for one, (_, cause) in zip(first.values(), seen, strict=True):
        assert one.number == 5 and one.evidence is EVIDENCE and one.causes == (cause,) and one.ratio == 0.7
    assert all(one.number == 6 and one.evidence is None for one in second.values())


def of_amounts(number: int, ratio: float = 1.0) -> dict:
    one = dataclasses.replace(example(FRICTION, ratio=ratio, number=number), with_true_law=EVIDENCE)
    return {amount.name: one for amount in AMOUNTS}


def test_bodies_are_collected_once_and_stored_by_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A body that has not all amounts, because the collection was interrupted, is collected again."""
    asked: list[int] = []

    def found(numbers, seed):
        asked.extend(numbers)
        return [of_amounts(number) for number in numbers]

    monkeypatch.setattr(recordings, "_found", found)
    monkeypatch.setattr(collecting, "ProcessPoolExecutor", ThreadPoolExecutor)
    folder = tmp_path / "recordings"
    assert stored(folder) == []
    collect(range(8), 1, folder, 1, lambda text: None)
    assert sorted(asked) == list(range(8)) and [number for number, _ in stored(folder)] == list(range(8))
    (folder / "all.jsonl.xz").unlink()
    assert stored(folder) == []
    collect(range(9), 1, folder, 1, lambda text: None)
    assert sorted(asked[8:]) == list(range(9)) and [number for number, _ in stored(folder)] == list(range(9))
    assert {path.name for path in folder.iterdir()} == {f"{amount.name}.jsonl.xz" for amount in AMOUNTS}


LABELS = [labelled(example(*causes, number=n))[0] for n, causes in enumerate([(FRICTION,), ()])]
NO_DECISION = IdealDecision.of(LABELS, [])
"""Learned from two bodies without a true law."""


def test_the_table_has_a_row_for_each_ratio_and_amount() -> None:
    untraced = {**of_amounts(3), "shocks": dataclasses.replace(example(FRICTION), evidence=None)}
    bodies = [(1, of_amounts(1, 0.5)), (2, of_amounts(2, 1.0)), (3, untraced)]
    found = answered(bodies, random_model(), NO_DECISION)
    assert [len(one.catalogue) for one in found.values()] == [2] * len(AMOUNTS)
    assert [len(one.learned) for one in found.values()] == [2] * len(AMOUNTS)
    lines = recordings_lines(found, 0.8)
    rows = [line for line in lines if line.startswith(("| 0.4 to 0.8: ", "| 0.8 to 1.5: "))]
    assert len(rows) == 2 * len(AMOUNTS) and not any("above 1.5" in line for line in lines)
    assert all(row.split("|")[2].strip() == "1" for row in rows)
    nothing = answered([], random_model(), NO_DECISION)
    assert recordings_lines(nothing, 0.8) == [] and summary(nothing, 0.8) == ()


def test_right_names_are_counted_for_each_amount() -> None:
    """Of three bodies one is named, and one more has its mechanism as the best answer; a weak one is left out."""
    label = labelled(example(FRICTION))[0]
    right = ("dry_friction",)
    of = [Prediction(label, {name: p, "none": 1.0 - p}, right) for name, p in
          (("dry_friction", 0.9), ("dry_friction", 0.7), ("clock", 0.95))]  # fmt: skip
    of.append(Prediction(labelled(example(FRICTION, ratio=0.2))[0], {"dry_friction": 0.9, "none": 0.1}, right))
    # The ratio by more data is another one; the least data decide.
    strong = [dataclasses.replace(one, labelled=label) for one in of]
    unsure = [dataclasses.replace(one, answers={"dry_friction": 0.6, "none": 0.4}) for one in of]
    found = {amount.name: Answers(strong, [], []) for amount in AMOUNTS} | {AMOUNTS[0].name: Answers(unsure, [], [])}
    least, *more = summary(found, 0.8)
    assert least == FurtherRecordings(AMOUNTS[0].words, 3, 0, 3)
    assert more == [FurtherRecordings(amount.words, 3, 1, 2) for amount in AMOUNTS[1:]]
