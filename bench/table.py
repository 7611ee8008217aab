"""The table of a benchmark: results and baselines of one run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One measurement, its baseline from the same run, and the target with its result; None without one."""

    what: str
    ours: float
    unit: str
    baseline: float | None
    baseline_name: str
    mark: str
    met: bool | None


def render(rows: Iterable[Row]) -> str:
    """The rows as an aligned text table; the ratio is ours over baseline."""
    cells = [("quantity", "biodyn", "unit", "baseline", "", "ratio", "mark", "met"), *map(_cells, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    right = {1, 3, 5}
    lines = [
        "  ".join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    ]
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:]])


def _cells(row: Row) -> tuple[str, ...]:
    baseline = ratio = "-"
    if row.baseline is not None:
        baseline, ratio = _number(row.baseline), _ratio(row.ours, row.baseline)
    met = {True: "yes", False: "NO", None: "-"}[row.met]
    return row.what, _number(row.ours), row.unit, baseline, row.baseline_name, ratio, row.mark, met


def _number(value: float) -> str:
    """At least three digits, with thousands separators."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _ratio(ours: float, baseline: float) -> str:
    """Two decimals, or two digits for small ratios."""
    if baseline == 0.0:
        return "-"
    ratio = ours / baseline
    return f"{ratio:.2f}" if ratio == 0.0 or abs(ratio) >= 0.1 else f"{ratio:.2g}"
