"""Survey of one Imu topic of a bag: stamps, clock, gaps, gravity, in constant memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.conditioning.clocks import ClockComparison, ClockDrift
from biodyn_core.conditioning.conditioned import SensorStatus
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import Gravity
from biodyn_ros.bag import LoggedImu
from biodyn_ros.base.wording import unchanging
from biodyn_ros.reading.stamps import SensorClock, TimeChoice

CAUSES: Final = ("unset", "non_finite", "duplicate", "late", "stray")
UNEVEN_S: Final = 0.005
"""Stamps whose mean deviation from an even clock exceeds this and half a period are uneven."""

_MAX_STEPS: Final = 1 << 14


@dataclass(frozen=True)
class SurveyedTopic:
    """Result of a survey; sensor: None for a topic that is not mapped; steps: between stamps, None below two."""

    topic: str
    sensor: str | None
    messages: int
    clock: SensorClock
    status: SensorStatus
    median_step_s: float | None
    longest_step_s: float | None

    @property
    def time(self) -> str:
        """The time of its samples, "header" or "log"."""
        return self.clock.choice.time

    @property
    def drift(self) -> ClockDrift | None:
        """The drift of header stamps against log time; None if unknown."""
        return None if self.clock.drift is None or self.clock.drift.copied else self.clock.drift

    @property
    def rate_hz(self) -> float | None:
        """The tracked rate, or that of the median step."""
        return self.status.rate_hz or (1.0 / self.median_step_s if self.median_step_s else None)

    @property
    def gaps(self) -> int:
        """The number of gaps between runs."""
        return max(self.status.runs - 1, 0)

    @property
    def rejected_by_cause(self) -> dict[str, int]:
        """The number of rejected samples by cause."""
        return {cause: getattr(self.status, cause) for cause in CAUSES}


class Survey:
    """Survey of one Imu topic; for a mapped topic also whether replay's conditioning would start."""

    def __init__(
        self,
        sensor: str | None,
        topic: str,
        choice: TimeChoice,
        settings: ConditioningSettings | None,
        gravity: Gravity | None,
    ) -> None:
        self.topic, self.sensor, self.name, self.choice = topic, sensor, sensor or topic, choice
        self._survey = Conditioner(self.name, settings, "survey", gravity=gravity)
        self._replayed = Conditioner(sensor, settings, "rest", gravity=gravity) if sensor else None
        self._clocks = ClockComparison()
        self._steps = _Steps()
        self._messages = 0

    def push(self, block: LoggedImu) -> None:
        """Add the topic's next messages."""
        self._survey.push(block.stamps_ns, block.accel_mps2)
        if self._replayed:
            self._replayed.push(block.stamps_ns, block.accel_mps2)
        self._clocks.push(block.header_ns, block.log_ns)
        self._steps.push(block.stamps_ns)
        self._messages += len(block)

    def finish(self) -> None:
        """End the survey after the last message."""
        self._survey.finish()
        if self._replayed:
            self._replayed.finish()

    @property
    def replayed(self) -> SensorStatus | None:
        """The status of replay's conditioning; None for a topic that replay does not use."""
        return self._replayed.status() if self._replayed else None

    def clock(self) -> SensorClock:
        """The time of its samples, and the drift of header stamps against log time."""
        return SensorClock(self.choice, self._clocks.result())

    def result(self) -> SurveyedTopic:
        """What was found, for the report."""
        return SurveyedTopic(
            topic=self.topic,
            sensor=self.sensor,
            messages=self._messages,
            clock=self.clock(),
            status=self._survey.status(),
            median_step_s=self._steps.median_s(),
            longest_step_s=self._steps.longest_s(),
        )

    def warnings(self) -> list[str]:
        """The warnings, a line each; a fault already starts with the name."""
        status = self._survey.status()
        lines = [status.fault] if status.fault else []
        if status.waiting and not status.fault:
            lines.append(f"{self.name}: {status.waiting}")
        # The first seconds are compared with a straight line, later ones with a clock that follows the stamps.
        off_s = max(status.jitter_s or 0.0, self._survey.rest.jitter_s if self._survey.rest else 0.0)
        if status.rate_hz and off_s > max(0.5 / status.rate_hz, UNEVEN_S):
            lines.append(
                f"{self.name}: stamps differ from an even clock by {1e3 * off_s:.0f} ms on average: sampling is"
                " uneven, or the driver sets stamps late"
            )
        texts = [*status.warnings, *unchanging(status.flat, status.dead)]
        return lines + [f"{self.name}: {text}" for text in texts]


class _Steps:
    """Steps between stamps: the longest, and the median of a sample of bounded size."""

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
        if self._kept_count > _MAX_STEPS:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._kept_count, self._every = self._kept[0].size, 2 * self._every

    def median_s(self) -> float | None:
        return 1e-9 * float(np.median(np.concatenate(self._kept))) if self._kept else None

    def longest_s(self) -> float | None:
        return 1e-9 * self._longest_ns if self._kept else None
