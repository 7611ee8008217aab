"""Results on disk: each is written beside its place and renamed, so that none is ever half there."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from biodyn_core.errors import InputError


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON file."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text file; raises InputError where that cannot be done."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def make_directory(path: Path) -> None:
    """Make a directory with those above it; raises InputError where that cannot be done."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a directory ({error.strerror})") from None


def finite(value: float) -> float | None:
    """The value, or None: JSON knows neither NaN nor infinity."""
    return value if math.isfinite(value) else None
