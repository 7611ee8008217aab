"""Publication of the blind tracing study: its table of runs and its page."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from blind_answers import answers, in_sequence, scores
from outcomes import CLOCK, ROWS, SKIN, STOP, outcome

from blind.tracing import __main__ as command
from blind.tracing import streams, study
from blind.tracing.marks import marks
from blind.tracing.outcome import Outcome
from blind.tracing.page import rendered
from blind.tracing.rows import CONDITIONS, DRAWINGS, FILLING, MEASURED
from blind.tracing.table import PAGE, RUNS, About, publish

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
    assert "| strong | 1.00 | 1 | 2.00 | 4.00 | 4.00 | - | 0 | - | - | - |" in text
    assert all(rule.what in text for row in CONDITIONS for rule in row.rules)
    assert "**missed**, as it has fewer than 60 records" in text
    assert "| another class named | 0 | 0 | 1 |" in text


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
