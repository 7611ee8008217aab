"""Ledgers of blind runs: compressed answers, and seals that hold for them."""

from __future__ import annotations

import lzma
import shutil
from pathlib import Path

import pytest

from blind.tracing import ledger, study
from blind.tracing.study import BrokenSeal

LEDGERS = Path(__file__).resolve().parents[1] / "docs" / "tracing_ledger"
RUNS = {"1647660015": 1, "297563109": 1, "1817552077": 1, "706654038": 2}
"""Batches of each run."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of a ledger with two batches."""
    return Path(shutil.copytree(LEDGERS / "706654038", tmp_path / "706654038"))


def rewrite(folder: Path, lines: list[str]) -> None:
    (folder / study.ARCHIVE).write_bytes(lzma.compress(("\n".join(lines) + "\n").encode()))


def test_every_ledger_is_compressed_and_verified(capsys: pytest.CaptureFixture[str]) -> None:
    folders = sorted(path for path in LEDGERS.iterdir() if path.is_dir())
    assert [path.name for path in folders] == sorted(RUNS)
    assert ledger.main([str(path) for path in folders]) == 0
    printed = capsys.readouterr().out
    for path in folders:
        assert not (path / study.ANSWERS).exists()
        seals = (path / study.SEAL).read_text().split()
        assert len(seals) == RUNS[path.name]
        assert all(seal in printed for seal in seals)


def test_changed_answers_in_an_archive_are_detected(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = ledger.answer_lines(folder)
    verdict = next(line for line in lines[-20:] if '"verdict": "none"' in line)
    changed = [line.replace('"none"', '"effect"') if line is verdict else line for line in lines]
    for other in (changed, lines[1:], lines[:-1], [*lines, lines[0]], [lines[-1], *lines[:-1]]):
        rewrite(folder, other)
        assert ledger.main([str(folder)]) == 2
        assert "do not fit the answers" in capsys.readouterr().err
    rewrite(folder, lines)
    assert ledger.main([str(folder)]) == 0


def test_a_damaged_archive_or_missing_seal_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    archive = folder / study.ARCHIVE
    archive.write_bytes(archive.read_bytes()[:-100])
    assert ledger.main([str(folder)]) == 2
    assert "cannot be read" in capsys.readouterr().err
    (folder / study.SEAL).unlink()
    with pytest.raises(BrokenSeal, match="not finished"):
        ledger.verify(folder)


def test_an_unpacked_run_can_continue_and_packs_to_the_same_answers(folder: Path) -> None:
    before = lzma.decompress((folder / study.ARCHIVE).read_bytes())
    study.unpack(folder)
    plain = folder / study.ANSWERS
    assert plain.read_bytes() == before
    plain.write_bytes(before + b"later")
    study.unpack(folder)
    assert plain.read_bytes() == before + b"later"  # answers of a run in progress stay
    plain.write_bytes(before)
    ledger.pack(folder)
    assert not plain.exists()
    assert lzma.decompress((folder / study.ARCHIVE).read_bytes()) == before
