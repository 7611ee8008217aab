"""JSON files: written completely or not at all, and checked as untrusted input when read."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_ros.base.files import write_text

MAX_BYTES: Final = 64 * 2**20
"""Largest file that is read; 1000 results of 100 starts each take a third of it."""


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON file."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> object:
    """The content of a JSON file; raises InputError, without the path, if it is no JSON or exceeds `MAX_BYTES`."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})") from None
    if len(data) > MAX_BYTES:
        raise InputError(f"is larger than {MAX_BYTES // 2**20} MiB, so biodyn did not write it")
    try:
        return json.loads(data)
    except (ValueError, RecursionError):  # the errors of JSON and of Unicode are ValueErrors
        raise InputError("is damaged: not valid JSON") from None


def keys_of(value: object, where: str, expected: tuple[str, ...] | None = None) -> dict[str, Any]:
    """The value as a mapping with exactly the expected keys; raises InputError."""
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected keys and values, got {type(value).__name__}")
    if expected is not None and value.keys() != set(expected):
        raise InputError(f"{where}: has the keys {', '.join(sorted(value))}, expected {', '.join(sorted(expected))}")
    return value


def finite(value: float | None) -> float | None:
    """The value, or None: JSON has neither NaN nor infinity."""
    return value if value is not None and math.isfinite(value) else None
