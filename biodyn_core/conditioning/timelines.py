"""Timelines: the stamps of sensors against each other: clocks that were set, late sensors, silent sensors.

All sensors share one time, which never steps back: the seconds of the first clock, plus pauses. The lead of each clock
over it changes only where stamps leap:

- A leap up to where the others are ends a silence: the lead stays, and the gap is missing.
- A leap behind the others, or back, shows a clock that was set: the lead changes, and only the silence is missing.
- A leap ahead of all others is undecided, and counts as a pause. The others decide it by samples that they send after
  it: most of them reach the same instant (a pause), or most go on before it (the clock of this sensor was set).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Final, NamedTuple

from biodyn_core.base.segments import SEAT
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.kernels.sensor import LEAP_S

JOINED_APART_S: Final = 60.0
"""A sensor whose first stamps differ from the others' by more has another clock; with less it is late."""

MAX_LEADS: Final = 8
"""Number of former leads that are recognised when a clock returns to them, or when another clock is set alike."""

VOTING_WAITS: Final = 1.25
"""An undecided leap is decided when another sensor has gone on for so many times `wait_s`.

By then every sensor that still sends has sent, and the samples from before a common leap have arrived. The quarter
is a margin for the samples that confirm a leap.
"""


class _Leap(NamedTuple):
    """A leap of one sensor's stamps; undecided while it is ahead of all others.

    leapt_s: its size. counted_s: the gap that the conditioning counted for it. silent_s: how far the others went on
    since the last sample before it. to_s: the instant after it. lags_s: the lag of each sensor before it. since_s: the
    first instant that each other sensor sent after it.
    """

    leapt_s: float
    counted_s: float
    silent_s: float
    to_s: float
    lags_s: Mapping[str, float]
    since_s: dict[str, float]

    @property
    def set_s(self) -> float:
        """By how much the clock was set, if it was."""
        return self.leapt_s - self.silent_s


class Timelines:
    """`update` a sensor after each push; read how late it began, how long it is silent, and its clock's offset.

    wait_s: the longest lag of a sensor behind the others that is no silence.

    Known limits. A sensor that alone falls silent, and whose clock stands still meanwhile or is set back by the same
    time, returns without a leap, as if its samples were late: the silence is missing only while it lasts. A pause
    that a clock set back follows within a few seconds is withdrawn for that sensor. Of two sensors, the seat's clock
    is right: where it is set ahead, the time is missing for both, and where it is set back in a common pause, the
    pause is too short for both.
    """

    def __init__(self, conditioners: Mapping[str, Conditioner], wait_s: float) -> None:
        self._conditioners, self._wait_s = conditioners, wait_s
        self._near_s = 2.0 * wait_s
        self._leapt_s = dict.fromkeys(conditioners, 0.0)
        self._counted_s = dict.fromkeys(conditioners, 0.0)
        self._gap_s = dict.fromkeys(conditioners, 0.0)
        self._behind_s = dict.fromkeys(conditioners, 0.0)
        self._silence_s = dict.fromkeys(conditioners, 0.0)
        self._sent_ns: dict[str, int] = {}
        # Of sensors that have joined: the first and the newest instant in the shared time, and the lead over it.
        self._began_s: dict[str, float] = {}
        self._at_s: dict[str, float] = {}
        self._lead_s: dict[str, float] = {}
        self._leads_s = [0.0]
        self._undecided: dict[str, _Leap] = {}
        self._front_s = self._reset_s = -math.inf

    def update(self, sensor: str) -> None:
        """Update after a push of one sensor: whether it joins, whether its stamps leapt, its lag behind the others."""
        conditioner = self._conditioners[sensor]
        newest_ns, first_ns = conditioner.newest_ns, conditioner.first_ns
        if newest_ns is None or first_ns is None or newest_ns == self._sent_ns.get(sensor):
            return
        self._sent_ns[sensor] = newest_ns
        if sensor not in self._began_s:
            self._join(sensor, 1e-9 * first_ns, 1e-9 * newest_ns)
        self._at_s[sensor] = 1e-9 * newest_ns - self._lead_s[sensor]
        if conditioner.runs.leapt_s != self._leapt_s[sensor]:
            self._leap(sensor)
            self._update_front()
        if self._undecided:
            self._vote(sensor)
            self._update_front()
        self._front_s = max(self._front_s, self._at_s[sensor]) if not self._undecided else self._front_s
        self._behind_s[sensor] = max(0.0, self._front_s - self._at_s[sensor])

    def reset(self) -> None:
        """A sensor that joins later is late since this reset."""
        self._reset_s = self._front_s
        self._undecided = self._recent()

    # --- figures -----------------------------------------------------------------------------------------------------

    def offset_s(self, sensor: str) -> float:
        """Lead of a sensor's clock over the majority since it was set, s; 0 if it was not set."""
        if sensor not in self._lead_s:
            return 0.0
        offset_s = self._lead_s[sensor] - self._majority_s()
        return offset_s if abs(offset_s) > self._near_s else 0.0

    def gap_s(self, sensor: str) -> float:
        """Correction of a sensor's gaps: its time of silence instead of the step of its clock."""
        return self._gap_s[sensor]

    def undecided_s(self, sensor: str) -> float:
        """The part of a sensor's missing time that is withdrawn if an undecided leap is a clock that was set, s.

        It includes all silence, which may be the leap of another sensor.
        """
        if not self._undecided:
            return 0.0
        counted_s = self._undecided[sensor].counted_s if sensor in self._undecided else 0.0
        return max(0.0, counted_s) + self.silent_s(sensor)

    def late_s(self, sensor: str, earlier_s: float = 0.0) -> float:
        """Delay of the first sample behind the first sensor or the last reset, s; 0 up to `wait_s`.

        earlier_s: time that earlier runs and the break after them lasted.
        """
        late_s = earlier_s + self.joined_s(sensor)
        return late_s if late_s > self._wait_s else 0.0

    def joined_s(self, sensor: str) -> float:
        """Instant of the first sample after the first sensor began or the last reset, s; 0 before it joins."""
        return self._began_s[sensor] - self._since_s() if sensor in self._began_s else 0.0

    def elapsed_s(self) -> float:
        """Time since the first sensor began or the last reset, s."""
        return max(0.0, self._front_s - self._since_s()) if self._began_s else 0.0

    def _since_s(self) -> float:
        return max(min(self._began_s.values()), self._reset_s)

    def silent_s(self, sensor: str) -> float:
        """Time of the other sensors since the last sample of this one, s; 0 up to `wait_s`.

        Its lag at that sample belongs to its clock or transport and is no silence: clocks drift apart over hours.
        """
        if sensor not in self._at_s:
            return 0.0
        silent_s = self._front_s - self._at_s[sensor] - self._behind_s[sensor]
        return silent_s if silent_s > self._wait_s else 0.0

    def _majority_s(self) -> float:
        """The lead that most sending sensors have; where two are as frequent, the seat's."""
        leads_s, near_s = self._lead_s, self._near_s
        sending = [name for name in leads_s if not self.silent_s(name)] or list(leads_s)

        def weight(one: str) -> tuple[int, bool]:
            alike = [other for other in sending if abs(leads_s[one] - leads_s[other]) <= near_s]
            return len(alike), SEAT in alike

        return leads_s[max(sending, key=weight)]

    # --- joins and leaps ---------------------------------------------------------------------------------------------

    def _join(self, sensor: str, first_s: float, newest_s: float) -> None:
        """Begin a sensor by the majority's clock, or by one of its own if its stamps are far from all others'."""
        self._leapt_s[sensor] = self._conditioners[sensor].runs.leapt_s
        self._counted_s[sensor] = self._conditioners[sensor].runs.leap_gap_s
        if not self._began_s:
            self._lead_s[sensor], self._began_s[sensor] = 0.0, first_s
            return
        lead_s = self._majority_s()
        if min(abs(newest_s - lead_s - at_s) for at_s in self._at_s.values()) > JOINED_APART_S:
            lead_s = self._known_lead(newest_s - self._front_s)
        began_s = first_s - lead_s
        if newest_s - lead_s < self._front_s - self._near_s:
            # Its clock is behind, or its samples came late: the others did not begin late, and it began just now.
            began_s = max(began_s, min(self._began_s.values()), self._front_s - (newest_s - first_s))
        self._lead_s[sensor], self._began_s[sensor] = lead_s, began_s

    def _leap(self, sensor: str) -> None:
        """Classify a leap of a sensor's stamps by the place of the others."""
        leap = self._new_leap(sensor)
        self._keep_silence(sensor, leap)
        before = self._undecided.pop(sensor, None)
        if before is not None:
            leap = leap._replace(
                leapt_s=before.leapt_s + leap.leapt_s, counted_s=before.counted_s + leap.counted_s,
                silent_s=before.silent_s + leap.silent_s, lags_s=before.lags_s,
            )  # fmt: skip
            if abs(leap.leapt_s) < LEAP_S and abs(leap.counted_s) < LEAP_S:
                return  # the stamps return, and the conditioning has withdrawn the gap
        if leap.set_s > self._near_s:
            self._undecided[sensor] = leap
        elif leap.set_s < -self._near_s:
            self._set(sensor, leap)
        elif leap.leapt_s > 0.0 and leap.silent_s - leap.counted_s > LEAP_S:
            # The conditioning took it for the return of a clock that was set back, but the others went on meanwhile.
            self._gap_s[sensor] += leap.silent_s - leap.counted_s

    def _keep_silence(self, sensor: str, leap: _Leap) -> None:
        """Keep the gap of a leap in which the others went on: a clock set back by as much withdraws it in `Runs`."""
        if leap.leapt_s > 0.0:
            self._silence_s[sensor] = min(leap.silent_s, leap.counted_s) if leap.silent_s > LEAP_S else 0.0
        elif leap.counted_s < 0.0:
            self._gap_s[sensor] += min(self._silence_s[sensor], -leap.counted_s)
            self._silence_s[sensor] = 0.0

    def _new_leap(self, sensor: str) -> _Leap:
        """The leap since the sensor's last update."""
        runs, at_s = self._conditioners[sensor].runs, self._at_s[sensor]
        leapt_s, counted_s = runs.leapt_s - self._leapt_s[sensor], runs.leap_gap_s - self._counted_s[sensor]
        self._leapt_s[sensor], self._counted_s[sensor] = runs.leapt_s, runs.leap_gap_s
        recent = self._recent()
        others = [s for name, s in self._at_s.items() if name != sensor and name not in recent]
        lags_s = dict(self._behind_s)
        for before in reversed(recent.values()):  # the first leap changes the front, and with it all later lags
            lags_s |= before.lags_s
        silent_s = max(others, default=-math.inf) - lags_s[sensor] - (at_s - leapt_s)
        return _Leap(leapt_s, counted_s, max(0.0, silent_s), at_s, lags_s, {})

    def _recent(self) -> dict[str, _Leap]:
        """The undecided leaps that other sensors may still decide, the oldest first; an older one is a pause."""
        limit_s = 2.0 * self._near_s
        return {name: leap for name, leap in self._undecided.items() if self._at_s[name] - leap.to_s <= limit_s}

    def _set(self, sensor: str, leap: _Leap) -> None:
        """Count a leap as a clock that was set: only its silence is missing."""
        self._move(sensor, leap.set_s)
        counted_s = leap.counted_s
        if counted_s < 0.0:  # the conditioning has withdrawn an earlier gap, which may be corrected here already
            counted_s = -min(-counted_s, max(0.0, -self._gap_s[sensor]))
        self._gap_s[sensor] += leap.silent_s - counted_s

    def _move(self, sensor: str, by_s: float) -> None:
        """Change the lead of a sensor's clock."""
        moved_s = self._known_lead(self._lead_s[sensor] + by_s) - self._lead_s[sensor]
        self._lead_s[sensor] += moved_s
        self._at_s[sensor] -= moved_s

    def _known_lead(self, lead_s: float) -> float:
        """A known lead where one is near, so that clocks that are set alike stay alike; else the lead as given."""
        leads_s = (*self._lead_s.values(), *self._leads_s)
        known = [one for one in leads_s if abs(one - lead_s) <= self._near_s]
        if known:
            return min(known, key=lambda one: abs(one - lead_s))
        self._leads_s = [*self._leads_s[-MAX_LEADS:], lead_s]
        return lead_s

    # --- undecided leaps ---------------------------------------------------------------------------------------------

    def _vote(self, sensor: str) -> None:
        """Take the newest sample of a sensor as a vote on undecided leaps; decide those with enough of them."""
        at_s = self._at_s[sensor]
        for name, leap in list(self._undecided.items()):
            if name not in self._undecided:
                continue  # decided with the one before
            if name != sensor:
                leap.since_s.setdefault(sensor, at_s)
            went_on = self._went_on(leap)
            if sensor in went_on and at_s - leap.since_s[sensor] > VOTING_WAITS * self._wait_s:
                self._decide(name, leap, went_on)
            elif name == sensor and leap.since_s and at_s - leap.to_s > (4.0 if went_on else 2.0) * self._near_s:
                # A pause: whoever went on would have decided the leap by now, also one that returned a little later.
                del self._undecided[name]

    def _went_on(self, leap: _Leap) -> set[str]:
        """The other sensors that sent after a leap from instants before it, as if there was no pause."""
        limit_s = leap.to_s - self._near_s
        return {name for name in leap.since_s if self._at_s[name] + leap.lags_s[name] < limit_s}

    def _decide(self, sensor: str, leap: _Leap, went_on: Collection[str]) -> None:
        """Decide a leap by the majority of the sensors that sent after it, where equal by the seat's side."""
        del self._undecided[sensor]
        paused = {sensor, *leap.since_s}.difference(went_on)
        if (len(went_on), SEAT in went_on) > (len(paused), SEAT in paused):
            self._set(sensor, leap._replace(silent_s=self._silence_before_s(sensor, leap, went_on)))
            return
        here_s = self._at_s[sensor] + leap.lags_s[sensor]
        for other in went_on:  # its clock was set back within the pause, or stood still, so its own gap is too small
            by_s = here_s - self._at_s[other] - leap.lags_s[other]
            self._move(other, -by_s)
            self._gap_s[other] += by_s
            self._undecided.pop(other, None)

    def _silence_before_s(self, sensor: str, leap: _Leap, went_on: Collection[str]) -> float:
        """How far the others went on since the last sample before a leap, also if their own leaps were undecided."""
        others_s = max(self._at_s[other] + leap.lags_s[other] for other in went_on)
        silent_s = others_s - (self._at_s[sensor] + leap.lags_s[sensor] - leap.leapt_s)
        # A small difference is no silence: it is the order in which the newest samples arrived.
        return silent_s if silent_s > leap.silent_s + self._near_s else leap.silent_s

    def _update_front(self) -> None:
        """The newest instant of all sensors; a recent undecided leap counts while no other sensor went on before it."""
        doubtful = {name for name, leap in self._recent().items() if self._went_on(leap)}
        self._front_s = max(s for name, s in self._at_s.items() if name not in doubtful)
        self._reset_s = min(self._reset_s, self._front_s)
