"""Timelines: what sensors' stamps say beside each other, where a clock was set anew, and where nothing is sent.

All sensors are stamped on one timeline, their own. A sensor whose stamps leap while the others go on has had its clock
set: it goes on being counted, nothing but the time it was away is missing. Where most leap alike, a bag loops, or
nothing was recorded meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from biodyn_core.base.segments import SEAT
from biodyn_core.conditioning.conditioner import Conditioner

JOINED_APART_S: Final = 60.0
"""A sensor that joins has another clock where its stamps differ by more; with less it may just be late."""

REMEMBERED: Final = 8
"""So many times that a clock was set are told from a return."""


class _Apart(NamedTuple):
    """How far a sensor's clock is ahead of the others', and what to add to the gaps that its conditioning counts."""

    by_s: float
    gap_s: float


_TOGETHER: Final = _Apart(0.0, 0.0)


class Timelines:
    """`note` a sensor after each push; ask how late it began, how long it is silent, how far its clock is apart.

    wait_s: what sensors may lag behind each other without being silent.
    """

    def __init__(self, conditioners: Mapping[str, Conditioner], wait_s: float) -> None:
        self._conditioners, self._wait_s = conditioners, wait_s
        self._near_s = 2.0 * wait_s
        self._leapt_s = dict.fromkeys(conditioners, 0.0)
        self._apart = {name: [_TOGETHER] for name in conditioners}
        self._began_s: dict[str, float] = {}
        self._sent_ns: dict[str, int] = {}
        self._front_s = self._reset_s = -math.inf
        self._behind_s = dict.fromkeys(conditioners, 0.0)

    def note(self, sensor: str) -> None:
        """A sensor has sent: see whether it joins, whether its stamps have leapt, and where it is beside the others."""
        joins = sensor not in self._began_s
        if joins or self._conditioners[sensor].runs.leapt_s != self._leapt_s[sensor]:
            self._look(sensor, joins)
        newest_ns = self._conditioners[sensor].newest_ns
        if newest_ns is not None and newest_ns != self._sent_ns.get(sensor):
            self._sent_ns[sensor] = newest_ns
            own_s = 1e-9 * newest_ns - self._apart[sensor][-1].by_s
            self._front_s = max(self._front_s, own_s)
            self._behind_s[sensor] = self._front_s - own_s

    def reset(self) -> None:
        """Who joins from now on is late since now."""
        self._reset_s = self._front_s

    def _look(self, sensor: str, joins: bool) -> None:
        """Look at a sensor that joins, or whose stamps have leapt."""
        conditioner, own_s = self._conditioners[sensor], self._newest_s(sensor)
        if own_s is None:
            return
        leapt_s = conditioner.runs.leapt_s - self._leapt_s[sensor]
        self._leapt_s[sensor] = conditioner.runs.leapt_s
        ahead_s = 0.0
        others = [s for name in self._began_s if name != sensor and (s := self._newest_s(name)) is not None]
        if others:
            ahead_s = own_s - max(others)
            # Where it was ahead of all others before it leapt, they have stopped and tell nothing.
            apart = abs(ahead_s) > JOINED_APART_S if joins else ahead_s - leapt_s < self._near_s < abs(ahead_s)
            if apart:
                away_s = 0.0 if joins else max(0.0, leapt_s - ahead_s)
                self._set(sensor, self.apart_s(sensor) + ahead_s, 0.0 if joins else away_s - max(0.0, leapt_s))
        if joins and conditioner.first_ns is not None:
            began_s = 1e-9 * conditioner.first_ns - self.apart_s(sensor)
            if ahead_s < -self._near_s:  # its clock is behind, or its samples came late: no other began late by that
                began_s = max(began_s, min(self._began_s.values()))
            self._began_s[sensor] = began_s
        self._follow_the_most()

    def apart_s(self, sensor: str) -> float:
        """How far its clock is ahead of that of most, since it was set anew; 0 where it is not."""
        return self._apart[sensor][-1].by_s

    def gap_s(self, sensor: str) -> float:
        """What to add to its gaps: the time it was away in place of what its clock was set by."""
        return self._apart[sensor][-1].gap_s

    def late_s(self, sensor: str) -> float:
        """How long after the first of all sensors, or the last reset, this one began, once longer than `wait_s`."""
        if sensor not in self._began_s:
            return 0.0
        late_s = self._began_s[sensor] - max(min(self._began_s.values()), self._reset_s)
        return late_s if late_s > self._wait_s else 0.0

    def silent_s(self, sensor: str) -> float:
        """How far the others went on since a sensor sent, once that is longer than `wait_s`.

        What it lay behind them as it sent is its clock or its way here, and no silence: over hours clocks drift apart.
        """
        own_s = self._newest_s(sensor)
        if own_s is None:
            return 0.0
        silent_s = self._front_s - own_s - self._behind_s[sensor]
        return silent_s if silent_s > self._wait_s else 0.0

    def _newest_s(self, sensor: str) -> float | None:
        """The newest stamp on the timeline of most."""
        newest_ns = self._conditioners[sensor].newest_ns
        return None if newest_ns is None else 1e-9 * newest_ns - self.apart_s(sensor)

    def _set(self, sensor: str, by_s: float, gap_s: float) -> None:
        """Its clock is apart by so much; where it was so before it has returned, and its conditioning knows."""
        before = self._apart[sensor]
        same = [i for i, one in enumerate(before) if abs(one.by_s - by_s) <= self._near_s]
        if same:
            self._apart[sensor] = before[: same[-1] + 1]
        else:
            self._apart[sensor] = [before[0], *before[1:][-REMEMBERED:], _Apart(by_s, before[-1].gap_s + gap_s)]

    def _follow_the_most(self) -> None:
        """Where most of those that send have leapt, they have not: the others are apart."""
        newest = {name: s for name in self._began_s if (s := self._newest_s(name)) is not None}
        if not newest:
            return
        sending = [name for name, newest_s in newest.items() if newest_s > max(newest.values()) - self._near_s]
        most = max(sending, key=lambda name: (self._alike(name, sending), self._near(name, SEAT)))
        by_s = self.apart_s(most)
        if abs(by_s) <= self._near_s:
            return
        for name in self._conditioners:
            self._set(name, self.apart_s(name) - by_s, 0.0)
        self._began_s = {name: began_s + by_s for name, began_s in self._began_s.items()}
        self._front_s += by_s
        self._reset_s += by_s

    def _alike(self, sensor: str, sending: list[str]) -> int:
        return sum(self._near(sensor, other) for other in sending)

    def _near(self, one: str, other: str) -> bool:
        return abs(self.apart_s(one) - self.apart_s(other)) <= self._near_s
