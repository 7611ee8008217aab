"""Suggestions: the known name nearest to an unknown one, as the end of an error message."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable
from itertools import islice
from pathlib import Path
from typing import Final

MAX_FILES: Final = 10_000
"""Number of files in a directory that are searched."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return "; did you mean NAME?" with the nearest known name, in any case; empty where none is near."""
    near = _nearest(name, known)
    return f"; did you mean {near}?" if near else ""


def known_are(name: object, known: Collection[str]) -> str:
    """Return "known are A, B", with the nearest one to an unknown name."""
    return f"known are {', '.join(known) or 'none'}{did_you_mean(name, known)}"


def did_you_mean_file(path: str | Path) -> str:
    """Return the same for a path that does not exist: its nearest neighbour, or that of its first missing directory."""
    missing = Path(path)
    try:
        while not missing.parent.exists():
            missing = missing.parent
        there = [] if missing.exists() else [file.name for file in islice(missing.parent.iterdir(), MAX_FILES)]
    except (OSError, ValueError):  # an unreadable directory, or an impossible file name
        return ""
    if missing.name in there:  # a link whose target is missing
        return ""
    near = _nearest(missing.name, there)
    return f"; did you mean {missing.parent / near}?" if near else ""


def _nearest(name: object, known: Iterable[str]) -> str | None:
    by_folded = {each.casefold(): each for each in known}
    near = difflib.get_close_matches(str(name).casefold(), by_folded, n=1)
    return by_folded[near[0]] if near else None
