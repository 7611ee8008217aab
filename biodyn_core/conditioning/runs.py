"""Runs: stretches of one sensor without a break, the gaps between them, and stamps that leap and return."""

from __future__ import annotations

from typing import Final, NamedTuple

from biodyn_core.kernels.sensor import LEAP_S

LAP_S: Final = 1e6
"""Added to a sensor's own seconds, as often as needed, when its stamps jump back, so that its time increases.

Its time jumps back only where leapt stamps return, to be aligned again with sensors that did not leap.
"""

OVERLAP_NS: Final = 100_000_000
"""Returning stamps may overlap so far with those before the leap by jitter; more is a second lap of a bag."""

RETURN_S: Final = 60.0
"""A leap by less is matched with a return only so soon after it.

Later, a real dropout or a clock set back by the same seconds is more likely, and to match it would hide a real gap.
A dropout of just the size of a longer leap is unlikely at any time.
"""


class _Leap(NamedTuple):
    """A leap of stamps, seconds, the last instant before it and the first one after it, ns, and the lap before it."""

    by_s: float
    left_ns: int
    reached_ns: int
    lap: int

    def is_undone(self, by_s: float, ended_ns: int) -> bool:
        """Whether a leap by so many seconds, from an instant on, is the return from this one."""
        recent = abs(self.by_s) > RETURN_S or (ended_ns - self.reached_ns) * 1e-9 <= RETURN_S
        return recent and abs(self.by_s + by_s) < LEAP_S

    def is_left_behind(self, stamp_ns: int) -> bool:
        """Whether a returning stamp lies beyond the instant before the leap, within the jitter."""
        return stamp_ns > self.left_ns - OVERLAP_NS


_NO_LEAP: Final = _Leap(0.0, 0, 0, 0)


class Runs:
    """Count runs by `add` and `end`, in the order of the samples.

    count: number of runs. gap_s: sum of the gaps between them. leapt_s: sum of all leaps of more than a second between
    runs, negative for leaps back, by a set clock or a pause. leap_gap_s: the part of gap_s that such leaps have.

    Known limits, because each sensor counts its laps alone. A sensor that is silent while all clocks are set back, and
    returns beyond its last stamp, stays in its lap: the others are no longer compared with it. The same holds for one
    clock that is set ahead by less than `RETURN_S`, and returns later than that. A dropout within
    `RETURN_S` of a clock set back by the same seconds, within `LEAP_S`, counts only by their difference, and a clock
    set back so soon after such a dropout withdraws it; unless samples arrived in it that could not be used, or other
    sensors show its time (`Timelines`).
    """

    def __init__(self) -> None:
        self.count = 0
        self.gap_s = 0.0
        self.leapt_s = 0.0
        self.leap_gap_s = 0.0
        self._in_run = False
        self._rejected_s = 0.0
        self._ended_ns: int | None = None
        self._lap = 0
        self._leap = _NO_LEAP

    @property
    def lap_s(self) -> float:
        """Offset of the sensor's time to its stamps, after jumps back."""
        return self._lap * LAP_S

    def add(self, begins_ns: int, ends_ns: int, period_s: float) -> tuple[bool, float]:
        """Add samples; return whether a run begins with them, and the gap before it."""
        begins_run = not self._in_run
        gap_s = self._begin(begins_ns, period_s) if begins_run else 0.0
        self._ended_ns = ends_ns
        return begins_run, gap_s

    def end(self, next_ns: int, period_s: float, rejected_s: float = 0.0) -> None:
        """End the run; the next one begins at a stamp, which may lie before the end of this one.

        rejected_s: time of the samples in between that could not be used.
        """
        self._in_run, self._rejected_s = False, rejected_s
        if self._ended_ns is not None and next_ns < self._ended_ns:
            self._leap_back((self._ended_ns - next_ns) * 1e-9 + period_s, self._ended_ns, next_ns)
            self._ended_ns = None

    def _begin(self, begins_ns: int, period_s: float) -> float:
        """Count a run and the gap before it, which is returned."""
        self._in_run = True
        self.count += 1
        if self._ended_ns is None:
            return 0.0
        gap_s = (begins_ns - self._ended_ns) * 1e-9 - period_s
        if gap_s - self._rejected_s > LEAP_S:  # otherwise rejected samples fill the gap, and no stamp has leapt
            self.leapt_s += gap_s
            if self._leap.is_undone(gap_s, self._ended_ns):  # stamps had leapt back and return
                gap_s += self._leap.by_s
                self._lap = self._leap.lap if self._leap.is_left_behind(begins_ns) else self._lap
                self._leap = _NO_LEAP
            else:
                self._leap = _Leap(gap_s, self._ended_ns, begins_ns, self._lap)
            self.leap_gap_s += max(gap_s, 0.0)
        gap_s = max(gap_s, 0.0)
        self.gap_s += gap_s
        return gap_s

    def _leap_back(self, back_s: float, ended_ns: int, next_ns: int) -> None:
        """Begin the next lap; where stamps had leapt ahead and return, stay in the lap and withdraw the gap."""
        self.leapt_s -= back_s
        before, self._leap = self._leap, _Leap(-back_s, ended_ns, next_ns, self._lap)
        if before.is_undone(-back_s, ended_ns):
            withdrawn_s = min(before.by_s, back_s)
            self.gap_s -= withdrawn_s
            self.leap_gap_s -= withdrawn_s
            self._leap = _NO_LEAP
            if before.is_left_behind(next_ns):
                return
        self._lap += 1 + int(back_s // LAP_S)
