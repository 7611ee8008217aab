"""Rails: clipped samples, at readings from the set limit on and at a rail found below it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.kernels import rails as kernel

LEAST_MPS2: Final = kernel.LEAST_MPS2

ONE_STEP: Final = 2.0**-15
"""Largest difference of a sensor's range between sides: a step of 16 bits."""

_PLACES: Final = np.arange(kernel.COUNT_SIZE)
_LIES_AT: Final = np.array(
    [
        _PLACES // (1 + kernel.SIDES) ** axis % (1 + kernel.SIDES) == side + 1
        for axis in range(kernel.AXES)
        for side in range(kernel.SIDES)
    ]
)
"""(sides, places): whether samples counted in a place lie at the extreme of a side."""


@dataclass(frozen=True, eq=False)
class Clipping:
    """Clipped samples of one sensor; the sides are the largest readings of each axis, then its smallest ones.

    saturated: samples beyond the set limit, in no place. extremes_mps2 (6,) by side, 0 for none; is_rail (6,); samples
    (27,) by place, as `kernels.rails` counts them.
    """

    saturated: int
    extremes_mps2: Floats
    is_rail: Flags
    samples: Integers

    @classmethod
    def of(cls, saturated: int, rows: Floats, samples: Integers) -> Clipping:
        """Read the kernel's state: rows (132,) and samples (27,)."""
        table = rows.reshape(kernel.ROWS, kernel.ROW_SIZE)
        extremes, is_rail = table[:, kernel.EXTREME], table[:, kernel.FOUND] > 0.0
        if is_rail.any():  # a rail of one side is one of every side that reaches it
            apart = np.abs(extremes[:, np.newaxis] - extremes[is_rail])
            is_rail = np.any(apart <= ONE_STEP * extremes[is_rail], axis=1)
        return cls(saturated, np.tile([1.0, -1.0], kernel.AXES) * extremes, is_rail, samples.copy())

    @property
    def total(self) -> int:
        """All clipped samples."""
        return self.before(self)

    def before(self, earlier: Clipping) -> int:
        """Clipped samples up to an earlier state, by the rails known now."""
        if not self.is_rail.any():
            return earlier.saturated
        still = self.is_rail & (self.extremes_mps2 == earlier.extremes_mps2)
        return earlier.saturated + int(earlier.samples[_LIES_AT[still].any(axis=0)].sum())

    def at_rails(self, samples_mps2: Floats) -> Flags:
        """Flags (n,) of samples (n, 3) with a reading at a rail."""
        found = np.zeros(len(samples_mps2), dtype=np.bool_)
        for side in np.flatnonzero(self.is_rail):
            rail = self.extremes_mps2[side]
            found |= np.abs(samples_mps2[:, side // kernel.SIDES] - rail) <= kernel.SAME * abs(rail)
        return found

    def warning(self, saturation_mps2: float) -> str | None:
        """One line on the rails below the set limit; None without any."""
        sides = self.is_rail & (np.abs(self.extremes_mps2) < saturation_mps2)
        if not sides.any():
            return None
        count = int(self.samples[_LIES_AT[sides].any(axis=0)].sum())
        limits = sorted({f"{rail:+.2f}" for rail in self.extremes_mps2[sides].tolist()})
        return (
            f"{count} readings lie at the sensor's own limit of {' and '.join(limits)} m/s^2 (below saturation_mps2"
            f" {saturation_mps2:g}): counted as clipped, figures are lower bounds"
        )
