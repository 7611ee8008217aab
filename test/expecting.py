"""Expectations of tests: a refusal in one line, and a condition that becomes true within a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from biodyn_core.base.errors import MAX_CHARACTERS, InputError


def refusal(reader: Callable[[Path], Any], path: Path) -> str:
    """The one line, not too long, that a reader refuses a file with; it begins with the file's name."""
    with pytest.raises(InputError) as error:
        reader(path)
    line = str(error.value)
    assert line.startswith(f"{path}: ") and "\n" not in line and len(line) <= MAX_CHARACTERS
    return line


def until(
    happened: Callable[[], Any],
    what: str = "",
    seconds: float = 60.0,
    meanwhile: Callable[[], Any] = lambda: time.sleep(0.01),
) -> None:
    """Wait for something, not for ever; fails by name when the time has passed."""
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end, f"not within {seconds:g} s: {what}"
        meanwhile()
