"""Health of the live streams: who is silent, late, lost or mismatched, as plain statuses; no ROS, no mathematics of it.

Silence is judged on a steady clock, because a stopped /clock must not hide a dead sensor. Lag is arrival minus stamp
less the smallest such offset of the window: an unsynchronised clock or an old bag is not lag.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from biodyn_core.clocks import ClockComparison, ClockDrift
from biodyn_core.conditioning import SensorStatus
from biodyn_core.pipeline import Pipeline
from biodyn_core.segments import SEAT

SILENT_AFTER_S: Final = 0.5
OK, WARN, ERROR = range(3)

COUNTS: Final = (
    "accepted", "unset", "non_finite", "duplicate", "late", "stray", "filled", "flat", "clipped", "runs", "gap_s",
    "uncounted_s",
)  # fmt: skip
"""What of a sensor's conditioning stands in the diagnostics beside rate and gravity."""


@dataclass(frozen=True)
class Status:
    """One line of diagnostics: level, message and values by key."""

    name: str
    level: int
    message: str
    values: dict[str, str]


@dataclass
class SensorHealth:
    """What the transport tells of one sensor; the callbacks note, `statuses` reads."""

    arrived_s: float | None = None
    messages: int = 0
    lost: int = 0
    errors: int = 0
    last_error: str = ""
    incompatible_qos: str = ""
    wrong_type: str = ""
    publishers: int = 0
    lag_s: float = 0.0
    clock: ClockComparison = field(default_factory=ClockComparison)
    drift: ClockDrift | None = None
    _offsets_s: deque[tuple[float, float]] = field(default_factory=deque)

    def arrived(self, count: int = 1) -> None:
        """Note that messages came just now."""
        self.arrived_s = time.monotonic()
        self.messages += count

    def offset(self, arrival_minus_stamp_s: float, window_s: float) -> None:
        """Note how far a message's arrival lies behind its stamp."""
        now = time.monotonic()
        while self._offsets_s and self._offsets_s[0][0] < now - window_s:
            self._offsets_s.popleft()
        # Ascending from the left: what a later, smaller offset makes useless is dropped.
        while self._offsets_s and self._offsets_s[-1][1] >= arrival_minus_stamp_s:
            self._offsets_s.pop()
        self._offsets_s.append((now, arrival_minus_stamp_s))
        self.lag_s = arrival_minus_stamp_s - self._offsets_s[0][1]

    def compare_clock(self) -> None:
        """Look anew at how the sensor's stamps run against arrivals; costs a millisecond or two."""
        self.drift = self.clock.result()

    @property
    def silent_s(self) -> float | None:
        """Seconds since the last message, None before the first."""
        return None if self.arrived_s is None else time.monotonic() - self.arrived_s


def sensor_status(name: str, health: SensorHealth, seen: SensorStatus) -> Status:
    """Judge one sensor."""
    silent = health.silent_s
    checks: list[tuple[bool, int, Callable[[], str]]] = [
        (bool(health.wrong_type), ERROR, lambda: health.wrong_type),
        (bool(health.incompatible_qos), ERROR, lambda: health.incompatible_qos),
        (seen.fault is not None, ERROR, lambda: seen.fault or ""),
        (silent is None, ERROR if name == SEAT else WARN, lambda: "no message yet"),
        ((silent or 0.0) > SILENT_AFTER_S, ERROR if name == SEAT else WARN, lambda: f"silent for {silent:.1f} s"),
        (seen.rate_hz is None, WARN, lambda: "waiting for rest: gravity and rate are not known yet"),
        (seen.clipped > 0, WARN, lambda: f"{seen.clipped} samples clipped: doses and peaks are lower bounds"),
        (health.lost > 0, WARN, lambda: f"{health.lost} messages lost in transport"),
        (health.errors > 0, WARN, lambda: f"{health.errors} messages refused: {health.last_error}"),
        (bool(seen.warnings), WARN, lambda: seen.warnings[0] if seen.warnings else ""),
    ]
    level, message = next(((level, text()) for wrong, level, text in checks if wrong), (OK, "streaming"))
    values = {
        "rate_hz": _number(seen.rate_hz, ".3f"),
        "jitter_ms": _number(seen.jitter_s and 1e3 * seen.jitter_s, ".3f"),
        "gravity_mps2": _number(seen.gravity_mps2, ".3f"),
        "vertical": " ".join(f"{v:.4f}" for v in seen.vertical) if seen.vertical else "",
        "filter_delay_ms": _number(seen.filter_delay_s and 1e3 * seen.filter_delay_s, ".3f"),
        "silent_s": _number(silent, ".2f"),
        "lag_ms": _number(1e3 * health.lag_s, ".2f"),
        "clock_ppm": _number(health.drift and health.drift.ppm, ".1f"),
        "clock_offset_ms": _number(health.drift and 1e3 * health.drift.offset_s, ".3f"),
        "messages": str(health.messages),
        "lost": str(health.lost),
        "refused": str(health.errors),
        "publishers": str(health.publishers),
    }
    return Status(f"biodyn: {name}", level, message, values | {key: f"{getattr(seen, key):g}" for key in COUNTS})


def prediction_status(pipeline: Pipeline, seat: SensorHealth, mark: str) -> Status:
    """Judge the model: it predicts while the seat lives."""
    seen = pipeline.status(SEAT)
    silent = seat.silent_s
    if seen.fault or seat.wrong_type or silent is None or silent > SILENT_AFTER_S:
        cause = (
            seen.fault or seat.wrong_type or ("has sent nothing" if silent is None else f"is silent for {silent:.1f} s")
        )
        level, message = ERROR, f"predictions stopped: seat {cause}"
    elif seen.rate_hz is None:
        level, message = WARN, "waiting for the seat at rest"
    elif pipeline.divergences:
        level, message = (
            ERROR,
            f"the model left the finite numbers {pipeline.divergences} times and was put back to rest",
        )
    else:
        level, message = OK, "predicting"
    subject = pipeline.subject
    values = {
        "subject": subject.name,
        "mass_matrix": subject.mass_matrix,
        "substeps": str(pipeline.substeps or ""),
        "divergences": str(pipeline.divergences),
        "last_mark": mark,
    }
    for output, latency in pipeline.latency().items():
        values[f"{output}_latency_ms"] = " + ".join(f"{1e3 * part:.3f}" for part in latency)
    return Status("biodyn: prediction", level, message, values)


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
