"""Wording of counts and numbers: "1 sample", "2 samples", and three significant digits."""

from __future__ import annotations

import math


def counted(count: int, one: str, many: str | None = None) -> str:
    """Return a count with its noun, singular for 1; many: the plural where it is not `one` with an s."""
    return f"{count} {one if count == 1 else many or f'{one}s'}"


def number(value: float | None) -> str:
    """Three significant digits, without an exponent if possible; a dash for an unknown value."""
    if value is None or math.isnan(value):
        return "–"
    decimals = decimal_places(value)
    return f"{value:.3g}" if decimals is None else f"{value:.{decimals}f}"


def number_below(value: float, limit: float) -> str:
    """The same, with further digits until the text is below a limit like the value."""
    shown, digits = number(value), 4
    while value < limit <= float(shown) and digits <= 17:
        shown, digits = f"{value:.{digits}g}", digits + 1
    return shown


def decimal_places(value: float) -> int | None:
    """Decimal places of a value rounded to three significant digits; None where an exponent may be needed."""
    size = abs(float(f"{value:.3g}"))
    return max(0, 2 - math.floor(math.log10(size))) if 1e-3 <= size < 1e6 else None


def probability_text(p: float) -> str:
    """A probability with two decimals; never 0.00 or 1.00, which would exclude the rest."""
    return "< 0.01" if p < 0.005 else "> 0.99" if p >= 0.995 else f"{p:.2f}"
