"""Comparison: measurement beside prediction on the seat's grid, their residual, and doses of the low-passed sensors.

Instants wait until every sensor has come, or until they are `wait_s` of stamp time old; what is missing then is NaN.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.alignment import Aligner
from biodyn_core.conditioning import Block
from biodyn_core.exposure import DoseMeter, ResidualMeter
from biodyn_core.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, N_SENSORS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class MeasuredFrames:
    """Conditioned vertical acceleration on the seat's grid: stamps_ns (n,), accel_mps2 (n, 6) by sensor, NaN: none.

    residual_mps2 (n, 5) is predicted minus measured for the five segments that carry a sensor.
    """

    stamps_ns: Integers
    accel_mps2: Floats
    residual_mps2: Floats


NO_MEASURED: Final = MeasuredFrames(np.empty(0, dtype=np.int64), np.empty((0, N_SENSORS)), np.empty((0, N_SENSORS - 1)))


@dataclass(frozen=True)
class _Pending:
    """Instants of the seat that wait for the other sensors."""

    stamps_ns: Integers
    time_s: Floats
    seat_mps2: Floats
    predicted_mps2: Floats

    @classmethod
    def join(cls, parts: list[_Pending]) -> _Pending:
        return (
            parts[0] if len(parts) == 1 else cls(*(np.concatenate([vars(p)[f] for p in parts]) for f in vars(parts[0])))
        )

    def split(self, at: int) -> tuple[_Pending, _Pending]:
        fields = vars(self).values()
        return _Pending(*(f[:at] for f in fields)), _Pending(*(f[at:] for f in fields))


class Comparison:
    """`seat` and `sensor` feed it, `release` hands out every instant that is complete or overdue."""

    def __init__(self, seat_rate_hz: float, wait_s: float, window_s: float) -> None:
        self._wait_s = wait_s
        self._aligners = {name: Aligner(keep_s=2.0 * wait_s) for name in MEASURED_SEGMENTS}
        self._pending: list[_Pending] = []
        self._epoch_ns = 0
        self.residual = ResidualMeter(seat_rate_hz, len(MEASURED_SEGMENTS), window_s)
        self.doses = DoseMeter("Wk", seat_rate_hz, N_SENSORS, window_s)

    def seat(self, block: Block, predicted_mps2: Floats) -> None:
        """Add the seat's instants with what the model predicts there, (n, 6)."""
        self._epoch_ns = block.epoch_ns
        measured_segments = np.ascontiguousarray(predicted_mps2[:, MEASURED_SEGMENT_INDEX])
        self._pending.append(_Pending(block.stamps_ns, block.time_s, block.low_passed_mps2, measured_segments))

    def sensor(self, name: str, blocks: list[Block]) -> None:
        """Add another sensor's samples."""
        self._aligners[name].feed(blocks)

    @property
    def overdue(self) -> bool:
        """Whether instants wait longer than they may."""
        waiting = self._pending
        return bool(waiting) and float(waiting[-1].time_s[-1] - waiting[0].time_s[0]) > 1.1 * self._wait_s

    def release(self, give_up: bool = False) -> MeasuredFrames:
        """Answer what all sensors have reached, or what is overdue; everything where `give_up`."""
        if not self._pending:
            return NO_MEASURED
        grid = _Pending.join(self._pending)
        answers = [aligner.read(grid.time_s, self._epoch_ns) for aligner in self._aligners.values()]
        overdue = int(np.searchsorted(grid.time_s, grid.time_s[-1] - self._wait_s))
        ready = grid.time_s.size if give_up else max(overdue, min(answered for _, answered in answers))
        done, rest = grid.split(ready)
        self._pending = [rest] if rest.time_s.size else []
        if ready == 0:
            return NO_MEASURED
        for aligner in self._aligners.values():
            aligner.forget(float(grid.time_s[ready - 1]), self._epoch_ns)
        accel = np.column_stack([done.seat_mps2, *(values[:ready] for values, _ in answers)])
        segments = np.ascontiguousarray(accel[:, 1:])
        self.doses.push(accel)
        self.residual.push(done.predicted_mps2, segments)
        return MeasuredFrames(done.stamps_ns, accel, done.predicted_mps2 - segments)

    def reset(self) -> None:
        """Start "since reset" anew."""
        self.residual.reset()
        self.doses.reset()
