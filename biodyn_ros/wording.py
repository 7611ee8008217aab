"""Numbers and names as a reader sees them, in the page as in the terminal."""

from __future__ import annotations

import math


def number(value: float | None) -> str:
    """Three significant digits without an exponent where that is possible; a dash for what is not known."""
    if value is None or math.isnan(value):
        return "–"
    size = abs(value)
    if size == 0.0 or not 1e-3 <= size < 1e6:
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(size)))}f}"


def bound(value: float | None, lower: bool) -> str:
    """The number, with ">=" before it where it is a lower bound."""
    return f">= {number(value)}" if lower and value is not None else number(value)


def duration(seconds: float) -> str:
    """A time for people: 8.4 s, 12 min, 3 h 20 min, more than 24 h."""
    if seconds < 59.5:
        return f"{seconds:.3g} s"
    if seconds > 24.0 * 3600.0:
        return "more than 24 h"
    minutes = round(seconds / 60.0)
    if minutes < 60:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"


def words(name: str) -> str:
    """A name of ours as words: `lower_torso` is "lower torso"."""
    return name.replace("_", " ")
