"""docs/files.md compared with real documents: both have the same keys."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from biodyn_core.base.segments import SEGMENTS, SENSORS
from biodyn_core.body.synthesis import CASES
from biodyn_core.effects import CATALOGUE
from biodyn_core.signals.weighting import CURVES

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
OF_EFFECTS = {parameter.name for effect in CATALOGUE.values() for parameter in effect.parameters}
NAMES = {*SENSORS, *SEGMENTS, *CURVES, *CASES, *OF_EFFECTS}
"""Keys that name measured quantities and stand for each other."""


def keys(value: Any) -> Iterator[str]:
    """All keys at any depth that are no names of sensors, parameters, bags or channels."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in NAMES and re.fullmatch(r"[a-z][a-z0-9_]*", key):
                yield key
            yield from keys(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from keys(inner)


def assert_listed(name: str, document: dict[str, Any], absent: frozenset[str] = frozenset()) -> None:
    """The section of that name lists all keys of a document; the document has all of its first column but `absent`."""
    section = re.split(r"^## ", PAGE.split(f"## {name}\n")[1], flags=re.MULTILINE)[0]
    documented = set(re.findall(r"`([^`]+)`", section))
    top = {
        key for row in re.findall(r"^\| (`[^|]*) \|", section, re.MULTILINE) for key in re.findall(r"`([^`]+)`", row)
    }
    missing, listed = sorted(set(keys(document)) - documented), sorted(top - absent)
    assert not missing, f"{name}: docs/files.md does not list {missing}"
    assert listed == sorted(set(document) - absent), f"{name}: first column of docs/files.md"
