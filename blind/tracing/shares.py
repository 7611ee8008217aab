"""Shares of records with Wilson's 95 % interval."""

from __future__ import annotations

from scipy import stats


def wilson(hits: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    interval = stats.binomtest(hits, of).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def share_text(hits: int, of: int) -> str:
    """A share with its interval in percent, a dash without records."""
    if not of:
        return "-"
    low, high = wilson(hits, of)
    return f"{100.0 * hits / of:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"
