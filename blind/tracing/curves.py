"""Accuracy against the ratio of a hidden effect: bins of octaves, and a logistic curve with its 95 % band."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.effects import logistic
from blind.tracing.outcome import Outcome
from blind.tracing.rows import WITH_BACKGROUND
from blind.tracing.shares import share_text, wilson

Floats = NDArray[np.float64]

EDGES: Final = (0.0, 0.2, 0.4, 0.8, 1.6, 3.2, np.inf)
"""Of the bins, in ratio: octaves, of which 0.4 and 0.8 are the limits of the marks; a bin has its upper edge."""

LEAST: Final = 10
"""Fewer records have no curve."""

NORMAL_95: Final = 1.959964
STEPS: Final = 200
FARTHEST: Final = 1.0
"""Of a step, in log odds: near the start the information is larger than at a steep solution."""

GROUPS: Final = {"with a background": WITH_BACKGROUND, "sensor noise alone": ("sensor_noise",)}
"""Groups of records with one hidden effect of the catalogue, by their drawings."""

MEASURES: Final[dict[str, Callable[[Outcome], bool]]] = {
    "named rightly": attrgetter("class_right"),
    "truth most probable": attrgetter("true_class_leads"),
    "truth in the 90 % set": attrgetter("in_set"),
}


@dataclass(frozen=True, eq=False)
class Logistic:
    """A curve whose log odds are linear in log2 of the ratio: weights (2,) and their covariance (2, 2)."""

    weights: Floats
    covariance: Floats

    def at(self, ratios: Floats) -> tuple[Floats, Floats, Floats]:
        """The share at ratios, and the lower and upper limit of its 95 % band (Wald's, in log odds)."""
        x = _columns(ratios)
        middle = x @ self.weights
        half = NORMAL_95 * np.sqrt(np.einsum("ij,jk,ik->i", x, self.covariance, x))
        return logistic(middle), logistic(middle - half), logistic(middle + half)


def fitted(ratios: Floats, hits: NDArray[np.bool_]) -> Logistic:
    """The curve with the largest likelihood times the root of the determinant of the Fisher information.

    This penalty (Jeffreys' prior; Firth, Biometrika 80, 1993, 27-38) has no setting, and the curve is finite if all or
    none are hits, or if a ratio separates them. Ratios must differ.
    """
    x, weights = _columns(ratios), np.zeros(2)
    for _ in range(STEPS):
        p = logistic(x @ weights)
        spread = p * (1.0 - p)
        covariance = np.linalg.inv(x.T @ (spread[:, None] * x))
        leverage = spread * np.einsum("ij,jk,ik->i", x, covariance, x)
        step = covariance @ (x.T @ (hits - p + leverage * (0.5 - p)))
        step *= min(1.0, FARTHEST / max(float(np.abs(x @ step).max()), 1e-300))
        weights = weights + step
        if np.abs(step).max() < 1e-10:
            break
    return Logistic(weights, covariance)


def _columns(ratios: Floats) -> Floats:
    return np.column_stack([np.ones(len(ratios)), np.log2(ratios)])


@dataclass(frozen=True)
class RatioBin:
    """The records with a ratio above `low` and up to `high`; middle: the geometric mean of their ratios."""

    low: float
    high: float
    records: int
    middle: float
    hits: int

    @property
    def share(self) -> float:
        """The share of hits."""
        return self.hits / self.records

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of that share."""
        return wilson(self.hits, self.records)

    @property
    def text(self) -> str:
        """The range of ratios."""
        return f"above {self.low:g}" if np.isinf(self.high) else f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True, eq=False)
class Curve:
    """The records of a group by one measure: ratios (n,), hits (n,), their bins, and the curve if there are enough."""

    group: str
    measure: str
    ratios: Floats
    hits: NDArray[np.bool_]
    bins: tuple[RatioBin, ...]
    fit: Logistic | None

    @classmethod
    def of(cls, group: str, measure: str, ratios: Floats, hits: NDArray[np.bool_]) -> Curve:
        """The bins and the fit of records."""
        enough = len(ratios) >= LEAST and bool(np.ptp(ratios) > 0.0)
        return cls(group, measure, ratios, hits, _bins(ratios, hits), fitted(ratios, hits) if enough else None)

    @property
    def rows(self) -> list[tuple[str, str]]:
        """For each bin the share with its interval, and the curve at its middle with its band, in percent."""
        shares = [share_text(one.hits, one.records) for one in self.bins]
        if self.fit is None:
            return [(share, "-") for share in shares]
        every = zip(*self.fit.at(np.array([one.middle for one in self.bins])), strict=True)
        at = [f"{100.0 * p:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f})" for p, low, high in every]
        return list(zip(shares, at, strict=True))


def _bins(ratios: Floats, hits: NDArray[np.bool_]) -> tuple[RatioBin, ...]:
    found = []
    for low, high in itertools.pairwise(EDGES):
        mine = (ratios > low) & (ratios <= high)
        if mine.any():
            middle = float(np.exp(np.log(ratios[mine]).mean()))
            found.append(RatioBin(low, high, int(mine.sum()), middle, int(hits[mine].sum())))
    return tuple(found)


def curves(outcomes: Sequence[Outcome]) -> dict[str, list[Curve]]:
    """The curves of each group with probabilities, one for each measure; records without a ratio are left out."""
    found = {}
    for group, drawings in GROUPS.items():
        mine = [one for one in outcomes if one.answer.row in drawings and one.score.ratio]
        ratios = np.array([one.score.ratio for one in mine], dtype=np.float64)
        if any(one.answer.probabilities for one in mine):
            found[group] = [
                Curve.of(group, name, ratios, np.array([bool(holds(one)) for one in mine]))
                for name, holds in MEASURES.items()
            ]
    return found
