"""JSON on disk: written whole or not at all, and read as if a stranger had written it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_ros.base.files import write_text

LARGEST_BYTES: Final = 64 * 2**20
"""Of a file that is read; 1000 results of 100 starts each take a third of it."""


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON file."""
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def read_json(path: Path) -> object:
    """What a JSON file holds; raises InputError, without its name, for what is none or larger than `LARGEST_BYTES`."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_BYTES + 1)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})") from None
    if len(data) > LARGEST_BYTES:
        raise InputError(f"is larger than {LARGEST_BYTES // 2**20} MiB, so it is none of ours")
    try:
        return json.loads(data)
    except (ValueError, RecursionError):  # JSON's own error and Unicode's are ValueErrors
        raise InputError("is damaged, it is no JSON") from None


def keys_of(value: object, where: str, expected: tuple[str, ...] | None = None) -> dict[str, Any]:
    """A mapping with these keys and no other; raises InputError."""
    if not isinstance(value, dict):
        raise InputError(f"{where}: expected keys and values, got {type(value).__name__}")
    if expected is not None and value.keys() != set(expected):
        raise InputError(f"{where}: has the keys {', '.join(sorted(value))}, expected {', '.join(sorted(expected))}")
    return value


def finite(value: float) -> float | None:
    """The value, or None: JSON knows neither NaN nor infinity."""
    return value if math.isfinite(value) else None
