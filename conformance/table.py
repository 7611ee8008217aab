"""Rows of value, reference and tolerance, and sections of rows, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

PASS: Final = "pass"  # noqa: S105  no password
FAIL: Final = "**FAIL**"


@dataclass(frozen=True)
class Row:
    """One result with its reference; `tolerance` is relative to the reference, or absolute."""

    what: str
    value: float
    reference: float
    tolerance: float
    unit: str = ""
    absolute: bool = False

    @property
    def off(self) -> float:
        """The deviation from the reference, relative or absolute as the tolerance."""
        return self.value - self.reference if self.absolute else self.value / self.reference - 1.0

    @property
    def passes(self) -> bool:
        """Whether the value is within its tolerance; False for NaN."""
        return abs(self.off) <= self.tolerance

    def line(self) -> str:
        """The row of a table."""
        if self.absolute:
            figures = [rounded(x, self.tolerance) for x in (self.value, self.reference)]
            off, tolerance = signed(self.off, self.tolerance), f"{self.tolerance:.3g}"
        else:
            figures = [number(self.value), number(self.reference)]
            off, tolerance = f"{signed(100.0 * self.off, 100.0 * self.tolerance)} %", f"{100.0 * self.tolerance:.3g} %"
        return cells(self.what, *figures, self.unit, off, tolerance, PASS if self.passes else FAIL)


class Section(Protocol):
    """A section of the page: its title, its rows, and its Markdown."""

    title: str

    def rows(self) -> Sequence[Row]:
        """All comparisons of the section."""

    def lines(self) -> list[str]:
        """The section as Markdown."""


@dataclass(frozen=True)
class RowTable:
    """A section with one line for every row."""

    title: str
    words: str
    entries: tuple[Row, ...]

    def rows(self) -> Sequence[Row]:
        """All comparisons of the section."""
        return self.entries

    def lines(self) -> list[str]:
        """The section as Markdown."""
        head = [cells("quantity", "value", "reference", "unit", "deviation", "tolerance", ""), cells(*["---"] * 7)]
        return [f"### {self.title}", "", self.words, "", *head, *(row.line() for row in self.entries), ""]


def cells(*texts: str) -> str:
    """A line of a Markdown table."""
    return f"| {' | '.join(texts)} |"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a Markdown table; all columns but the first are aligned to the right."""
    return [cells(*head), cells("---", *["---:"] * (len(head) - 1)), *(cells(*row) for row in rows)]


def number(value: float) -> str:
    """Five digits."""
    return f"{value:#.5g}".rstrip(".")


def rounded(value: float, tolerance: float) -> str:
    """Rounded to a hundredth of the tolerance, because further digits depend on the machine."""
    if not math.isfinite(value):
        return str(value)
    digits = max(0, 2 - math.floor(math.log10(tolerance))) if tolerance > 0.0 else 0
    text = f"{value:.{digits}f}"
    return text if float(text) else "0"


def signed(off: float, tolerance: float) -> str:
    """A deviation with its sign."""
    text = rounded(off, tolerance)
    return f"+{text}" if float(text) > 0.0 else text
