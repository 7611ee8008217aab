"""The name that was meant, where one that was given does not exist."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The question after the known name nearest to this one, with a space before it; nothing where none is near."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" did you mean {near[0]}?" if near else ""
