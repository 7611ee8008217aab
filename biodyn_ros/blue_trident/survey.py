"""A first look through the exports: how much there is of every sensor, how fast, and where it is at its rail."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.conditioning.dual_range import Span, saturated, spans
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings
from biodyn_ros.blue_trident.cleaning import Cleaner
from biodyn_ros.blue_trident.found import Chosen
from biodyn_ros.blue_trident.rows import Damage
from biodyn_ros.blue_trident.samples import Export, Part, Samples

GAP_PERIODS: Final = 1.5
NEAR_RAIL: Final = 0.9
REPEATED: Final = 4
"""A largest reading that returns so often, close below the limit, is a rail that lies lower than is thought."""

OnRead = Callable[[int], None]
"""Hears how many bytes were read."""


@dataclass(eq=False)
class Surveyed:
    """What was seen of one sensor's low-g channel, zeros and the like left out."""

    cleaner: Cleaner = field(default_factory=Cleaner)
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    gaps: int = 0
    back: int = 0
    gyro: bool = False
    top_mps2: Floats = field(default_factory=lambda: np.zeros((2, 3)))
    tops: Integers = field(default_factory=lambda: np.zeros((2, 3), dtype=np.int64))
    _step_ns: float = 0.0
    _even_ns: int = 0
    _even: int = 0
    _hits: list[tuple[Any, Any, Any]] = field(default_factory=list)

    def push(self, samples: Samples, settings: DualRangeSettings) -> None:
        """Take cleaned samples."""
        if not len(samples.stamps_ns):
            return
        if not self.count:
            self.first_ns = self.last_ns = int(samples.stamps_ns[0])
        self.gyro = samples.gyro_radps is not None
        self._look_at_steps(np.diff(samples.stamps_ns, prepend=self.last_ns)[0 if self.count else 1 :])
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
        self.last_ns = int(samples.stamps_ns[-1])

    def spans(self) -> list[Span]:
        """Where it is at its rail, in seconds since its first sample."""
        return spans(*(np.concatenate(part) for part in zip(*self._hits, strict=True))) if self._hits else []

    def clipped(self) -> int:
        """Samples of which any axis is at its rail."""
        return sum(len(number) for number, _, _ in self._hits)

    def rate_hz(self) -> float | None:
        """Samples per second where none is missing."""
        return 1e9 * self._even / self._even_ns if self._even_ns else None

    def lower_rail_mps2(self, settings: DualRangeSettings) -> float | None:
        """A reading below the limit that looks like a rail; None where there is none."""
        low = (self.tops >= REPEATED) & (self.top_mps2 < settings.saturation_mps2)
        low &= self.top_mps2 > NEAR_RAIL * settings.saturation_mps2
        return float(self.top_mps2[low].min()) if low.any() else None

    def _look_at_steps(self, steps_ns: Integers) -> None:
        """Add up the steps between samples of which none is missing, in whole nanoseconds: no cut changes the sum."""
        ahead = steps_ns[steps_ns > 0]
        self.back += int((steps_ns <= 0).sum())
        if not ahead.size:
            return
        self._step_ns = self._step_ns or float(np.median(ahead[:10_000]))
        even = ahead < GAP_PERIODS * self._step_ns
        self.gaps += int((~even).sum())
        self._even_ns, self._even = self._even_ns + int(ahead[even].sum()), self._even + int(even.sum())


@dataclass(eq=False)
class Read:
    """What a survey brought: by serial what was seen, by file what was damaged."""

    sensors: dict[str, Surveyed]
    damage: dict[Export, Damage]


def survey(
    chosen: Chosen, settings: DualRangeSettings, sizes: Mapping[Export, int], start_ns: int, on_read: OnRead
) -> Read:
    """Read every low-g channel once, so many bytes of each file; `on_read` hears the bytes read."""
    sensors = {serial: Surveyed() for serial in chosen.sensors}
    damage: dict[Export, Damage] = {}
    for export in chosen.exports:
        if all(held.channel == "high" for held in export.held):
            continue
        damage[export] = Damage()
        for read, parts in export.parts(damage[export], start_ns, sizes[export]):
            for part in parts:
                if part.channel == "low" and part.serial in sensors:
                    seen = sensors[part.serial]
                    seen.push(seen.cleaner.push(part.samples), settings)
            on_read(read)
    for seen in sensors.values():
        if (last := seen.cleaner.finish()) is not None:
            seen.push(last, settings)
    return Read(sensors, damage)


def in_time_order(
    exports: Sequence[Export], damage: dict[Export, Damage], sizes: Mapping[Export, int], start_ns: int, on_read: OnRead
) -> Iterator[list[Part]]:
    """What several files hold, block by block, always of the one that is furthest behind."""
    reading = {export: export.parts(damage.setdefault(export, Damage()), start_ns, sizes[export]) for export in exports}
    upto = dict.fromkeys(exports, -(2**63))
    while reading:
        export = min(reading, key=lambda one: upto[one])
        block = next(reading[export], None)
        if block is None:
            del reading[export]
            continue
        read, parts = block
        ends = [int(part.samples.stamps_ns[-1]) for part in parts if len(part.samples.stamps_ns)]
        upto[export] = max(ends, default=upto[export])
        on_read(read)
        yield parts
