"""Sending budget: when single samples are not sent, because sending them takes twice as long as their motion lasts.

A subscriber to six topics that hangs makes publishing by DDS nine times as slow, up to a second at once. The thread
that sends also reads the sensors, whose queues would overflow, so predictions are left out before any exposure is lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from biodyn_core.base.arrays import Integers

WINDOW_S: Final = 0.5
"""The time spent on so much motion decides."""

MOST_SPENT: Final = 2.0
"""Seconds of sending for each second of motion; with a subscriber that hangs it took seven (2026-11-29)."""

LONGEST_STEP_NS: Final = 50_000_000
"""A longer step between blocks is a break, not motion."""

FIRST_PAUSE_S: Final = 2.0
LONGEST_PAUSE_S: Final = 64.0
"""Each pause that follows a failed attempt is twice as long as the one before."""


class SendingBudget:
    """`spend` the time that sending a block took; `allows` tells whether to send the next one.

    paused: whether samples are left out now. unsent: number of instants left out so far.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._spent_s = self._motion_s = 0.0
        self._pause_s = FIRST_PAUSE_S
        self._until_s: float | None = None
        self._last_ns: int | None = None
        self.unsent = 0

    @property
    def paused(self) -> bool:
        """Whether samples are left out."""
        return self._until_s is not None

    def allows(self, instants: int) -> bool:
        """Whether to send a block of so many instants; they are counted as unsent if not."""
        if self._until_s is not None and self._now() < self._until_s:
            self.unsent += instants
            return False
        return True

    def end_pause(self) -> None:
        """Begin anew, because nobody wants samples."""
        self._until_s, self._pause_s = None, FIRST_PAUSE_S
        self._spent_s = self._motion_s = 0.0

    def spend(self, spent_s: float, stamps_ns: Integers) -> None:
        """Note that sending a block of instants (n,) ns took so long."""
        self._spent_s += spent_s
        if stamps_ns.size:
            since_ns = int(stamps_ns[0]) - (self._last_ns if self._last_ns is not None else int(stamps_ns[0]))
            self._last_ns = int(stamps_ns[-1])
            step_ns = since_ns if 0 < since_ns < LONGEST_STEP_NS else 0
            self._motion_s += 1e-9 * (self._last_ns - int(stamps_ns[0]) + step_ns)
        if max(self._spent_s, self._motion_s) < WINDOW_S:
            return
        if self._spent_s > MOST_SPENT * self._motion_s:
            self._until_s = self._now() + self._pause_s
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
        else:
            self._until_s, self._pause_s = None, FIRST_PAUSE_S
        self._spent_s = self._motion_s = 0.0
