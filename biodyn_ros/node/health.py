"""Health of the live streams: silent, late, lost or mismatched sensors as plain statuses, without ROS.

A status is about the present: a count that no longer grows stays among the values and raises no warning.

Silence is measured on a steady clock, because a stopped /clock must not hide a dead sensor. Lag is arrival minus stamp
less the smallest such offset of the window: an unsynchronised clock or an old bag is not lag.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.base.wording import counted
from biodyn_core.body.origin import origin_of
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.clocks import ClockComparison, ClockDrift
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.pipeline.fit_monitor import Misfit
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.run_status import RunStatus
from biodyn_ros.base.wording import (
    DOES_NOT_FIT,
    FITS_AGAIN,
    MODEL,
    ORIGIN,
    REJECTED,
    left_range,
    listed,
    misfit_line,
    rejected,
    words,
)
from biodyn_ros.node.exposure_store import ExposureStore

SILENT_AFTER_S: Final = 0.5
UNUSABLE_AFTER_S: Final = 0.5
"""A sensor whose messages arrive is at fault after so long without a sample that can be used."""

MAX_CLOCK_OFFSET_S: Final = 0.02
"""Beyond this offset from the seat's stamps, by arrival, a residual has no meaning from 12 Hz on."""

SETTLING_S: Final = 1.4
"""2.5 time constants of the slowest filter, Wk's high-pass: 8 % of a step at the begin of a run remain."""

CLOCK_OFFSET_CAUSE: Final = "by clock or transport: its residual contains that"

RECENT_CHECKS: Final = 2
"""A count grows if it has grown within the last so many checks."""

MARKS_SHOWN: Final = 5
"""The newest marks that the page shows; every mark is published when it is set."""

OK, WARN, ERROR = range(3)

CAUSES: Final = {
    **REJECTED,
    "flat": ("sample of a reading that never changes", "samples of a reading that never changes"),
    "dead": ("sample with one axis that never changes", "samples with one axis that never changes"),
    "clipped": ("sample clipped", "samples clipped"),
    "filled": ("sample lost and interpolated", "samples lost and interpolated"),
    "lost": ("message lost in transport", "messages lost in transport"),
    "errors": ("message refused", "messages refused"),
}
"""Text for one and for several faulty samples or messages, by the name of their count."""

COUNTS: Final = (
    "accepted", "unset", "non_finite", "duplicate", "late", "stray", "filled", "flat", "dead", "clipped", "runs",
    "gap_s", "set_back_s", "uncounted_s",
)  # fmt: skip
"""Fields of `SensorStatus` in the diagnostics, in addition to rate and gravity."""


@dataclass(frozen=True)
class Mark:
    """An instant marked by a user: a numbered name, and the time by the node's clock."""

    name: str
    at_s: float

    def __str__(self) -> str:
        return f"{self.name} at {self.at_s:.3f} s"


@dataclass(frozen=True)
class Status:
    """Status of a sensor, or of `prediction`, `exposure`, `sending` or `page`: level, message and values by key."""

    of: str
    level: int
    message: str
    values: dict[str, str]


class CounterDelta:
    """Growth of counts over the last checks."""

    def __init__(self) -> None:
        self._before: deque[dict[str, int]] = deque(maxlen=RECENT_CHECKS)
        self.by: dict[str, int] = {}

    def update(self, counts: dict[str, int]) -> None:
        """Compare the present counts with earlier ones."""
        since = self._before[0] if self._before else {}
        self.by = {key: grown for key, count in counts.items() if (grown := count - since.get(key, 0)) > 0}
        self._before.append(counts)


@dataclass
class SensorHealth:
    """State of one sensor's transport; the callbacks write it, `HealthMonitor` reads it."""

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
    unusable_s: float = 0.0
    unusable: str = ""
    _accepted: int = 0
    _accepted_s: float | None = None
    _at_accepted: dict[str, int] = field(default_factory=dict)
    _numbers_from: int | None = None
    _offsets_s: deque[tuple[float, float]] = field(default_factory=deque)
    _stamp_ns: int | None = None

    def arrived(self, count: int = 1) -> None:
        """Note that messages came just now."""
        self.arrived_s = self.now()
        self.messages += count

    def numbered(self, number: int, received: int) -> None:
        """Count losses by a single publisher's sequence number of a message, against the count received."""
        ahead = number - received
        if self._numbers_from is not None and ahead > self._numbers_from:
            self.lost += ahead - self._numbers_from
        self._numbers_from = ahead

    def forget_numbers(self) -> None:
        """Start again, for another publisher, which has its own sequence numbers, or for another subscription."""
        self._numbers_from = None

    def refused(self, why: str) -> None:
        """Note that a message could not be used."""
        self.errors += 1
        self.last_error = why

    def timed(self, stamp_ns: int, arrival_ns: int, window_s: float) -> None:
        """Note when a message arrived, by the clock of the stamps; lag is relative to the least offset of a window."""
        self.clock.push(np.array([stamp_ns]), np.array([arrival_ns]))
        arrival_minus_stamp_s = 1e-9 * (arrival_ns - stamp_ns)
        now = self.now()
        if self._stamp_ns is not None and stamp_ns < self._stamp_ns - 1_000_000_000:
            self._offsets_s.clear()  # stamps have jumped back, as those of a looped bag: that is no lag
        self._stamp_ns = stamp_ns
        while self._offsets_s and self._offsets_s[0][0] < now - window_s:
            self._offsets_s.popleft()
        # Ascending from the left: a later, smaller offset replaces the larger ones before it.
        while self._offsets_s and self._offsets_s[-1][1] >= arrival_minus_stamp_s:
            self._offsets_s.pop()
        self._offsets_s.append((now, arrival_minus_stamp_s))
        self.lag_s = arrival_minus_stamp_s - self._offsets_s[0][1]

    def update(self, status: SensorStatus) -> None:
        """Update the growth of all fault counts."""
        own = {"lost": self.lost, "errors": self.errors, "gaps": max(0, status.runs - 1)}
        counts = {key: own[key] if key in own else getattr(status, key) for key in (*CAUSES, "gaps")}
        self.growth.update(counts)
        self._update_unusable(status, counts)

    def _update_unusable(self, status: SensorStatus, counts: dict[str, int]) -> None:
        """Update how long messages have arrived without an accepted sample, and why.

        The rest at the start is another matter, and a return from silence is no fault: nothing is rejected then.
        """
        if status.rate_hz is None or status.accepted != self._accepted or self._accepted_s is None:
            self._accepted, self._accepted_s, self._at_accepted = status.accepted, self.arrived_s, counts
        grown = {key: counts[key] - self._at_accepted[key] for key in (*REJECTED, "errors")}
        causes = [rejected(grown), ""]
        if grown["errors"]:
            causes[1] = f"{counted(grown['errors'], *CAUSES['errors'])}: {self.last_error}"
        self.unusable = "; ".join(filter(None, causes))
        self.unusable_s = (self.arrived_s or 0.0) - (self._accepted_s or 0.0) if self.unusable else 0.0

    @property
    def unusable_line(self) -> str:
        """That no sample could be used for some time, with the causes; empty while samples can be used."""
        is_short = self.unusable_s <= UNUSABLE_AFTER_S
        return "" if is_short else f"no usable sample for {self.unusable_s:.1f} s: {self.unusable}"

    @property
    def causes(self) -> str:
        """The faults that grow now, with their counts; empty without any."""
        lines = [counted(n, *CAUSES[key]) for key, n in self.growth.by.items() if key in CAUSES]
        if "errors" in self.growth.by:
            lines.append(self.last_error)
        return "; ".join(lines)

    def compare_clock(self) -> None:
        """Compare the sensor's stamps with arrivals; takes a millisecond or two."""
        self.drift = self.clock.since_leap()

    @property
    def offset_s(self) -> float | None:
        """Least delay of arrivals behind stamps, as of now; None while it is unknown."""
        drift = self.drift
        return None if drift is None else drift.offset_s - 1e-6 * (drift.ppm or 0.0) * drift.seconds

    @property
    def silent_s(self) -> float | None:
        """Seconds since the last message, None before the first."""
        return None if self.arrived_s is None else self.now() - self.arrived_s


def is_settling(status: SensorStatus) -> bool:
    """Whether filters still respond to the begin of the run; a run that begins at rest begins in steady state."""
    rested = status.runs == 1 and status.uncounted_s > 0.0
    return status.run_s is not None and not rested and status.run_s < SETTLING_S


class HealthMonitor:
    """Check model and sensors a few times a second.

    health: by sensor, written by the receiver of its messages. marks: the latest, the newest first.
    """

    def __init__(self, pipeline: Pipeline, health: Mapping[str, SensorHealth]) -> None:
        self._pipeline, self._health = pipeline, health
        self._divergences = CounterDelta()
        self._marks = 0
        self._unfitted: set[str] = set()
        self.marks: deque[Mark] = deque(maxlen=MARKS_SHOWN)

    def mark(self, at_s: float) -> Mark:
        """Add a mark."""
        self._marks += 1
        mark = Mark(f"mark {self._marks}", at_s)
        self.marks.appendleft(mark)
        return mark

    def misfit_marks(self) -> list[Mark]:
        """A mark for each segment that the model does not fit any more, or fits again, since the last call.

        They are not among `marks`, which are the user's.
        """
        monitor = self._pipeline.fit_monitor
        lasting = {one.segment: one.begin_ns for one in monitor.lasting()}
        ends = {one.segment: one.end_ns for one in monitor.misfits() if one.end_ns is not None}
        marks = [(name, DOES_NOT_FIT, at_ns) for name, at_ns in lasting.items() if name not in self._unfitted]
        marks += [(name, FITS_AGAIN, ends[name]) for name in self._unfitted if name not in lasting]
        self._unfitted = set(lasting)
        return [Mark(f"{words(name)}: {what}", 1e-9 * at_ns) for name, what, at_ns in marks]

    def check(self, compare_clocks: bool = True) -> list[Status]:
        """The status of the prediction, and of every sensor.

        compare_clocks: by arrivals; a simulated clock moves in steps, too coarse for that.
        """
        run = self._pipeline.run_status()
        self._divergences.update({"divergences": run.divergences})
        for sensor, health in self._health.items():
            health.update(self._pipeline.status(sensor))
        last_mark = str(self.marks[0]) if self.marks else ""
        prediction = prediction_status(self._pipeline, run, self._health[SEAT], self._divergences, last_mark)
        ahead_s = {sensor: self._ahead_of_seat_s(sensor) if compare_clocks else None for sensor in self._health}
        return [
            prediction,
            *(sensor_status(name, one, self._pipeline, ahead_s[name]) for name, one in self._health.items()),
        ]

    def _ahead_of_seat_s(self, sensor: str) -> float | None:
        """How far a sensor's stamps are ahead of the seat's, by their arrivals; None while that is unknown."""
        own_s, seat_s = self._health[sensor].offset_s, self._health[SEAT].offset_s
        return None if own_s is None or seat_s is None else seat_s - own_s


def sensor_status(name: str, health: SensorHealth, pipeline: Pipeline, ahead_s: float | None = None) -> Status:
    """Status of one sensor now; ahead_s: how far its stamps are ahead of the seat's, by their arrivals."""
    seen, losses, silent = pipeline.status(name), pipeline.losses(name), health.silent_s
    offset_s, ahead_ms = pipeline.timelines.offset_s(name), 1e3 * (ahead_s or 0.0)
    checks: list[tuple[bool, int, Callable[[], str]]] = [
        (bool(health.wrong_type), ERROR, lambda: health.wrong_type),
        (bool(health.incompatible_qos), ERROR, lambda: health.incompatible_qos),
        (seen.fault is not None, ERROR, lambda: seen.fault or ""),
        (silent is None, ERROR if name == SEAT else WARN, lambda: "no message yet"),
        ((silent or 0.0) > SILENT_AFTER_S, ERROR if name == SEAT else WARN, lambda: f"silent for {silent:.1f} s"),
        (bool(health.unusable_line), ERROR if name == SEAT else WARN, lambda: health.unusable_line),
        (health.publishers > 1, WARN, lambda: f"{health.publishers} publishers on its topic, one is allowed"),
        (bool(health.causes), WARN, lambda: health.causes),
        (seen.waiting is not None, WARN, lambda: seen.waiting or ""),
        ("gaps" in health.growth.by, WARN, lambda: "a gap: filters restart behind it"),
        (offset_s != 0.0, WARN, lambda: f"its clock was set {offset_s:+.1f} s against the others': it is not compared"),
        (
            abs(ahead_ms) > 1e3 * MAX_CLOCK_OFFSET_S,
            WARN,
            lambda: f"its stamps differ by {ahead_ms:+.0f} ms from the seat's, {CLOCK_OFFSET_CAUSE}",
        ),
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
        "clock_apart_s": f"{offset_s:.3f}",
        "clock_off_ms": _number(ahead_s and 1e3 * ahead_s, ".3f"),
        "missing_s": f"{losses.missing_s:.3f}",
        "suspect_s": f"{losses.suspect_s:.3f}",
        "lower_bound": str(losses.lower_bound or losses.dead_s > 0.0).lower(),
        "settling": str(is_settling(seen)).lower(),
    }
    return Status(name, level, message, values | {key: f"{getattr(seen, key):g}" for key in COUNTS})


def prediction_status(
    pipeline: Pipeline, run: RunStatus, seat: SensorHealth, growth: CounterDelta, mark: str
) -> Status:
    """Status of the model now, which predicts while the seat sends; growth: of its divergences."""
    seen, silent = pipeline.status(SEAT), seat.silent_s
    stopped = seen.fault
    if silent is None or silent > SILENT_AFTER_S:  # while the seat sends, a second, faulty publisher stops nothing
        absence = "has sent nothing" if silent is None else f"is silent for {silent:.1f} s"
        stopped = stopped or seat.wrong_type or seat.incompatible_qos or absence
    stopped = stopped or (f"has {seat.unusable_line}" if seat.unusable_line else None)
    divergences = growth.by.get("divergences", 0)
    lasting, fit_unknown = pipeline.fit_monitor.lasting(), pipeline.fit_unknown
    checks: list[tuple[bool, int, Callable[[], str]]] = [
        (bool(stopped), ERROR, lambda: f"predictions stopped: seat {stopped}"),
        (seen.waiting is not None, WARN, lambda: f"seat: {seen.waiting}"),
        (divergences > 0, ERROR, lambda: f"{MODEL} {left_range(divergences)}"),
        (bool(lasting), WARN, lambda: "; ".join(map(_misfit_text, lasting))),
        (is_settling(seen), OK, lambda: "settling behind a gap of the seat"),
    ]
    level, message = next(((level, text()) for wrong, level, text in checks if wrong), (OK, "predicting"))
    subject = pipeline.subject
    values = {
        "subject": subject.name,
        "mass_matrix": subject.mass_matrix,
        "substeps": str(run.substeps or ""),
        "divergences": str(run.divergences),
        "settling": str(is_settling(seen)).lower(),
        "last_mark": mark,
        "fits": f"unknown: {fit_unknown}" if fit_unknown else str(not lasting).lower(),
        "fit_tested": listed(map(words, pipeline.fit_monitor.tested)),
        "origin": ORIGIN[origin_of(subject)],
        "intervals": f"none: {pipeline.no_interval}" if pipeline.no_interval else _interval_of(subject),
    }
    for output, latency in run.latency.items():
        values[f"{output}_latency_ms"] = " + ".join(f"{1e3 * part:.3f}" for part in latency)
    return Status("prediction", level, message, values)


def _interval_of(subject: Subject) -> str:
    """Whom the intervals describe."""
    return "95 % of people in published groups" if origin_of(subject) == "group" else "95 %"


def _misfit_text(misfit: Misfit) -> str:
    since = time.strftime("since %H:%M:%S", time.localtime(1e-9 * misfit.begin_ns))
    return misfit_line(misfit.segment, since, misfit.ratio)


def seat_fault(statuses: Mapping[str, Status]) -> str:
    """The seat's present fault, which the figures since reset may not show yet; empty without one."""
    seat, prediction = statuses[SEAT], statuses["prediction"]
    if seat.level == ERROR or int(seat.values["publishers"]) > 1:
        return f"seat: {seat.message}"
    return "" if seat.values["rate_hz"] else prediction.message


def silences_s(statuses: Mapping[str, Status]) -> dict[str, float]:
    """The time since the last message of each sensor that has sent one."""
    silent = {name: statuses[name].values["silent_s"] for name in SENSORS if name in statuses}
    return {name: float(silent_s) for name, silent_s in silent.items() if silent_s}


def storage_status(store: ExposureStore) -> Status:
    """Status of the exposure file."""
    level, message = (WARN, store.failure) if store.failure else (OK, "stored across restarts")
    values = {"state_file": str(store.path), "went_on": str(store.resumed).lower()}
    return Status("exposure", level, message, values)


def sending_status(paused: bool, unsent: int) -> Status:
    """Status of the topics of single samples."""
    slow = "single samples are not sent: a subscriber hangs, or the machine is too slow; blocks are sent"
    return Status("sending", WARN if paused else OK, slow if paused else "samples are sent", {"unsent": str(unsent)})


def page_status(address: str, failure: str) -> Status:
    """Status of the live page."""
    level, message = (WARN, f"the page is not served: {failure}") if failure else (OK, "the page is served")
    return Status("page", level, message, {"address": address})


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
