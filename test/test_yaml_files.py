"""YAML files from strangers: refused in one line where ambiguous, recursive or too large."""

from __future__ import annotations

from pathlib import Path

import pytest
from expecting import refusal

from biodyn_core.base.errors import InputError
from biodyn_core.base.yaml_files import MAX_ALIASES, MAX_BYTES, read_yaml
from biodyn_core.body.subject import load_subject
from biodyn_core.exposure.limits import load_limits
from biodyn_ros.fit.campaign_file import load_campaign

LAUGHS = "a: &a [x, x]\n" + "\n".join(
    f"{b}: &{b} [*{a}, *{a}]" for a, b in zip("abcdefghijklmnopqrs", "bcdefghijklmnopqrst", strict=True)
)

BAD = {
    "billion laughs": (LAUGHS, f"more than {MAX_ALIASES} aliases"),
    "larger than anybody writes": ("a: 1\n" + "#" * MAX_BYTES, "larger than 1024 KiB"),
    "a tag that runs code": ("!!python/object/apply:os.system ['true']", "could not determine a constructor"),
    "deeper than the stack": ("[" * 20_000, "not a YAML file"),
    "deeper than the stack by lines": ("- " * 20_000, "not a YAML file"),
    "not UTF-8": (b"\xff\xfe\x00", "not a YAML file"),
    "a key twice": ("a: 1\na: 2", "a: given twice"),
    "one key as whole and as real number": ("1: x\n1.0: y", "1.0: given twice"),
    "a list for a key": ("? [1, 2]\n: 3", "not a YAML file"),
    "a date that is none": ("a: 2026-13-45", "not a YAML file"),
    "a control character": ("a: \x01", "not a YAML file"),
    "a tab": ("a:\n\t- b", "not a YAML file"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("reader", [read_yaml, load_subject, load_limits, load_campaign])
def test_every_reader_reports_an_error_in_one_line(tmp_path: Path, name: str, reader) -> None:
    path = tmp_path / "given.yaml"
    text, expected = BAD[name]
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert expected in refusal(reader, path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read \(No such file or directory\)"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(InputError, match=r"cannot be read \(Is a directory\)"):
        read_yaml(tmp_path)


def test_a_few_aliases_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "given.yaml"
    path.write_text("a: &a [1, 2]\nb: *a\nc: {<<: {d: 1}, e: 2}\n")
    assert read_yaml(path) == {"a": [1, 2], "b": [1, 2], "c": {"d": 1, "e": 2}}


def test_a_recursive_alias_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "given.yaml"
    path.write_text("&a {subjects: [*a]}")
    with pytest.raises(InputError, match=r"given\.yaml: "):
        load_campaign(path)


@pytest.mark.parametrize("text", ["n" * 5000, "a\\0b", "~nobody_of_this_name/x"])
@pytest.mark.parametrize("key", ["subject", "bags"])
def test_invalid_file_names_are_refused_by_key(tmp_path: Path, key: str, text: str) -> None:
    row = {"subject": '"subject_1"', "bags": '["x.mcap"]'} | {key: f'"{text}"' if key == "subject" else f'["{text}"]'}
    path = tmp_path / "campaign.yaml"
    path.write_text("subjects: [{" + ", ".join(f"{k}: {v}" for k, v in row.items()) + "}]")
    assert f"subjects[0].{key}" in refusal(load_campaign, path)
