"""Marks of the blind tracing study: intervals, correct answers, and the requirements of every row."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import pytest
from outcomes import CLOCK, ROWS, SKIN, STOP, outcome

from blind.tracing.marks import Mark, by_class, marks, most_frequent, true_class_results, wilson
from blind.tracing.outcome import Cause, Outcome, site_distance
from blind.tracing.rows import CONDITIONS, DRAWINGS, drawings


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


def test_a_class_is_right_if_it_is_named_first_and_alone() -> None:
    right = outcome("strong", "effect", [SKIN], [SKIN])
    unsure = outcome("strong", "ambiguous", [SKIN], [SKIN], [CLOCK])
    wrong = outcome("strong", "effect", [CLOCK], [SKIN])
    too_many = outcome("strong", "effect", [SKIN, STOP], [SKIN])
    quiet = outcome("strong", "unexplained", [], [SKIN])
    every = (right, unsure, wrong, too_many, quiet)
    assert [one.class_right for one in every] == [True, False, False, True, False]
    assert [one.family_right for one in every] == [True, True, True, False, False]
    assert [one.wrong_single for one in every] == [False, False, True, True, False]
    assert [one.in_set for one in every] == [True, True, False, True, False]
    assert [one.set_size for one in every] == [1, 2, 1, 2, 0]
    assert [one.site_distance for one in every] == [0, None, None, 0, None]
    assert [one.named for one in every] == ["skin", "ambiguous", "clock", "skin", "unexplained"]


@pytest.mark.parametrize(
    ("verdict", "effect", "best", "gain", "against", "fate"),
    [
        ("effect", SKIN, SKIN, 1.0, (), "named"),
        ("effect", CLOCK, CLOCK, 1.0, (), "another class named"),
        ("ambiguous", SKIN, SKIN, 1.0, (), "several named as possible"),
        ("none", None, CLOCK, 0.1, (), "another class had the largest gain"),
        ("not_decidable", None, None, None, (), "another class had the largest gain"),
        ("unexplained", None, SKIN, 1.0, ("f_n ends on a bound",), "the true class had the largest gain"),
        ("none", None, SKIN, 0.1, (), "... as its gain was too small"),
        ("unexplained", None, SKIN, 1.0, (), "... as it removed too little"),
    ],
)
def test_outcomes_of_a_true_class(
    verdict: str, effect: Cause | None, best: Cause | None, gain: float | None, against: tuple[str, ...], fate: str
) -> None:
    plain = outcome("strong", verdict, [effect] if effect else [], [SKIN], before_percent=4.0, floor_percent=2.0)
    answer = dataclasses.replace(plain.answer, best=best, best_gain=gain, against=against, threshold=0.2)
    for oracle_percent, closes in ((3.1, 1), (3.2, 0), (None, 0)):  # squares, of which half way from 16 to 4 is 10
        true = dataclasses.replace(plain.score, oracle_percent=oracle_percent)
        nonzero = {row: counts for row, counts in true_class_results([Outcome(answer, true)]).items() if counts[1]}
        ((row, counts),) = nonzero.items()
        assert row.startswith(fate) and counts == (closes, 1)


# --- rows ------------------------------------------------------------------------------------------------------------


def test_false_alarms_are_counted_in_both_kinds_of_noise() -> None:
    quiet = [outcome("nothing", "none") for _ in range(57)] + [outcome("nothing_coloured", "unexplained")] * 38
    loud = [outcome("nothing", "effect", [SKIN]), outcome("nothing_coloured", "ambiguous", [SKIN], [], [CLOCK])]
    beside = [outcome("background", "effect", [SKIN])] * 10
    row = "nothing hidden, with and without coloured noise"
    mark = judged(row, quiet + loud * 2 + beside)["false alarms"]  # 4 of 99
    assert (mark.records, mark.met, mark.reached) == (99, True, pytest.approx(4 / 99))
    mark = judged(row, quiet + loud * 3)["false alarms"]  # 6 of 101
    assert (mark.met, mark.text) == (False, "5.9 % (2.8 to 12.4) of 101")


def test_background_alone_counts_named_and_added_effects() -> None:
    kept = [outcome("background", "none")] * 17 + [outcome("background", "ambiguous", [SKIN], [], [CLOCK])]
    both = judged("background only, nothing hidden", [*kept, *[outcome("background", "effect", [SKIN])] * 2])
    assert both["a single cause named"].reached == pytest.approx(0.1) and both["a single cause named"].met
    assert both["an effect added to the subject"].reached == pytest.approx(0.15)  # the ambiguous one as well
    assert not both["an effect added to the subject"].met


def test_sensor_noise_counts_class_site_and_error() -> None:
    near = dataclasses.replace(STOP, site="lower_torso")
    far = dataclasses.replace(STOP, site="head")
    records = [
        *[outcome("sensor_noise", "effect", [STOP], [STOP], floor_percent=1.0, after_percent=1.1)] * 17,
        *[outcome("sensor_noise", "effect", [near], [STOP], floor_percent=1.0, after_percent=1.2)] * 2,
        outcome("sensor_noise", "effect", [far], [STOP], floor_percent=1.0, after_percent=None),
    ]
    found = judged("catalogue effect, sensor noise", records)
    assert [mark.reached for mark in found.values()] == pytest.approx([1.0, 0.85, 0.95, 1.1])
    assert all(mark.met for mark in found.values())
    found = judged("catalogue effect, sensor noise", [*records, outcome("sensor_noise", "failed", [], [STOP])])
    assert [mark.met for mark in found.values()] == [True, False, False, True]  # 20, 17 and 19 of 21


def test_background_rows_go_by_the_ratio_of_the_score() -> None:
    records = [
        outcome("strong", "effect", [SKIN], [SKIN], ratio=0.81, recovered=0.9),
        outcome("weak", "ambiguous", [CLOCK], [SKIN], [STOP], ratio=0.8),
        outcome("strong", "effect", [SKIN], [SKIN], ratio=0.41),
        outcome("medium", "effect", [CLOCK], [SKIN], ratio=0.4),
        outcome("medium", "effect", [CLOCK], [SKIN], ratio=None),
        outcome("outside", "effect", [CLOCK], [SKIN], ratio=3.0),
    ]
    strong = judged("with background, ratio > 0.8", records)
    assert [mark.records for mark in strong.values()] == [1, 1, 1]
    between = judged("with background, ratio 0.4 to 0.8", records)
    assert between["truth in the reported set"].reached == 0.5
    assert between["size of the set where there is one, mean"].reached == 1.5
    weak = judged("with background, ratio < 0.4", records)["a wrong single cause named"]
    assert (weak.records, weak.reached, weak.met) == (1, 1.0, False)


def test_energy_recovered_is_a_median_with_zeros_for_the_wrong() -> None:
    values = [0.0, 0.0, 0.7, 0.9, 1.0]
    records = [outcome("strong", "effect", [SKIN], [SKIN], ratio=2.0, recovered=value) for value in values]
    mark = judged("with background, ratio > 0.8", records)["energy recovered, median"]
    assert (mark.reached, mark.met, mark.lower) == (0.7, True, None)
    # A record of which even the oracle takes off nothing has no such value, and is not counted among them.
    records.append(outcome("strong", "effect", [SKIN], [SKIN], ratio=2.0, recovered=None))
    mark = judged("with background, ratio > 0.8", records)["energy recovered, median"]
    assert (mark.records, mark.text) == (6, "0.70 of 5")


def test_an_effect_outside_the_catalogue_may_be_unexplained_or_of_its_family() -> None:
    breath = Cause("outside", "", "memory")
    records = [
        *[outcome("outside", "unexplained", [], [breath], ratio=1.0)] * 7,
        outcome("outside", "effect", [Cause("reflex", "pelvis", "memory")], [breath], ratio=1.0),
        outcome("outside", "none", [], [breath], ratio=1.0),
        outcome("outside", "ambiguous", [SKIN], [breath], [STOP], ratio=1.0),
    ]
    found = judged("effect outside the catalogue, ratio > 0.8", records)
    assert [(mark.reached, mark.met) for mark in found.values()] == [(0.8, True), (0.1, True)]


def test_two_effects_are_found_both_or_one() -> None:
    two = [SKIN, STOP]
    records = [
        *[outcome("two", "effect", [STOP, SKIN], two)] * 6,
        *[outcome("two", "effect", [SKIN, CLOCK], two)] * 3,
        outcome("two", "ambiguous", [SKIN], two, [STOP]),
    ]
    found = judged("two effects", records)
    assert [(mark.reached, mark.met) for mark in found.values()] == [(0.6, True), (0.9, True)]


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
    skin, stop = by_class(records)
    assert (skin.name, skin.records, skin.class_right, skin.family_right, skin.site_right) == ("skin", 3, 1, 2, 1)
    assert skin.named == (("clock", 1), ("skin", 1), ("unexplained", 1))
    assert (stop.records, stop.class_right, stop.named) == (1, 0, (("skin", 1),))
    assert most_frequent(records[:4]) == ("skin", 0.75)
    assert most_frequent([]) == ("", 0.0)
