"""The checkpoint of the long parts of a trace."""

import json
from pathlib import Path

import pytest

from biodyn_core.base.errors import InputError
from biodyn_ros.work.part_store import MAX_PARTS, PartStore


def test_parts_are_read_back_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "out.kept.json"
    PartStore(path)["theta a"] = [0.1, 1.0 / 3.0]
    assert dict(PartStore(path)) == {"theta a": [0.1, 1.0 / 3.0]}


def test_fresh_replaces_stored_parts_with_its_first_part(tmp_path: Path) -> None:
    """Not before: a misspelt bag does not delete the results of an earlier trace."""
    path = tmp_path / "out.kept.json"
    PartStore(path)["theta a"] = [1.0]
    fresh = PartStore(path, fresh=True)
    assert dict(fresh) == {} and dict(PartStore(path)) == {"theta a": [1.0]}
    fresh["theta b"] = [2.0]
    assert dict(PartStore(path)) == {"theta b": [2.0]}


def test_nothing_is_written_before_the_first_part(tmp_path: Path) -> None:
    PartStore(tmp_path / "out" / "base.kept.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fresh", [False, True])
def test_an_unwritable_path_is_reported_before_the_work(tmp_path: Path, fresh: bool) -> None:
    (tmp_path / "out.kept.json").mkdir()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "out.kept.json", tmp_path / "file" / "out.kept.json"):
        with pytest.raises(InputError, match=r"out\.kept\.json: is a directory|file: is a file"):
            PartStore(path, fresh)


def test_the_latest_parts_are_kept(tmp_path: Path) -> None:
    kept = PartStore(tmp_path / "out.kept.json")
    for number in range(MAX_PARTS + 3):
        kept[f"fit {number}"] = number
    assert len(kept) == MAX_PARTS and "fit 2" not in kept and f"fit {MAX_PARTS + 2}" in kept


@pytest.mark.parametrize("other", [{"version": "0.0.0"}, {"schema": 1}])
def test_parts_of_another_version_or_schema_are_not_read(tmp_path: Path, other: dict[str, object]) -> None:
    path = tmp_path / "out.kept.json"
    PartStore(path)["theta a"] = [1.0]
    path.write_text(json.dumps(json.loads(path.read_text()) | other))
    assert dict(PartStore(path)) == {}


@pytest.mark.parametrize(
    "text", ["", "{", "[1]", '{"schema": 1}', '{"schema": 1, "version": "x", "parts": 3, "more": 1}']
)
def test_a_damaged_file_is_refused_in_one_line_and_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "out.kept.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"out\.kept\.json") as error:
        PartStore(path)
    assert "\n" not in str(error.value) and path.read_text() == text


def test_a_missing_directory_is_created(tmp_path: Path) -> None:
    PartStore(tmp_path / "out" / "base.kept.json")["theta a"] = [1.0]
    assert dict(PartStore(tmp_path / "out" / "base.kept.json")) == {"theta a": [1.0]}
