"""What is noted of one Imu topic of a bag: stamps, clock, gaps, gravity, in flat memory."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from biodyn_core.conditioning.clocks import ClockComparison, ClockDrift
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import Gravity
from biodyn_ros.bag import LoggedImu
from biodyn_ros.base.wording import stuck
from biodyn_ros.reading.stamps import SensorClock, TimeChoice

CAUSES: Final = ("unset", "non_finite", "duplicate", "late", "stray")
UNEVEN_S: Final = 0.005
"""Stamps that are off an even clock by more than this and by more than half a period, on average, follow none."""

_MOST_STEPS: Final = 1 << 14


class Survey:
    """What is noted of one Imu topic; of a mapped one also whether replay's conditioning would begin."""

    def __init__(
        self,
        sensor: str | None,
        topic: str,
        choice: TimeChoice,
        settings: ConditioningSettings | None,
        gravity: Gravity | None,
    ) -> None:
        self.sensor, self.name, self.choice = sensor, sensor or topic, choice
        self._survey = Conditioner(self.name, settings, "survey", gravity=gravity)
        self._replayed = Conditioner(sensor, settings, "rest", gravity=gravity) if sensor else None
        self._clocks = ClockComparison()
        self._steps = _Steps()
        self._messages = 0

    def push(self, block: LoggedImu) -> None:
        """Take the topic's next messages."""
        self._survey.push(block.stamps_ns, block.accel_mps2)
        if self._replayed:
            self._replayed.push(block.stamps_ns, block.accel_mps2)
        self._clocks.push(block.header_ns, block.log_ns)
        self._steps.push(block.stamps_ns)
        self._messages += len(block)

    def finish(self) -> None:
        """The topic has no more messages."""
        self._survey.finish()
        if self._replayed:
            self._replayed.finish()

    @property
    def replayed(self) -> SensorStatus | None:
        """What replay's conditioning begins with, or why it does not; None for a topic that it does not take."""
        return self._replayed.status() if self._replayed else None

    def clock(self) -> SensorClock:
        """Whose time its samples have, and what the header's gains on the recorder's."""
        return SensorClock(self.choice, self._clocks.result())

    def row(self, topic: str) -> dict[str, Any]:
        """One row of the document."""
        status, drift = self._survey.status(), self._clocks.result()
        if drift is not None and drift.copied:
            drift = None
        step_s = self._steps.median_s()
        return {
            "topic": topic,
            "sensor": self.sensor,
            "messages": self._messages,
            "time": self.choice.time,
            "rate_hz": status.rate_hz or (1.0 / step_s if step_s else None),
            **_clock_columns(drift),
            "jitter_ms": _ms(status.jitter_s),
            "median_step_ms": _ms(step_s),
            "longest_step_ms": _ms(self._steps.longest_s()),
            "gaps": max(status.runs - 1, 0),
            "gap_s": status.gap_s,
            "filled": status.filled,
            "rejected": status.rejected,
            "rejected_by_cause": {cause: getattr(status, cause) for cause in CAUSES},
            "flat": status.flat,
            "clipped": status.clipped,
            "gravity_mps2": status.gravity_mps2,
            "vertical": list(status.vertical) if status.vertical else None,
        }

    def warnings(self) -> list[str]:
        """What the survey has to say, a line each; a fault already begins with the name."""
        status = self._survey.status()
        lines = [status.fault] if status.fault else []
        if status.waiting and not status.fault:
            lines.append(f"{self.name}: {status.waiting}")
        # The first seconds tell it about one line, later ones about a clock that follows such stamps.
        off_s = max(status.jitter_s or 0.0, self._survey.rest.jitter_s if self._survey.rest else 0.0)
        if status.rate_hz and off_s > max(0.5 / status.rate_hz, UNEVEN_S):
            lines.append(
                f"{self.name}: stamps are {1e3 * off_s:.0f} ms off an even clock on average: sampling is"
                " uneven, or the driver stamps late"
            )
        told = [*status.warnings, *([stuck(status.flat)] if status.flat else [])]
        return lines + [f"{self.name}: {text}" for text in told]


class _Steps:
    """Steps from stamp to stamp: the longest of all, and the median of a sample that does not grow without end."""

    def __init__(self) -> None:
        self._last = np.empty(0, dtype=np.int64)
        self._longest_ns = 0
        self._kept: list[np.ndarray[Any, np.dtype[np.int64]]] = []
        self._kept_count, self._every, self._seen = 0, 1, 0

    def push(self, stamps_ns: np.ndarray[Any, np.dtype[np.int64]]) -> None:
        stamps_ns = stamps_ns[stamps_ns != 0]
        steps_ns = np.diff(np.concatenate([self._last, stamps_ns]))
        if stamps_ns.size:
            self._last = stamps_ns[-1:]
        if not steps_ns.size:
            return
        self._longest_ns = max(self._longest_ns, int(steps_ns.max()))
        kept = steps_ns[-self._seen % self._every :: self._every]
        self._kept.append(kept)
        self._kept_count += kept.size
        self._seen += steps_ns.size
        if self._kept_count > _MOST_STEPS:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._kept_count, self._every = self._kept[0].size, 2 * self._every

    def median_s(self) -> float | None:
        return 1e-9 * float(np.median(np.concatenate(self._kept))) if self._kept else None

    def longest_s(self) -> float | None:
        return 1e-9 * self._longest_ns if self._kept else None


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds


def _clock_columns(drift: ClockDrift | None) -> dict[str, float | None]:
    """The header's clock against the recorder's; all None where nothing is known of it."""
    return {
        "clock_ppm": drift.ppm if drift else None,
        "clock_ppm_error": drift.ppm_error if drift else None,
        "offset_ms": _ms(drift.offset_s) if drift else None,
        "offset_scatter_ms": _ms(drift.scatter_s) if drift else None,
        "quantum_ms": _ms(drift.quantum_s) if drift else None,
    }
