"""Suspect samples: those whose weighted value a loss within strong motion may have raised.

A short loss is joined by a straight line, which weightings take for motion; after a longer one they restart. Within a
shock both can add a dose that was not there: with 45 ms lost from the peak of a half-sine of 4 g and 20 ms, VDV is 9.5
instead of 7.0 m/s^1.75. In weaker motion they add about what this motion itself has in the same time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.kernels.exposure import NEVER

STRONG_MPS2: Final = 3.0
"""Motion that differs by more from its slow level, on any axis, is strong.

50 ms at 3 m/s^2 have a VDV of 1.04 m/s^1.75 by Wk: 5,800 of them reach the action value. A restart there has 1.06.
"""

LEVEL_S: Final = 2.0
"""Time constant of the slow level: of a leaning body, a bend or braking."""

NEAR_S: Final = 0.05
"""A loss so near to strong motion lies within it; it is the longest loss that is joined by a line."""

SHORTEST_LOSS_S: Final = 0.003
"""A shorter loss is joined so well that it is none: motion up to 100 Hz has a third of a period in it."""

LONGEST_SETTLING_S: Final = 2.0
"""Time in which a weighting settles after it has restarted, or after the longest loss."""

SETTLING: Final = 40
"""A shorter loss settles in so many times its length: what it adds is in proportion to its length, and decays.

In 3,000 random motions with one loss, 80 and 150 gave the same figures in proportion to the true ones.
"""


class SuspectSamples:
    """Flag suspect samples of one sensor, row by row; cuts into blocks never change a flag."""

    def __init__(self, rate_hz: float) -> None:
        self._follow = 1.0 - math.exp(-1.0 / (LEVEL_S * rate_hz))
        self._shortest = max(1, math.ceil(SHORTEST_LOSS_S * rate_hz))
        self._near, self._longest = round(NEAR_S * rate_hz), round(LONGEST_SETTLING_S * rate_hz)
        self._level = np.zeros(3)
        self._state = np.array([NEVER, 0, NEVER, 0])

    def begin_run(self, follows_loss: bool) -> None:
        """Begin a run; weightings restart, in the middle of motion where it follows a loss or begins a record there."""
        self._state[:] = (-1, self._longest, NEVER, 0) if follows_loss else (NEVER, 0, NEVER, 0)

    def begin_level(self, accel_mps2: Floats) -> None:
        """Begin with the mean of the first readings (n, 3) as level, where a record begins in motion."""
        self._level[:] = np.clip(accel_mps2, -STANDARD_GRAVITY_MPS2, STANDARD_GRAVITY_MPS2).mean(axis=0)

    def flags(self, accel_mps2: Floats, lost: Integers) -> Flags:
        """The flags (n,) of suspect rows of levelled acceleration (n, up to 3 axes); lost (n,) as of `Block`."""
        suspect = np.empty(len(accel_mps2), dtype=bool)
        kernels.flag_suspect(
            accel_mps2, lost, STRONG_MPS2, self._follow, self._shortest, self._near, SETTLING, self._longest,
            self._level, self._state, suspect,
        )  # fmt: skip
        return suspect


def constant_parts(flags: Flags) -> Iterator[tuple[int, int]]:
    """Begin and end of the parts in which flags (n,) do not change, in order."""
    if flags.size == 1:
        yield 0, 1
    elif flags.size:
        changes = (np.flatnonzero(flags[1:] != flags[:-1]) + 1).tolist()
        yield from pairwise([0, *changes, flags.size])
