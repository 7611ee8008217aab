"""Health of the live streams: who is silent, late, lost or mismatched, as plain statuses. Knows no ROS.

A status tells of now: a count that has stopped growing is among the values, and no cause for alarm any more.

Silence is judged on a steady clock, because a stopped /clock must not hide a dead sensor. Lag is arrival minus stamp
less the smallest such offset of the window: an unsynchronised clock or an old bag is not lag.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from biodyn_core.base.segments import SEAT
from biodyn_core.base.wording import counted
from biodyn_core.conditioning.clocks import ClockComparison, ClockDrift
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.base.wording import MODEL, left_range
from biodyn_ros.node.state import ExposureStore

SILENT_AFTER_S: Final = 0.5
CLOCK_OFF_S: Final = 0.02
"""Stamps that lie further off the seat's, by their arrival, leave nothing of a residual from 12 Hz on."""

SETTLING_S: Final = 1.4
"""2.5 time constants of the slowest filter, Wk's high-pass: 8 % is left of any step that a run begins with."""

OFF: Final = "by clock or transport: its residual tells of that"

LOOKS: Final = 2
"""A count is growing that has grown within so many looks."""

MARKS_KEPT: Final = 5
"""So many marks are shown beside the shocks; all are told when they are set."""

OK, WARN, ERROR = range(3)

CAUSES: Final = {
    "unset": ("stamp never set", "stamps never set"),
    "stray": ("stamp astray", "stamps astray"),
    "late": ("sample too late", "samples too late"),
    "duplicate": ("sample that came twice", "samples that came twice"),
    "non_finite": ("reading that is no number, or impossible", "readings that are no numbers, or impossible"),
    "flat": ("sample of a reading that never changes", "samples of a reading that never changes"),
    "clipped": ("sample clipped", "samples clipped"),
    "filled": ("sample lost and interpolated", "samples lost and interpolated"),
    "lost": ("message lost in transport", "messages lost in transport"),
    "errors": ("message refused", "messages refused"),
}
"""What is wrong with a sample or message, and with several of them, by its count."""

COUNTS: Final = (
    "accepted", "unset", "non_finite", "duplicate", "late", "stray", "filled", "flat", "clipped", "runs", "gap_s",
    "set_back_s", "uncounted_s",
)  # fmt: skip
"""What of a sensor's conditioning stands in the diagnostics beside rate and gravity."""


@dataclass(frozen=True)
class Mark:
    """An instant that somebody marked: a running name, and when, by the node's clock."""

    name: str
    at_s: float

    def __str__(self) -> str:
        return f"{self.name} at {self.at_s:.3f} s"


@dataclass(frozen=True)
class Status:
    """What is said of a sensor, of `prediction`, `exposure` or `page`: level, message and values by key."""

    of: str
    level: int
    message: str
    values: dict[str, str]


class CounterDelta:
    """By how much counts have grown over the last looks."""

    def __init__(self) -> None:
        self._before: deque[dict[str, int]] = deque(maxlen=LOOKS)
        self.by: dict[str, int] = {}

    def look(self, counts: dict[str, int]) -> None:
        """Look at the counts as they are now."""
        since = self._before[0] if self._before else {}
        self.by = {key: grown for key, count in counts.items() if (grown := count - since.get(key, 0)) > 0}
        self._before.append(counts)


@dataclass
class SensorHealth:
    """What the transport tells of one sensor; the callbacks note, `HealthMonitor` reads."""

    arrived_s: float | None = None
    messages: int = 0
    lost: int = 0
    errors: int = 0
    last_error: str = ""
    incompatible_qos: str = ""
    wrong_type: str = ""
    publishers: int = 0
    lag_s: float | None = None
    clock: ClockComparison = field(default_factory=ClockComparison)
    drift: ClockDrift | None = None
    growth: CounterDelta = field(default_factory=CounterDelta)
    now: Callable[[], float] = time.monotonic
    _numbers_from: int | None = None
    _offsets_s: deque[tuple[float, float]] = field(default_factory=deque)

    def arrived(self, count: int = 1) -> None:
        """Note that messages came just now."""
        self.arrived_s = self.now()
        self.messages += count

    def numbered(self, number: int, received: int) -> None:
        """Compare the number that the only publisher gave a message with the count received: losses set them apart."""
        ahead = number - received
        if self._numbers_from is not None and ahead > self._numbers_from:
            self.lost += ahead - self._numbers_from
        self._numbers_from = ahead

    def forget_numbers(self) -> None:
        """Another publisher has numbers of its own."""
        self._numbers_from = None

    def refused(self, why: str) -> None:
        """Note that a message could not be used."""
        self.errors += 1
        self.last_error = why

    def timed(self, stamp_ns: int, arrival_ns: int, window_s: float) -> None:
        """Note when a message arrived, by the clock that stamps are of; lag is judged over a window."""
        self.clock.push(np.array([stamp_ns]), np.array([arrival_ns]))
        arrival_minus_stamp_s = 1e-9 * (arrival_ns - stamp_ns)
        now = self.now()
        while self._offsets_s and self._offsets_s[0][0] < now - window_s:
            self._offsets_s.popleft()
        # Ascending from the left: what a later, smaller offset makes useless is dropped.
        while self._offsets_s and self._offsets_s[-1][1] >= arrival_minus_stamp_s:
            self._offsets_s.pop()
        self._offsets_s.append((now, arrival_minus_stamp_s))
        self.lag_s = arrival_minus_stamp_s - self._offsets_s[0][1]

    def look(self, seen: SensorStatus) -> None:
        """Look at what has gone wrong since the last looks."""
        own = {"lost": self.lost, "errors": self.errors, "gaps": max(0, seen.runs - 1)}
        self.growth.look({key: own[key] if key in own else getattr(seen, key) for key in (*CAUSES, "gaps")})

    @property
    def causes(self) -> str:
        """What goes wrong with its samples now, by count."""
        told = [counted(n, *CAUSES[key]) for key, n in self.growth.by.items() if key in CAUSES]
        if "errors" in self.growth.by:
            told.append(self.last_error)
        return "; ".join(told)

    def compare_clock(self) -> None:
        """Look anew at how the sensor's stamps run against arrivals; costs a millisecond or two."""
        self.drift = self.clock.since_leap()

    @property
    def offset_s(self) -> float | None:
        """By how much arrivals lie behind stamps now, by the least delay; None while that is not known."""
        drift = self.drift
        return None if drift is None else drift.offset_s - 1e-6 * (drift.ppm or 0.0) * drift.seconds

    @property
    def silent_s(self) -> float | None:
        """Seconds since the last message, None before the first."""
        return None if self.arrived_s is None else self.now() - self.arrived_s


def is_settling(seen: SensorStatus) -> bool:
    """Whether filters still ring from how the run began; those that began at rest did so in steady state."""
    rested = seen.runs == 1 and seen.uncounted_s > 0.0
    return seen.run_s is not None and not rested and seen.run_s < SETTLING_S


class HealthMonitor:
    """Looks at model and sensors a few times a second, and judges them as they are now.

    health: by sensor, noted by whoever receives its messages. marks: the latest, the newest first.
    """

    def __init__(self, pipeline: Pipeline, health: Mapping[str, SensorHealth]) -> None:
        self._pipeline, self._health = pipeline, health
        self._divergences = CounterDelta()
        self._marks = 0
        self.marks: deque[Mark] = deque(maxlen=MARKS_KEPT)

    def mark(self, at_s: float) -> Mark:
        """Note an instant that somebody marks."""
        self._marks += 1
        mark = Mark(f"mark {self._marks}", at_s)
        self.marks.appendleft(mark)
        return mark

    def look(self, arrivals_tell: bool = True) -> list[Status]:
        """Look: the status of the prediction, and of every sensor.

        arrivals_tell: whether arrivals say how a clock is set; a simulated clock moves in steps, and times none.
        """
        self._divergences.look({"divergences": self._pipeline.divergences})
        for sensor, health in self._health.items():
            health.look(self._pipeline.status(sensor))
        last_mark = str(self.marks[0]) if self.marks else ""
        prediction = prediction_status(self._pipeline, self._health[SEAT], self._divergences, last_mark)
        ahead_s = {sensor: self._ahead_of_seat_s(sensor) if arrivals_tell else None for sensor in self._health}
        return [
            prediction,
            *(sensor_status(name, one, self._pipeline, ahead_s[name]) for name, one in self._health.items()),
        ]

    def _ahead_of_seat_s(self, sensor: str) -> float | None:
        """By how much a sensor's stamps lie ahead of the seat's, as far as arrivals tell; None while they do not."""
        own_s, seat_s = self._health[sensor].offset_s, self._health[SEAT].offset_s
        return None if own_s is None or seat_s is None else seat_s - own_s


def sensor_status(name: str, health: SensorHealth, pipeline: Pipeline, off_s: float | None = None) -> Status:
    """Judge one sensor, as it is now; off_s: by how much its stamps lie ahead of the seat's, by their arrival."""
    seen, lost, silent = pipeline.status(name), pipeline.lost(name), health.silent_s
    apart_s, off_ms = pipeline.clock_apart_s(name), 1e3 * (off_s or 0.0)
    checks: list[tuple[bool, int, Callable[[], str]]] = [
        (bool(health.wrong_type), ERROR, lambda: health.wrong_type),
        (bool(health.incompatible_qos), ERROR, lambda: health.incompatible_qos),
        (seen.fault is not None, ERROR, lambda: seen.fault or ""),
        (silent is None, ERROR if name == SEAT else WARN, lambda: "no message yet"),
        ((silent or 0.0) > SILENT_AFTER_S, ERROR if name == SEAT else WARN, lambda: f"silent for {silent:.1f} s"),
        (health.publishers > 1, WARN, lambda: f"{health.publishers} publishers send to it: whose are the samples?"),
        (bool(health.causes), WARN, lambda: health.causes),
        (seen.waiting is not None, WARN, lambda: seen.waiting or ""),
        ("gaps" in health.growth.by, WARN, lambda: "a gap: figures begin anew behind it"),
        (apart_s != 0.0, WARN, lambda: f"its clock was set {apart_s:+.1f} s against the others': it is not compared"),
        (abs(off_ms) > 1e3 * CLOCK_OFF_S, WARN, lambda: f"its stamps lie {off_ms:+.0f} ms off the seat's, {OFF}"),
        (bool(seen.warnings), WARN, lambda: seen.warnings[0] if seen.warnings else ""),
        (is_settling(seen), OK, lambda: "settling behind a gap"),
    ]
    level, message = next(((level, text()) for wrong, level, text in checks if wrong), (OK, "streaming"))
    values = {
        "rate_hz": _number(seen.rate_hz, ".3f"),
        "jitter_ms": _number(seen.jitter_s and 1e3 * seen.jitter_s, ".3f"),
        "gravity_mps2": _number(seen.gravity_mps2, ".3f"),
        "vertical": " ".join(f"{v:.4f}" for v in seen.vertical) if seen.vertical else "",
        "filter_delay_ms": _number(seen.filter_delay_s and 1e3 * seen.filter_delay_s, ".3f"),
        "silent_s": _number(silent, ".2f"),
        "lag_ms": _number(health.lag_s and 1e3 * health.lag_s, ".2f"),
        "clock_ppm": _number(health.drift and health.drift.ppm, ".1f"),
        "clock_offset_ms": _number(health.drift and 1e3 * health.drift.offset_s, ".3f"),
        "messages": str(health.messages),
        "lost": str(health.lost),
        "refused": str(health.errors),
        "publishers": str(health.publishers),
        "clock_apart_s": f"{apart_s:.3f}",
        "clock_off_ms": _number(off_s and 1e3 * off_s, ".3f"),
        "missing_s": f"{lost.missing_s:.3f}",
        "lower_bound": str(lost.lower_bound).lower(),
        "settling": str(is_settling(seen)).lower(),
    }
    return Status(name, level, message, values | {key: f"{getattr(seen, key):g}" for key in COUNTS})


def prediction_status(pipeline: Pipeline, seat: SensorHealth, growth: CounterDelta, mark: str) -> Status:
    """Judge the model, as it is now: it predicts while the seat lives. growth: of how often it left its range."""
    seen, silent = pipeline.status(SEAT), seat.silent_s
    stopped = seen.fault
    if silent is None or silent > SILENT_AFTER_S:  # what another publisher is or asks for stops nobody
        unheard = "has sent nothing" if silent is None else f"is silent for {silent:.1f} s"
        stopped = stopped or seat.wrong_type or seat.incompatible_qos or unheard
    lost = growth.by.get("divergences", 0)
    checks: list[tuple[bool, int, Callable[[], str]]] = [
        (bool(stopped), ERROR, lambda: f"predictions stopped: seat {stopped}"),
        (seen.waiting is not None, WARN, lambda: f"seat: {seen.waiting}"),
        (lost > 0, ERROR, lambda: f"{MODEL} {left_range(lost)}"),
        (is_settling(seen), OK, lambda: "settling behind a gap of the seat"),
    ]
    level, message = next(((level, text()) for wrong, level, text in checks if wrong), (OK, "predicting"))
    subject = pipeline.subject
    values = {
        "subject": subject.name,
        "mass_matrix": subject.mass_matrix,
        "substeps": str(pipeline.substeps or ""),
        "divergences": str(pipeline.divergences),
        "settling": str(is_settling(seen)).lower(),
        "last_mark": mark,
    }
    for output, latency in pipeline.latency().items():
        values[f"{output}_latency_ms"] = " + ".join(f"{1e3 * part:.3f}" for part in latency)
    return Status("prediction", level, message, values)


def keeping_status(keeper: ExposureStore) -> Status:
    """Judge whether exposure would survive a restart."""
    level, message = (WARN, keeper.failed) if keeper.failed else (OK, "kept across restarts")
    values = {"state_file": str(keeper.path), "went_on": str(keeper.resumed).lower()}
    return Status("exposure", level, message, values)


def page_status(address: str, failure: str) -> Status:
    """Judge whether the live page is served."""
    level, message = (WARN, f"the page is not served: {failure}") if failure else (OK, "the page is served")
    return Status("page", level, message, {"address": address})


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
