"""Ranges: parameters as shares of their ranges, and mapped to the whole line for unbounded optimisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.effects.effect import EffectParameter

FINITE: Final = 1e-6
"""A value that keeps this share of its range from both ends stays finite on the whole line, where they are infinite."""


@dataclass(frozen=True)
class Ranges:
    """Parameters (p,) in order."""

    parameters: Sequence[EffectParameter]

    def shares(self, values: Floats) -> Floats:
        """Positions of values in their ranges, 0 to 1."""
        return np.array([p.share(value) for p, value in zip(self.parameters, values, strict=True)], dtype=np.float64)

    def values(self, shares: Floats) -> Floats:
        """The values at shares; a share outside 0 to 1 gives the nearer end."""
        return np.array([p.at_share(share) for p, share in zip(self.parameters, shares, strict=True)], dtype=np.float64)

    def unbounded(self, values: Floats, inside: Floats | float) -> Floats:
        """Values on the whole line, after shares are clipped to `inside` and 1 - `inside`."""
        share = np.clip(self.shares(values), inside, 1.0 - np.asarray(inside))
        return np.asarray(np.log(share / (1.0 - share)))

    def bounded(self, points: Floats) -> Floats:
        """The values at points of the whole line."""
        return self.values(logistic(points))


def logistic(points: Floats) -> Floats:
    """Map the whole line to 0 to 1."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * points)))
