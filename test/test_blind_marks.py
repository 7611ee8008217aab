"""Marks of the blind tracing study: intervals, correct answers, and the requirements of every row."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import pytest
from outcomes import CLOCK, ROWS, SKIN, STOP, outcome

from blind.tracing.marks import Mark, by_class, marks, most_frequent, true_class_results
from blind.tracing.outcome import Cause, Outcome, site_distance
from blind.tracing.rows import CONDITIONS, DRAWINGS, drawings
from blind.tracing.shares import wilson


def judged(row: str, outcomes: Sequence[Outcome], least: int = 1) -> dict[str, Mark]:
    return {mark.what: mark for mark in marks(outcomes, [dataclasses.replace(ROWS[row], least=least)])}


# --- intervals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hits", "of", "low", "high"),
    [  # Newcombe (1998), Statistics in Medicine 17, 857-872, table I, method 3
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_is_as_published(hits: int, of: int, low: float, high: float) -> None:
    assert wilson(hits, of) == pytest.approx((low, high), abs=5e-5)


# --- what is right ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "site", "other", "away"),
    [
        ("cubic", "central_torso", "upper_torso", 0),  # joints 3 and 4
        ("cubic", "lower_torso", "upper_torso", 1),
        ("cubic", "lower_torso", "neck", 2),
        ("cubic", "pelvis", "head", 4),
        ("backrest", "central_torso", "upper_torso", 1),  # segments, whose forces are distinguishable
        ("skin", "lower_torso", "upper_torso", 1),  # neighbours among sensors
        ("cross_axis", "pelvis", "", 0),  # the whole body is meant
        ("pitch", "seat", "seat", 0),
    ],
)
def test_distances_of_sites(name: str, site: str, other: str, away: int) -> None:
    assert site_distance(name, site, other) == away == site_distance(name, other, site)


CUBIC = Cause("cubic", "pelvis", "stiffening")
"""Of the mechanism of a stop."""


def test_a_class_is_right_if_it_is_named_first_and_alone() -> None:
    right = outcome("strong", "effect", [SKIN], [SKIN])
    variant = outcome("strong", "effect", [CUBIC], [STOP])
    unsure = outcome("strong", "ambiguous", [SKIN], [SKIN], [CLOCK])
    wrong = outcome("strong", "effect", [CLOCK], [SKIN])
    too_many = outcome("strong", "effect", [SKIN, STOP], [SKIN])
    quiet = outcome("strong", "unexplained", [], [SKIN])
    every = (right, variant, unsure, wrong, too_many, quiet)
    assert [one.class_right for one in every] == [True, True, False, False, True, False]
    assert [one.family_right for one in every] == [True, True, True, True, False, False]
    assert [one.wrong_single for one in every] == [False, False, False, True, True, False]
    assert [one.in_set for one in every] == [True, True, True, False, True, False]
    assert [one.set_size for one in every] == [1, 1, 2, 1, 2, 1]
    assert [one.site_distance for one in every] == [0, 0, None, None, 0, None]
    assert [one.named for one in every] == [
        "skin", "nonlinear_stiffness", "ambiguous", "clock", "skin", "unexplained"
    ]  # fmt: skip


BREATH = Cause("outside", "", "memory")


@pytest.mark.parametrize(
    ("true", "ratio", "right"),
    [
        ([], None, {"none"}),
        ([STOP], 0.4, {"nonlinear_stiffness"}),
        ([STOP], 0.2, {"nonlinear_stiffness", "none"}),
        ([BREATH], 2.0, {"outside"}),
        ([SKIN, STOP], None, {"skin", "nonlinear_stiffness"}),
    ],
)
def test_right_answers(true: list[Cause], ratio: float | None, right: set[str]) -> None:
    assert outcome("strong", "none", [], true, ratio=ratio).right_answers == right


@pytest.mark.parametrize(
    ("verdict", "effect", "probabilities", "likely", "fate"),
    [
        ("effect", SKIN, {"skin": 0.9}, ("skin",), "named"),
        ("effect", CLOCK, {"clock": 0.9}, ("clock",), "another class named"),
        ("ambiguous", SKIN, {"skin": 0.6, "clock": 0.4}, ("skin", "clock"), "the most probable answer, with less"),
        ("none", None, {"none": 0.6, "skin": 0.4}, ("none", "skin"), "another answer is more probable, and it is in"),
        ("none", None, {"none": 0.9, "skin": 0.1}, ("none",), "another answer is more probable, and it is not in"),
        ("not_decidable", None, {}, (), "another answer is more probable, and it is not in"),
    ],
)
def test_outcomes_of_a_true_class(
    verdict: str, effect: Cause | None, probabilities: dict[str, float], likely: tuple[str, ...], fate: str
) -> None:
    plain = outcome("strong", verdict, [effect] if effect else [], [SKIN], before_percent=4.0, floor_percent=2.0)
    answer = dataclasses.replace(plain.answer, probabilities=probabilities, likely=likely)
    for oracle_percent, closes in ((3.1, 1), (3.2, 0), (None, 0)):  # squares, of which half way from 16 to 4 is 10
        true = dataclasses.replace(plain.score, oracle_percent=oracle_percent)
        nonzero = {row: counts for row, counts in true_class_results([Outcome(answer, true)]).items() if counts[2]}
        ((row, counts),) = nonzero.items()
        assert row.startswith(fate) and counts == (closes, int(oracle_percent is not None), 1)


def test_the_closed_share_is_of_the_squared_gap() -> None:
    score = outcome("strong", "effect", [SKIN], [SKIN], before_percent=5.0, floor_percent=3.0).score
    assert score.closed(3.0) == 1.0 and score.closed(5.0) == 0.0 == score.closed(None)
    assert score.closed(4.0) == pytest.approx((25.0 - 16.0) / (25.0 - 9.0))
    assert dataclasses.replace(score, floor_percent=5.0).closed(4.0) is None


# --- rows ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("row", "drawing"),
    [
        ("nothing hidden, sensor noise", "nothing"),
        ("nothing hidden, loud coloured noise", "nothing_coloured"),
        ("nothing hidden, background", "background"),
    ],
)
def test_named_causes_are_counted_for_each_kind_of_noise(row: str, drawing: str) -> None:
    quiet = [outcome(drawing, "none")] * 50 + [outcome(drawing, "unexplained")] * 6
    quiet += [outcome(drawing, "ambiguous", [SKIN], [], [CLOCK])] * 2  # no single cause
    beside = [outcome("strong", "effect", [SKIN])] * 10
    found = judged(row, [*quiet, *[outcome(drawing, "effect", [SKIN])] * 3, *beside])  # 3 of 61
    mark = found["a single cause named"]
    assert (mark.records, mark.met, mark.reached) == (61, True, pytest.approx(3 / 61))
    assert mark.text == "4.9 % (1.7 to 13.5) of 61" and found["a verdict is given"].met
    found = judged(row, [*quiet, *[outcome(drawing, "effect", [SKIN])] * 4, outcome(drawing, "not_decidable")])
    assert not any(one.met for one in found.values())


def test_sensor_noise_counts_class_site_and_errors() -> None:
    near = dataclasses.replace(STOP, site="lower_torso")
    far = dataclasses.replace(STOP, site="head")
    common = {"ratio": 0.31, "floor_percent": 1.0, "before_percent": 3.0}
    records = [
        *[outcome("sensor_noise", "effect", [STOP], [STOP], **common, after_percent=1.1, oracle_percent=1.0)] * 17,
        *[outcome("sensor_noise", "effect", [near], [STOP], **common, after_percent=1.3, oracle_percent=3.0)] * 2,
        outcome("sensor_noise", "effect", [far], [STOP], **common, after_percent=None),
    ]
    found = judged("sensor noise, ratio > 0.3", records)
    assert [mark.reached for mark in found.values()] == pytest.approx([1.0, 0.95, 1.1, 1.0])
    assert all(mark.met for mark in found.values())
    failed = [outcome("sensor_noise", "failed", [], [STOP], ratio=0.5)] * 4
    found = judged("sensor noise, ratio > 0.3", [*records, *failed])
    assert [mark.met for mark in found.values()] == [False, False, True, True]  # 20 and 19 of 24
    weak = [outcome("sensor_noise", "failed", [], [STOP], ratio=0.29)] * 40
    assert judged("sensor noise, ratio > 0.3", [*records, *weak])["class"].records == 20


def test_background_rows_go_by_the_ratio_of_the_score() -> None:
    strong = {"ratio": 0.81, "before_percent": 5.0, "floor_percent": 3.0}
    records = [
        outcome("strong", "effect", [SKIN], [SKIN], **strong, after_percent=3.0),
        outcome("strong", "effect", [SKIN], [SKIN], **strong, after_percent=4.0),
        outcome("medium", "none", [], [SKIN], **strong),
        outcome("weak", "ambiguous", [CLOCK], [SKIN], [SKIN, STOP], ratio=0.8),
        outcome("strong", "effect", [SKIN], [SKIN], ratio=0.41),
        outcome("medium", "effect", [CLOCK], [SKIN], ratio=0.4),
        outcome("medium", "effect", [CLOCK], [SKIN], ratio=None),
        outcome("outside", "effect", [CLOCK], [SKIN], ratio=3.0),
    ]
    above = judged("with background, ratio > 0.8", records)
    assert {mark.records for mark in above.values()} == {3}
    assert above["class"].reached == above["in the 90 % set"].reached == pytest.approx(2 / 3)
    assert above["size of the set, mean"].reached == 1.0
    closed = above["closed share of the gap, median"]
    assert (closed.reached, closed.lower) == (pytest.approx(9.0 / 16.0), None)
    between = judged("with background, ratio 0.4 to 0.8", records)
    assert (between["class"].reached, between["in the 90 % set"].reached) == (0.5, 1.0)


def test_a_wrong_single_cause_is_counted_outside_the_catalogue() -> None:
    records = [
        *[outcome("outside", "unexplained", [], [BREATH], ratio=1.0)] * 17,
        *[outcome("outside", "effect", [Cause("reflex", "pelvis", "memory")], [BREATH], ratio=1.0)] * 3,
        outcome("outside", "effect", [SKIN], [BREATH], ratio=0.7),
    ]
    (mark,) = judged("effect outside the catalogue, ratio > 0.8", records).values()
    assert (mark.reached, mark.met) == (0.15, True)


def test_calibration_counts_the_most_probable_answers() -> None:
    records = [
        *[outcome("background", "none", p=0.9)] * 9,
        outcome("background", "effect", [SKIN], p=0.9),
        *[outcome("strong", "unexplained", [], [SKIN], ratio=1.0, p=0.6)] * 2,
        outcome("outside", "unexplained", [], [BREATH], ratio=2.0, p=0.6),
        outcome("strong", "not_decidable", [], [SKIN]),
        outcome("two", "effect", [CLOCK], [SKIN, STOP]),
    ]
    sure, error = judged("calibration", records).values()
    assert (sure.reached, sure.values, sure.met) == (0.9, 10, True)
    assert error.reached == pytest.approx((0.0 + 3.0 * (0.6 - 1.0 / 3.0)) / 13.0) and not error.met
    assert error.text == "0.062 of 13" and error.required == "<= 0.05"


def test_two_effects_are_found_both_or_one() -> None:
    two = [SKIN, STOP]
    records = [
        *[outcome("two", "effect", [STOP, SKIN], two)] * 6,
        *[outcome("two", "effect", [SKIN, CLOCK], two)] * 3,
        outcome("two", "ambiguous", [SKIN], two, [STOP]),
    ]
    found = judged("two effects", records)
    assert [(mark.reached, mark.met) for mark in found.values()] == [(0.9, True), (0.6, True)]


def test_two_effects_of_one_class_need_two_names() -> None:
    cubic = Cause("cubic", "head", "stiffening")
    assert cubic.mechanism == STOP.mechanism
    records = [outcome("two", "effect", named, [STOP, cubic]) for named in ([cubic], [cubic, STOP])]
    found = judged("two effects", records)
    assert [mark.reached for mark in found.values()] == [1.0, 0.5]


def test_a_row_with_too_few_records_misses_its_marks() -> None:
    records = [outcome("two", "effect", [SKIN, STOP], [SKIN, STOP])] * 39
    assert not any(mark.met for mark in judged("two effects", records, least=40).values())
    assert not any(mark.met for mark in judged("two effects", [], least=0).values())


def test_every_condition_has_enough_drawings() -> None:
    counts = {one.name: one.count for one in DRAWINGS}
    for row in CONDITIONS:
        assert sum(counts[name] for name in row.drawings) >= row.least
        assert row.least >= 40
        assert (row.filled_from in row.drawings) is (row.ratio is not None)
    assert {name for row in CONDITIONS for name in row.drawings} == set(counts)
    assert {one.name for one in DRAWINGS if one.effects < 2} == set(ROWS["calibration"].drawings)
    with pytest.raises(ValueError, match="'elsewhere' is unknown, known are nothing,"):
        drawings(["elsewhere"])
    assert [(one.name, one.count) for one in drawings(["two", "weak"], 3)] == [("two", 3), ("weak", 3)]


def test_classes_are_counted_beside_the_most_frequent_one() -> None:
    records = [
        outcome("strong", "effect", [SKIN], [SKIN]),
        outcome("strong", "effect", [CLOCK], [SKIN]),
        outcome("strong", "unexplained", [], [SKIN]),
        outcome("strong", "effect", [SKIN], [STOP]),
        outcome("background", "none"),
    ]
    stop, skin = by_class(records)
    assert (skin.name, skin.records, skin.class_right, skin.family_right, skin.site_right) == ("skin", 3, 1, 2, 1)
    assert skin.named == (("clock", 1), ("skin", 1), ("unexplained", 1))
    assert (stop.records, stop.class_right, stop.named) == (1, 0, (("skin", 1),))
    assert most_frequent(records[:4]) == ("skin", 0.75)
    assert most_frequent([]) == ("", 0.0)
