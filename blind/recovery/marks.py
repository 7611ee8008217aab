"""The marks (requirements) of the study and their figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from blind.recovery.results import MethodResult, PersonResult, largest_frequency_error

Floats = NDArray[np.float64]

WITHIN_FLOOR: Final = 1.3
WITHIN_PERCENT: Final = 3.0
COVERAGE_PERCENT: Final = (90.0, 98.0)
HALF_WIDTH_PERCENT: Final = 5.0
RESAMPLES: Final = 4000


@dataclass(frozen=True)
class Mark:
    """One mark: the requirement, the result, and the result of the method of the paper if it has one."""

    what: str
    required: str
    reached: str
    met: bool
    papers: str = "-"


def marks(people: Sequence[PersonResult]) -> list[Mark]:
    """All marks; 19 or 18 of 20 people are required, and the same shares of other numbers."""
    n, most, many = len(people), round(0.95 * len(people)), round(0.9 * len(people))
    held = [int(sum(ratio.max() <= WITHIN_FLOOR for ratio in r)) for r in _ratios(people)]
    known = sum(p.is_identifiable for p in people)
    near = [sum(_near(one) for one in methods) for methods in _methods(people)]
    both = sum(p.is_identifiable and _near(p.ours) for p in people)
    share, interval = coverage(people)
    half = float(np.median([100.0 * p.estimates[joint].half_width for p in people for joint in range(6)]))
    least, highest = COVERAGE_PERCENT
    return [
        Mark(
            f"held-out error within {WITHIN_FLOOR:g} x the floor in every event and segment", f">= {most} of {n}",
            f"{held[0]} of {n}", held[0] >= most, f"{held[1]} of {n}",
        ),
        Mark(
            "f_n of joints 1, 2, 5, 6 classified as identifiable", f">= {many} of {n}", f"{known} of {n}",
            known >= many,
        ),
        Mark(
            f"... and within {WITHIN_PERCENT:g} % of the truth", f">= {many} of {n}", f"{both} of {n}", both >= many,
            f"{near[1]} of {n}, without classification",
        ),
        Mark(
            "coverage of the 95 % intervals, pooled", f"{least:g} to {highest:g} %",
            f"{share:.1f} % ({interval[0]:.1f} to {interval[1]:.1f})", least <= share <= highest,
        ),
        Mark("median half width of f_n", f"<= {HALF_WIDTH_PERCENT:g} %", f"{half:.2f} %", half <= HALF_WIDTH_PERCENT),
    ]  # fmt: skip


def coverage(people: Sequence[PersonResult]) -> tuple[float, Floats]:
    """Share of the intervals that contain the truth, percent, with a 95 % interval (2,) from resampled people."""
    held = np.array([np.count_nonzero(p.inside & p.counted) for p in people])
    counted = np.array([np.count_nonzero(p.counted) for p in people])
    drawn = np.random.default_rng(0).integers(len(people), size=(RESAMPLES, len(people)))
    shares = 100.0 * held[drawn].sum(axis=1) / counted[drawn].sum(axis=1)
    return 100.0 * float(held.sum() / counted.sum()), np.quantile(shares, (0.025, 0.975))


def better(people: Sequence[PersonResult]) -> bool:
    """Whether our method predicts held-out events of most people better than the method of the paper."""
    return float(np.mean([ours_error(p) < papers_error(p) for p in people])) > 0.5


def ours_error(person: PersonResult) -> float:
    """Mean held-out error, percent."""
    return float(person.ours.error_percent.mean())


def papers_error(person: PersonResult) -> float:
    """Mean held-out error of the method of the paper, percent."""
    return float(person.papers.error_percent.mean())


def _near(one: MethodResult) -> bool:
    return 100.0 * largest_frequency_error(one) <= WITHIN_PERCENT


def _methods(people: Sequence[PersonResult]) -> tuple[list[MethodResult], list[MethodResult]]:
    return [p.ours for p in people], [p.papers for p in people]


def _ratios(people: Sequence[PersonResult]) -> tuple[list[Floats], list[Floats]]:
    return [p.ratio for p in people], [p.papers_ratio for p in people]
