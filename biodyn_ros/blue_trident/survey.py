"""First pass over the exports: number of samples, rate and saturation of every sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.conditioning.dual_range import Span, saturated, spans
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings
from biodyn_ros.blue_trident.cleaning import Cleaner
from biodyn_ros.blue_trident.reader import ExportReader
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export, Samples

GAP_PERIODS: Final = 1.5
NEAR_RAIL: Final = 0.9
REPEATED: Final = 4
"""A largest value that repeats so often, slightly below the limit, is a lower saturation limit."""


@dataclass(eq=False)
class SensorSurvey:
    """Survey of one sensor's cleaned low-g channel; last_ns: the last stamp that increases."""

    cleaner: Cleaner = field(default_factory=Cleaner)
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    gaps: int = 0
    back: int = 0
    gyro: bool = False
    top_mps2: Floats = field(default_factory=lambda: np.zeros((2, 3)))
    tops: Integers = field(default_factory=lambda: np.zeros((2, 3), dtype=np.int64))
    _previous_ns: int = 0
    _step_ns: float = 0.0
    _even_ns: int = 0
    _even: int = 0
    _hits: list[tuple[Any, Any, Any]] = field(default_factory=list)

    def push(self, samples: Samples, settings: DualRangeSettings) -> None:
        """Add cleaned samples."""
        if not len(samples.stamps_ns):
            return
        if not self.count:
            self.first_ns = self.last_ns = self._previous_ns = int(samples.stamps_ns[0])
        self.gyro = samples.gyro_radps is not None
        steps_ns = np.diff(samples.stamps_ns, prepend=self._previous_ns)
        self._add_steps(steps_ns[0 if self.count else 1 :])
        sides = saturated(samples.accel_mps2, settings)
        hit = sides.any(axis=1)
        if hit.any():
            number = self.count + np.flatnonzero(hit)
            self._hits.append((number, 1e-9 * (samples.stamps_ns[hit] - self.first_ns), sides[hit]))
        for row, values in enumerate((samples.accel_mps2, -samples.accel_mps2)):
            top = values.max(axis=0)
            self.tops[row] = np.where(top > self.top_mps2[row], 0, self.tops[row])
            self.top_mps2[row] = np.maximum(self.top_mps2[row], top)
            self.tops[row] += (values == self.top_mps2[row]).sum(axis=0)
        self.count += len(samples.stamps_ns)
        self._previous_ns = int(samples.stamps_ns[-1])
        # A last stamp that is cut short would end the recording before its start.
        if (steps_ns > 0).any():
            self.last_ns = int(samples.stamps_ns[steps_ns > 0][-1])

    def spans(self) -> list[Span]:
        """Time spans of saturation, in seconds since the first sample."""
        return spans(*(np.concatenate(part) for part in zip(*self._hits, strict=True))) if self._hits else []

    def clipped(self) -> int:
        """Number of samples with any axis saturated."""
        return sum(len(number) for number, _, _ in self._hits)

    @property
    def seconds(self) -> float:
        """From the first sample to the last."""
        return 1e-9 * (self.last_ns - self.first_ns)

    def rate_hz(self) -> float | None:
        """Samples per second outside of gaps."""
        return 1e9 * self._even / self._even_ns if self._even_ns else None

    def lower_rail_mps2(self, settings: DualRangeSettings) -> float | None:
        """A repeated largest value below the limit, which indicates a lower range; None if there is none."""
        low = (self.tops >= REPEATED) & (self.top_mps2 < settings.saturation_mps2)
        low &= self.top_mps2 > NEAR_RAIL * settings.saturation_mps2
        return float(self.top_mps2[low].min()) if low.any() else None

    def _add_steps(self, steps_ns: Integers) -> None:
        """Sum up steps without gaps, in whole nanoseconds, so that the sum does not depend on the blocks."""
        ahead = steps_ns[steps_ns > 0]
        self.back += int((steps_ns <= 0).sum())
        if not ahead.size:
            return
        self._step_ns = self._step_ns or float(np.median(ahead[:10_000]))
        even = ahead < GAP_PERIODS * self._step_ns
        self.gaps += int((~even).sum())
        self._even_ns, self._even = self._even_ns + int(ahead[even].sum()), self._even + int(even.sum())


@dataclass(eq=False)
class SurveyResult:
    """The result of a survey: sensors by serial, damage by file."""

    sensors: dict[str, SensorSurvey]
    damage: dict[Export, Damage]


def survey(reader: ExportReader, settings: DualRangeSettings) -> SurveyResult:
    """Read every low-g channel once."""
    sensors = {serial: SensorSurvey() for serial in reader.chosen.sensors}
    damage: dict[Export, Damage] = {}
    for block in reader.cleaned({serial: sensor.cleaner for serial, sensor in sensors.items()}, damage):
        for serial, samples in block:
            sensors[serial].push(samples, settings)
    return SurveyResult(sensors, damage)
