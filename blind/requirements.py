"""Requirements of a study: what each needs before it starts, and what it says of its marks at the end."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from world import seats

from conformance.table import table


@dataclass(frozen=True)
class Mark:
    """One requirement and what was reached."""

    what: str
    required: str
    reached: str
    met: bool


def mark_table(marks: Sequence[Mark]) -> list[str]:
    """The lines of a table of marks."""
    rows = [[mark.what, mark.required, mark.reached, "yes" if mark.met else "**no**"] for mark in marks]
    return table(["requirement", "required", "reached", "met"], rows)


def publish(page: Path, text: str, marks: Sequence[Mark]) -> int:
    """Write the page of a study, and name the missed marks; returns the exit code, 1 for a missed mark."""
    page.write_text(text, encoding="utf-8")
    missed = [mark for mark in marks if not mark.met]
    for mark in missed:
        print(f"blind: missed: {mark.what}: {mark.reached}, required {mark.required}", file=sys.stderr)
    return 1 if missed else 0


def has_recordings() -> bool:
    """Whether the recordings of seats are there; says so if not."""
    if seats.data().is_dir():
        return True
    print(f"blind: the recordings are not in {seats.data()}: set BIODYN_DATA to their directory", file=sys.stderr)
    return False
