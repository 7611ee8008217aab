"""Reliability of probabilities: bins, the expected calibration error, and the error that chance alone makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from blind.tracing.shares import share_text, wilson
from conformance.table import table

Confidence = tuple[float, bool]
"""The probability of a record's most probable answer, and whether that answer is right."""

BINS: Final = 10
DRAWS: Final = 2000
SEED: Final = 1


@dataclass(frozen=True)
class Bin:
    """The answers with probabilities from `low` to less than `high`, the last bin with 1."""

    low: float
    high: float
    records: int
    mean: float
    right: int

    @property
    def share(self) -> float:
        """The share of right answers."""
        return self.right / self.records

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of that share."""
        return wilson(self.right, self.records)


def bins(answers: Sequence[Confidence]) -> list[Bin]:
    """The bins of equal width that have answers."""
    at = _bin_of([p for p, _ in answers])
    found = []
    for b in np.unique(at):
        mine = [one for one, place in zip(answers, at, strict=True) if place == b]
        mean, right = float(np.mean([p for p, _ in mine])), sum(right for _, right in mine)
        found.append(Bin(float(b) / BINS, float(b + 1) / BINS, len(mine), mean, right))
    return found


def calibration_error(answers: Sequence[Confidence]) -> float:
    """The expected calibration error.

    Mean distance of probability and share of right answers over the bins, weighted by their counts.
    """
    return sum(one.records * abs(one.share - one.mean) for one in bins(answers)) / len(answers)


def error_by_chance(answers: Sequence[Confidence]) -> tuple[float, float]:
    """The median and the quantile 95 % of the error that perfectly calibrated answers with these probabilities have."""
    p = np.array([one for one, _ in answers])
    right = np.random.default_rng(SEED).random((DRAWS, p.size)) < p
    in_bin = _bin_of(p)[:, None] == np.arange(BINS)
    errors = np.abs((right - p) @ in_bin).sum(axis=1) / p.size
    return float(np.median(errors)), float(np.quantile(errors, 0.95))


def bin_table(answers: Sequence[Confidence], of: str) -> list[str]:
    """The bins as the lines of a table; of: the name of records on that page."""
    rows = [
        (f"{one.low:.1f} to {one.high:.1f}", str(one.records), f"{one.mean:.2f}", share_text(one.right, one.records))
        for one in bins(answers)
    ]
    return table(("probability of the most probable answer", of, "mean probability", "right"), rows)


def _bin_of(p: Sequence[float] | NDArray[np.float64]) -> NDArray[np.int_]:
    return np.minimum((np.asarray(p, dtype=np.float64) * BINS).astype(int), BINS - 1)
