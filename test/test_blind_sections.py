"""Sections of the page of the study: probabilities, pictures, confusion and speed."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from outcomes import CLOCK, ROWS, SKIN, STOP, outcome

from blind.tracing import sections, table
from blind.tracing.marks import marks
from blind.tracing.outcome import Cause, Outcome
from blind.tracing.page import rendered
from blind.tracing.pictures import BY_RATIO, RELIABILITY
from blind.tracing.sections import ceiling_lines, confusion_lines, pictures, ratio_lines, reliability_lines, speed_lines
from blind.tracing.shares import share_text
from blind.tracing.table import PAGE, PICTURES, RUNS, About, publish

WITHOUT = "This run has no probabilities."
RATIOS = np.geomspace(0.11, 6.0, 60).tolist()
ABOUT = About("2026-01-02", "abc", 7, "f" * 64, "e" * 64, 5, "2 cores, ACME")


def silent(one: Outcome) -> Outcome:
    """The outcome as runs before the probabilities have it."""
    return Outcome(dataclasses.replace(one.answer, probabilities={}, likely=()), one.score)


def run() -> list[Outcome]:
    """A step: effects are named from a ratio of 0.8; weaker ones are called unexplained."""
    records = [outcome("background", "none", p=0.95)] * 19 + [outcome("background", "effect", [SKIN], p=0.95)]
    for ratio in RATIOS:
        if ratio > 0.8:
            records.append(outcome("strong", "effect", [SKIN], [SKIN], ratio=ratio, p=0.95))
        else:
            records.append(outcome("strong", "unexplained", [], [SKIN], ratio=ratio, p=0.51))
    return records


def rows_of(lines: list[str]) -> list[list[str]]:
    return [line.strip("| ").split(" | ") for line in lines if line.startswith("|")]


def test_the_reliability_has_its_bins_and_its_error() -> None:
    lines = reliability_lines([*run(), outcome("weak", "not_decidable", [], [SKIN]), outcome("two", "none")])
    assert f"](pictures/{RELIABILITY})" in "\n".join(lines) and "Further 1 records have no answer." in lines[2]
    _, _, *rows = rows_of(lines)
    named = sum(ratio > 0.8 for ratio in RATIOS)
    assert [row[:3] for row in rows] == [
        ["0.5 to 0.6", str(60 - named), "0.51"],
        ["0.9 to 1.0", str(20 + named), "0.95"],
    ]
    assert rows[0][3] == share_text(0, 60 - named) and rows[1][3] == share_text(19 + named, 20 + named)
    error = ((60 - named) * 0.51 + abs(19 + named - 0.95 * (20 + named))) / 80.0
    assert f"The expected calibration error is {error:.3f}." in lines[2]


def test_perfect_answers_have_no_calibration_error() -> None:
    lines = reliability_lines([outcome("nothing", "none", p=1.0)] * 12)
    assert "error is 0.000." in lines[2] and "have 0.000 by chance (median), and less than 0.000" in lines[2]


def test_the_ceiling_is_that_of_records_with_the_true_law() -> None:
    def ideal(one: Outcome, p: float, *likely: str) -> Outcome:
        score = dataclasses.replace(one.score, ceiling={"skin": p, "none": 1.0 - p}, ceiling_likely=likely)
        return Outcome(one.answer, score)

    records = [
        ideal(outcome("strong", "effect", [SKIN], [SKIN], ratio=1.0, p=0.95), 0.9, "skin"),
        ideal(outcome("strong", "none", [], [SKIN], ratio=1.0), 0.85, "skin"),
        ideal(outcome("strong", "none", [], [SKIN], ratio=1.0), 0.6, "skin", "none"),
        ideal(outcome("strong", "none", [], [SKIN], ratio=1.0), 0.1, "none"),
        ideal(outcome("strong", "none", [], [STOP], ratio=1.0), 0.9, "skin"),
        outcome("strong", "effect", [SKIN], [SKIN], ratio=1.0),
    ]
    found = marks(records)
    lines = ceiling_lines(records, found)
    *_, by_class, by_set = rows_of(lines)
    assert by_class[:3] == ["with background, ratio > 0.8", "class", ">= 80 %"] and by_set[1] == "in the 90 % set"
    # A record without a ceiling is missed with the true law, and stays in the number.
    assert by_class[3:] == [share_text(2, 6), share_text(2, 6), "1"]
    assert by_set[3:] == [share_text(2, 6), share_text(3, 6), "1"]
    missed = next(line for line in lines if line.startswith("Missed marks that have no ceiling"))
    assert "two effects: both found" in missed and "ratio > 0.8: class" not in missed
    assert "\n".join(lines) in rendered(records, found, "Run.")
    assert ceiling_lines(records[-1:], found) == []


def test_the_ceiling_of_two_effects_is_that_of_each_alone() -> None:
    def two(skin: float, stop: float, found: Sequence[Cause] = ()) -> Outcome:
        one = outcome("two", "effect" if found else "none", list(found), [SKIN, STOP])
        alone = tuple({cause.mechanism: p, "none": 1.0 - p} for cause, p in ((SKIN, skin), (STOP, stop)))
        return Outcome(one.answer, dataclasses.replace(one.score, ceilings_alone=alone))

    records = [two(0.9, 0.95, found=[SKIN]), two(0.9, 0.5), two(0.7, 0.5), two(0.7, 0.9)]
    one, both = rows_of(ceiling_lines(records, marks(records)))[-2:]
    assert one == ["two effects", "one right", ">= 85 %", share_text(1, 4), share_text(3, 4), "0"]
    assert both == ["two effects", "both found", ">= 45 %", share_text(0, 4), share_text(1, 4), "0"]


def test_the_accuracy_of_a_step_goes_from_none_to_all() -> None:
    lines = ratio_lines(run())
    assert f"](pictures/{BY_RATIO})" in "\n".join(lines)
    head, _, *rows = rows_of(lines)
    assert head[:4] == ["ratio, with a background", "records", "named rightly", "curve"] and len(head) == 8
    assert [row[0] for row in rows] == ["0 to 0.2", "0.2 to 0.4", "0.4 to 0.8", "0.8 to 1.6", "1.6 to 3.2", "above 3.2"]
    assert [row[2].partition(" ")[0] for row in rows] == ["0.0"] * 3 + ["100.0"] * 3
    assert [row[3].partition(" ")[0] for row in (rows[0], rows[-1])] == ["0", "100"]


def test_the_matrix_counts_true_class_and_most_probable_answer() -> None:
    records = [
        *[outcome("strong", "effect", [SKIN], [SKIN])] * 3,
        outcome("strong", "ambiguous", [CLOCK], [SKIN]),
        outcome("strong", "none", [], [STOP]),
        outcome("strong", "failed", [], [STOP]),
        outcome("background", "none"),
    ]
    lines = confusion_lines(records)
    assert lines[2:] == [
        "| true class | 1 | 2 | 3 | none | no answer |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
        "| 1 clock |  |  |  |  |  |",
        "| 2 nonlinear_stiffness |  |  |  | 1 | 1 |",
        "| 3 skin | 1 |  | **3** |  |  |",
        "",
    ]
    assert confusion_lines([silent(one) for one in records]) == [] == confusion_lines([])


def test_the_answers_of_a_class_are_in_the_matrix_or_in_a_list() -> None:
    records = [
        outcome("strong", "effect", [CLOCK], [SKIN], ratio=1.0),
        outcome("strong", "none", [], [SKIN], ratio=0.1),
    ]
    page = rendered(records, marks(records), "Run.")
    assert "| skin | 1 | 0 | 1 | 0 | 0 |\n" in page and "| 2 skin | 1 |  |" in page and "clock 1" not in page
    before = [silent(one) for one in records]
    page = rendered(before, marks(before), "Run.")
    assert "| skin | 1 | 0 | 1 | 0 | 0 | clock 1 |" in page and "| 2 skin |" not in page


def test_the_speed_is_that_of_all_traces() -> None:
    """Of 1 to 101 s the median is 51 s and the quantile 95 % 96 s."""
    plain = outcome("two", "none")
    records = [Outcome(dataclasses.replace(plain.answer, seconds=float(s)), plain.score) for s in range(1, 102)]
    measured = outcome("measured", "none")
    (_, _, words, _) = speed_lines([*records, *[measured] * 50])
    assert "median 51.0 s, 95th percentile 96.0 s, longest 101.0 s." in words and words.startswith("101 traces,")
    assert speed_lines([measured]) == []
    row = dataclasses.replace(ROWS["speed"], least=1)
    assert [(one.reached, one.values, one.met) for one in marks(records, [row])] == [
        (51.0, 101, True),
        (1.0, 101, True),
    ]
    late = [Outcome(dataclasses.replace(plain.answer, seconds=180.0), plain.score)] * 6
    assert [one.met for one in marks([*records, *late], [row])] == [True, False]  # 101 of 107
    assert not any(one.met for one in marks(late, [row]))


def test_a_run_without_probabilities_says_so() -> None:
    before = [silent(one) for one in run()]
    assert reliability_lines(before) == ["## Reliability", "", WITHOUT, ""]
    assert ratio_lines(before) == ["## Accuracy against ratio", "", WITHOUT, ""]
    assert pictures(before) == {} and rendered(before, marks(before), "Run.").count(WITHOUT) == 2


def test_the_pictures_are_files_of_their_own() -> None:
    drawn = pictures(run())
    assert set(drawn) == {RELIABILITY, BY_RATIO} and pictures(run()) == drawn
    for svg in drawn.values():
        root = ET.fromstring(svg)
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert root.find(".//{*}path").get("style") == "fill: #ffffff"  # readable on a dark page
        assert not re.search(r"NaN|nan|https?://(?!www\.w3\.org)", svg)
        texts = {one.text for one in root.iterfind(".//{*}text")}
        assert texts & {"probability of the most probable answer", "ratio of the hidden effect"}
    panel = ET.fromstring(drawn[BY_RATIO])
    titles = [one.text for one in panel.iterfind(".//{*}text") if "with a background" in (one.text or "")]
    assert len(titles) == 3


def test_the_page_is_published_with_its_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    records = run()
    monkeypatch.setattr(table, "pictures", lambda outcomes: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        publish(tmp_path, ABOUT, records, marks(records))
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(table, "pictures", sections.pictures)
    publish(tmp_path, ABOUT, records, marks(records))
    page = (tmp_path / PAGE).read_text()
    assert "on 2 cores, ACME." in page and (tmp_path / RUNS).exists()
    shown = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page)
    assert sorted(shown) == sorted(f"pictures/{one.name}" for one in (tmp_path / PICTURES).iterdir())
    assert all((tmp_path / PAGE.parent / one).exists() for one in shown)
