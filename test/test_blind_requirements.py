"""Requirements of a study: the page, the exit code, and what is said of missed marks, recordings, an interruption."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from blind import __main__ as studies
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


def test_an_interruption_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(options: Sequence[str]) -> int:
        assert options == ["--seed", "5"]
        raise KeyboardInterrupt

    monkeypatch.setitem(studies.STUDIES, "tracing", interrupted)
    assert studies.main(["tracing", "--seed", "5"]) == 130
    assert capsys.readouterr().err == "blind: interrupted\n"


def test_an_unknown_study_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["traces"], ["recovery", "--seed", "5"]):
        assert studies.main(arguments) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"blind: '{' '.join(arguments)}' is no study; known are recovery, and with options ")
        assert error.count("\n") == 1
