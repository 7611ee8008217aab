"""Runs: stretches of one sensor without a break, what is missing between them, and stamps that leap away and return."""

from __future__ import annotations

from typing import Final, NamedTuple

from biodyn_core.kernels.sensor import LEAP_S

LAP_S: Final = 1e6
"""Added to a sensor's own seconds whenever its stamps jump back, as often as needed, so that they go on.

Time inside jumps back only where stamps that had leapt away return: sensors that did not leap are met again.
"""

OVERLAP_NS: Final = 100_000_000
"""Stamps that return may overlap by so much with those before the leap: jitter, not a second lap of a bag."""


class _Leap(NamedTuple):
    """How far stamps leapt, seconds, and what they left: the last instant answered before, ns, and its lap."""

    by_s: float
    left_ns: int
    lap: int

    def is_left_behind(self, stamp_ns: int) -> bool:
        """Whether a stamp that returns is beyond what was left, as far as jitter lets anybody see."""
        return stamp_ns > self.left_ns - OVERLAP_NS


_NO_LEAP: Final = _Leap(0.0, 0, 0)


class Runs:
    """Counts runs by `answered` and `end`, in the order of the samples.

    count: how many runs there were. gap_s: what lies between them. leapt_s: the sum of all leaps of more than a second
    between runs, those back below zero, whether a clock was set or nothing came meanwhile.
    """

    def __init__(self) -> None:
        self.count = 0
        self.gap_s = 0.0
        self.leapt_s = 0.0
        self._going = False
        self._ended_ns: int | None = None
        self._lap = 0
        self._leap = _NO_LEAP

    @property
    def lap_s(self) -> float:
        """What is added to seconds by stamps, so that they go on where stamps jumped back."""
        return self._lap * LAP_S

    def answered(self, begins_ns: int, ends_ns: int, period_s: float) -> tuple[bool, float]:
        """Samples up to `ends_ns` were answered; returns whether a run begins with them, and behind which gap."""
        begins_run = not self._going
        gap_s = self._begin(begins_ns, period_s) if begins_run else 0.0
        self._ended_ns = ends_ns
        return begins_run, gap_s

    def end(self, next_ns: int, period_s: float) -> None:
        """A run ended; the next one begins at a stamp, which may lie before the end of this one."""
        self._going = False
        if self._ended_ns is not None and next_ns < self._ended_ns:
            self._leap_back((self._ended_ns - next_ns) * 1e-9 + period_s, self._ended_ns, next_ns)
            self._ended_ns = None

    def _begin(self, begins_ns: int, period_s: float) -> float:
        """Count a run and what is missing before it, which is returned."""
        self._going = True
        self.count += 1
        if self._ended_ns is None:
            return 0.0
        gap_s = (begins_ns - self._ended_ns) * 1e-9 - period_s
        if gap_s > LEAP_S:
            self.leapt_s += gap_s
            if abs(gap_s + self._leap.by_s) < LEAP_S:  # time had leapt back and returns
                gap_s += self._leap.by_s
                self._lap = self._leap.lap if self._leap.is_left_behind(begins_ns) else self._lap
                self._leap = _NO_LEAP
            else:
                self._leap = _Leap(gap_s, self._ended_ns, self._lap)
        gap_s = max(gap_s, 0.0)
        self.gap_s += gap_s
        return gap_s

    def _leap_back(self, back_s: float, ended_ns: int, next_ns: int) -> None:
        """Go on in the next lap, or where time had leapt ahead and is back, nothing was missing, in its own."""
        self.leapt_s -= back_s
        before, self._leap = self._leap, _Leap(-back_s, ended_ns, self._lap)
        if abs(before.by_s - back_s) < LEAP_S:
            self.gap_s -= min(before.by_s, back_s)
            self._leap = _NO_LEAP
            if before.is_left_behind(next_ns):
                return
        self._lap += 1 + int(back_s // LAP_S)
