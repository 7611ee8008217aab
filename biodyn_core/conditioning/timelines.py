"""Timelines: the stamps of sensors against each other: clocks that were set, late sensors, silent sensors.

If the stamps of one sensor leap, its clock was set: its samples are counted further, and only its silence is missing.
If most sensors leap alike, a bag loops or the recording paused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from biodyn_core.base.segments import SEAT
from biodyn_core.conditioning.conditioner import Conditioner

JOINED_APART_S: Final = 60.0
"""A sensor whose first stamps differ from the others' by more has another clock; with less it is late."""

MAX_OFFSETS: Final = 8
"""Number of former clock offsets of a sensor that are recognised when its clock returns to them."""


class _Offset(NamedTuple):
    """Lead of a sensor's clock over the others, and the correction of the gaps that its conditioning counts."""

    ahead_s: float
    gap_s: float


_NO_OFFSET: Final = _Offset(0.0, 0.0)


class Timelines:
    """`update` a sensor after each push; read how late it began, how long it is silent, and its clock's offset.

    wait_s: the longest lag of a sensor behind the others that is no silence.
    """

    def __init__(self, conditioners: Mapping[str, Conditioner], wait_s: float) -> None:
        self._conditioners, self._wait_s = conditioners, wait_s
        self._near_s = 2.0 * wait_s
        self._leapt_s = dict.fromkeys(conditioners, 0.0)
        self._offsets = {name: [_NO_OFFSET] for name in conditioners}
        self._began_s: dict[str, float] = {}
        self._sent_ns: dict[str, int] = {}
        self._front_s = self._reset_s = -math.inf
        self._behind_s = dict.fromkeys(conditioners, 0.0)

    def update(self, sensor: str) -> None:
        """Update after a push of one sensor: whether it joins, whether its stamps leapt, its lag behind the others."""
        joins = sensor not in self._began_s
        if joins or self._conditioners[sensor].runs.leapt_s != self._leapt_s[sensor]:
            self._update_offset(sensor, joins)
        newest_ns = self._conditioners[sensor].newest_ns
        if newest_ns is not None and newest_ns != self._sent_ns.get(sensor):
            self._sent_ns[sensor] = newest_ns
            own_s = 1e-9 * newest_ns - self._offsets[sensor][-1].ahead_s
            self._front_s = max(self._front_s, own_s)
            self._behind_s[sensor] = self._front_s - own_s

    def reset(self) -> None:
        """A sensor that joins later is late since this reset."""
        self._reset_s = self._front_s

    def _update_offset(self, sensor: str, joins: bool) -> None:
        """Update the offset of a sensor that joins, or whose stamps leapt."""
        conditioner, own_s = self._conditioners[sensor], self._newest_s(sensor)
        if own_s is None:
            return
        leapt_s = conditioner.runs.leapt_s - self._leapt_s[sensor]
        self._leapt_s[sensor] = conditioner.runs.leapt_s
        ahead_s = 0.0
        others = [s for name in self._began_s if name != sensor and (s := self._newest_s(name)) is not None]
        if others:
            ahead_s = own_s - max(others)
            # Where it was ahead of all others before the leap, they have stopped, and nothing can be concluded.
            was_set = abs(ahead_s) > JOINED_APART_S if joins else ahead_s - leapt_s < self._near_s < abs(ahead_s)
            if was_set:
                away_s = 0.0 if joins else max(0.0, leapt_s - ahead_s)
                self._set(sensor, self.offset_s(sensor) + ahead_s, 0.0 if joins else away_s - max(0.0, leapt_s))
        if joins and conditioner.first_ns is not None:
            began_s = 1e-9 * conditioner.first_ns - self.offset_s(sensor)
            if ahead_s < -self._near_s:  # its clock is behind, or its samples came late: the others did not begin late
                began_s = max(began_s, min(self._began_s.values()))
            self._began_s[sensor] = began_s
        self._follow_majority()

    def offset_s(self, sensor: str) -> float:
        """Lead of a sensor's clock over the majority since it was set, s; 0 if it was not set."""
        return self._offsets[sensor][-1].ahead_s

    def gap_s(self, sensor: str) -> float:
        """Correction of a sensor's gaps: its time of silence instead of the step of its clock."""
        return self._offsets[sensor][-1].gap_s

    def late_s(self, sensor: str) -> float:
        """Delay of the first sample behind the first sensor or the last reset, s; 0 up to `wait_s`."""
        if sensor not in self._began_s:
            return 0.0
        late_s = self._began_s[sensor] - max(min(self._began_s.values()), self._reset_s)
        return late_s if late_s > self._wait_s else 0.0

    def silent_s(self, sensor: str) -> float:
        """Time of the other sensors since the last sample of this one, s; 0 up to `wait_s`.

        Its lag at that sample belongs to its clock or transport and is no silence: clocks drift apart over hours.
        """
        own_s = self._newest_s(sensor)
        if own_s is None:
            return 0.0
        silent_s = self._front_s - own_s - self._behind_s[sensor]
        return silent_s if silent_s > self._wait_s else 0.0

    def _newest_s(self, sensor: str) -> float | None:
        """The newest stamp on the majority's timeline."""
        newest_ns = self._conditioners[sensor].newest_ns
        return None if newest_ns is None else 1e-9 * newest_ns - self.offset_s(sensor)

    def _set(self, sensor: str, by_s: float, gap_s: float) -> None:
        """Set a sensor's offset; one that it had before is a return, which its conditioning has handled."""
        before = self._offsets[sensor]
        same = [i for i, one in enumerate(before) if abs(one.ahead_s - by_s) <= self._near_s]
        if same:
            self._offsets[sensor] = before[: same[-1] + 1]
        else:
            self._offsets[sensor] = [before[0], *before[1:][-MAX_OFFSETS:], _Offset(by_s, before[-1].gap_s + gap_s)]

    def _follow_majority(self) -> None:
        """Use the timeline of most sending sensors if they leapt alike: the others have the offset."""
        newest = {name: s for name in self._began_s if (s := self._newest_s(name)) is not None}
        if not newest:
            return
        sending = [name for name, newest_s in newest.items() if newest_s > max(newest.values()) - self._near_s]
        most = max(sending, key=lambda name: (self._alike(name, sending), self._near(name, SEAT)))
        by_s = self.offset_s(most)
        if abs(by_s) <= self._near_s:
            return
        for name in self._conditioners:
            self._set(name, self.offset_s(name) - by_s, 0.0)
        self._began_s = {name: began_s + by_s for name, began_s in self._began_s.items()}
        self._front_s += by_s
        self._reset_s += by_s

    def _alike(self, sensor: str, sending: list[str]) -> int:
        return sum(self._near(sensor, other) for other in sending)

    def _near(self, one: str, other: str) -> bool:
        return abs(self.offset_s(one) - self.offset_s(other)) <= self._near_s
