"""Hidden motion: what the lost samples of a loss within strong motion may have had.

A shock of 4 g and 100 ms whose middle 60 ms are lost leaves a VDV of 2.2 of 12.6 m/s^1.75. The estimate is the largest
reading near the loss, for as long as the loss lasts: 11.5 with the rest. It decides no value, but keeps one from being
called not reached.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.exposure.suspect import NEAR_S, SHORTEST_LOSS_S, STRONG_MPS2

LONGEST_SHOCK_S: Final = 0.25
"""A longer loss hides a shock of this length: the rest of a gap counts as missing time."""


class HiddenMotion:
    """Estimate the hidden part of squares and fourth powers of one sensor's vertical; cuts into blocks change nothing.

    Unweighted: Wk is 1.05 at most.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._shortest = max(1, math.ceil(SHORTEST_LOSS_S * rate_hz))
        self._longest = round(LONGEST_SHOCK_S * rate_hz)
        self._recent = np.zeros(max(1, round(NEAR_S * rate_hz)))
        self._at = np.zeros(3, dtype=np.int64)
        self._largest = np.zeros(1)
        self._sums = np.zeros(2)

    def begin_run(self, gap_s: float) -> None:
        """Begin a run after a gap of that length."""
        lost = min(round(gap_s * self._rate_hz), self._longest)
        kernels.begin_loss(lost, self._recent, self._at, self._largest, STRONG_MPS2, self._sums)

    def push(self, up_mps2: Floats, lost: Integers) -> None:
        """Take the vertical (n,) of a sensor, levelled; lost (n,) as of `Block`."""
        kernels.find_losses(
            up_mps2, lost, self._shortest, self._longest, self._recent, self._at, self._largest, STRONG_MPS2,
            self._sums,
        )  # fmt: skip

    @property
    def powers(self) -> tuple[float, float]:
        """Seconds times the second and the fourth power of the estimate, since reset: m^2/s^3 and m^4/s^7."""
        sums = self._sums.copy()
        kernels.end_loss(self._at.copy(), self._largest, STRONG_MPS2, sums)
        second, fourth = (sums / self._rate_hz).tolist()
        return second, fourth

    def reset(self) -> None:
        """Set everything to zero."""
        self._at[1], self._sums[:] = 0, 0.0

    def totals(self) -> Floats:
        """The powers (1, 2), for `resume` of another run."""
        return np.array([self.powers])

    def resume(self, totals: Floats) -> None:
        """Continue from totals of an earlier run."""
        self._sums[:] = totals[0] * self._rate_hz
