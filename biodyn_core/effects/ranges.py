"""Ranges: an effect's parameters as shares of their ranges, and on the whole line, where a search meets no end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import EffectParameter


@dataclass(frozen=True)
class Ranges:
    """Some parameters, (p,) in their order."""

    parameters: Sequence[EffectParameter]

    def shares(self, values: Floats) -> Floats:
        """Where values lie in their ranges, 0 to 1."""
        return np.array([p.share(value) for p, value in zip(self.parameters, values, strict=True)], dtype=np.float64)

    def values(self, shares: Floats) -> Floats:
        """The values at these shares; those beyond 0 and 1 are at the ends."""
        return np.array([p.at_share(share) for p, share in zip(self.parameters, shares, strict=True)], dtype=np.float64)

    def unbounded(self, values: Floats, inside: Floats | float) -> Floats:
        """Values on the whole line, at least so far inside their ranges, as a share."""
        share = np.clip(self.shares(values), inside, 1.0 - np.asarray(inside))
        return np.asarray(np.log(share / (1.0 - share)))

    def bounded(self, points: Floats) -> Floats:
        """The values at points of the whole line."""
        return self.values(logistic(points))


def logistic(points: Floats) -> Floats:
    """The whole line to 0 to 1."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * points)))
