"""Shocks: jolts of the seat, with the peaks of every sensor and predicted segment; live, from frames."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import N_SEGMENTS, N_SENSORS, SEAT, SENSORS
from biodyn_core.pipeline.frames import MeasuredFrames, PredictedFrames

SEPARATION_NS: Final = 500_000_000
"""Two peaks within this time are one shock: two periods of the body's lowest mode."""

MAX_SHOCKS: Final = 5


@dataclass(frozen=True)
class Shock:
    """One shock: the time of the seat's peak, and the largest |vertical acceleration| of every channel.

    measured_mps2 (6,) by sensor and predicted_mps2 (6,) by segment; NaN for a channel without a value.
    """

    peak_ns: int
    begin_ns: int
    last_ns: int
    measured_mps2: Floats
    predicted_mps2: Floats

    @property
    def seat_mps2(self) -> float:
        """The largest |acceleration| of the seat."""
        return float(self.measured_mps2[SENSORS.index(SEAT)])


class _Rows(NamedTuple):
    """Stamps (n,), and |vertical acceleration| by sensor and by segment, (n, 6) each."""

    stamps_ns: Integers
    measured_mps2: Floats
    predicted_mps2: Floats

    def part(self, begin: int, end: int) -> _Rows:
        part = slice(begin, end)
        return _Rows(self.stamps_ns[part], self.measured_mps2[part], self.predicted_mps2[part])


class Shocks:
    """`push` frames in the pipeline's order; `latest` are the last five shocks, the newest first.

    A shock begins where the seat's low-passed vertical reaches `threshold_mps2` and ends SEPARATION_NS after it last
    does, so that it contains the body's response. Block cuts change nothing.
    """

    def __init__(self, threshold_mps2: float) -> None:
        self._threshold_mps2 = threshold_mps2
        self._waiting: deque[Floats] = deque()
        self._done: deque[Shock] = deque(maxlen=MAX_SHOCKS)
        self._open: Shock | None = None

    def push(self, predicted: PredictedFrames, measured: MeasuredFrames) -> None:
        """Add the frames of one push of the pipeline, or of several."""
        if predicted.stamps_ns.size:
            self._waiting.append(predicted.accel_mps2)
        if not measured.stamps_ns.size:
            return
        rows = _Rows(measured.stamps_ns, np.abs(measured.accel_mps2), np.abs(self._predicted(measured.stamps_ns.size)))
        hit = rows.measured_mps2[:, SENSORS.index(SEAT)] >= self._threshold_mps2
        at = 0
        while at < hit.size:
            at = self._extend(at, rows, hit) if self._open else self._begin(at, rows, hit)

    def latest(self) -> list[Shock]:
        """The last shocks, the newest first, with one that still lasts."""
        return [*([self._open] if self._open else []), *reversed(self._done)][:MAX_SHOCKS]

    def _predicted(self, count: int) -> Floats:
        """The predictions of the next instants: every predicted instant is released once, in the same order."""
        parts: list[Floats] = []
        while count > 0:
            accel = self._waiting.popleft()
            parts.append(accel[:count])
            if len(accel) > count:
                self._waiting.appendleft(accel[count:])
            count -= len(accel)
        return np.concatenate(parts)

    def _begin(self, at: int, rows: _Rows, hit: Flags) -> int:
        """Open a shock at the next hit; return its row, or the end."""
        found = np.flatnonzero(hit[at:])
        if not found.size:
            return hit.size
        first = at + int(found[0])
        begin_ns = int(rows.stamps_ns[first])
        self._open = Shock(begin_ns, begin_ns, begin_ns, np.full(N_SENSORS, np.nan), np.full(N_SEGMENTS, np.nan))
        return first

    def _extend(self, at: int, rows: _Rows, hit: Flags) -> int:
        """Extend the open shock as far as it lasts; return the first row after it, or the end."""
        shock = self._open
        assert shock is not None
        stamps_ns = rows.stamps_ns[at:]
        last_ns = np.maximum.accumulate(np.concatenate([[shock.last_ns], np.where(hit[at:], stamps_ns, 0)]))
        after = (stamps_ns > last_ns[:-1] + SEPARATION_NS) | (stamps_ns < shock.begin_ns)  # stamps may leap back
        length = int(after.argmax()) if after.any() else stamps_ns.size
        self._open = replace(_with_rows(shock, rows.part(at, at + length)), last_ns=int(last_ns[length]))
        if length < stamps_ns.size:
            self._done.append(self._open)
            self._open = None
        return at + length


def _with_rows(shock: Shock, rows: _Rows) -> Shock:
    """The shock with further rows."""
    if not rows.stamps_ns.size:
        return shock
    seat = rows.measured_mps2[:, SENSORS.index(SEAT)]
    row = int(seat.argmax())
    return replace(
        shock,
        peak_ns=shock.peak_ns if seat[row] <= shock.seat_mps2 else int(rows.stamps_ns[row]),
        measured_mps2=np.fmax(shock.measured_mps2, np.fmax.reduce(rows.measured_mps2)),
        predicted_mps2=np.fmax(shock.predicted_mps2, np.fmax.reduce(rows.predicted_mps2)),
    )
