"""Requirements of a study: the page, the exit code, and what is said of missed marks and recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from blind.requirements import Mark, has_recordings, mark_table, publish

MET, MISSED = Mark("coverage", ">= 90 %", "93 %", True), Mark("delay", "<= 30 s", "36 s", False)


def test_a_missed_mark_is_named_and_fails_the_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    assert publish(page, "of the first run\n", [MET]) == 0
    assert capsys.readouterr().err == ""
    assert publish(page, "of the second run\n", [MET, MISSED]) == 1
    assert capsys.readouterr().err == "blind: missed: delay: 36 s, required <= 30 s\n"
    assert page.read_text(encoding="utf-8") == "of the second run\n"


def test_the_table_has_every_mark_and_stresses_the_missed_ones() -> None:
    header, _, first, second = mark_table([MET, MISSED])
    assert header.startswith("| requirement | required | reached | met |")
    assert first == "| coverage | >= 90 % | 93 % | yes |"
    assert second == "| delay | <= 30 s | 36 s | **no** |"


def test_a_study_says_where_recordings_are_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BIODYN_DATA", str(tmp_path))
    assert has_recordings()
    monkeypatch.setenv("BIODYN_DATA", str(tmp_path / "nowhere"))
    assert not has_recordings()
    assert f"not in {tmp_path / 'nowhere'}: set BIODYN_DATA" in capsys.readouterr().err
