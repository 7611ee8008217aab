"""Conditioned: results of conditioning: blocks of samples, and the status of a sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.conditioning.tilt import Vector


class Block(NamedTuple):
    """Conditioned samples of one sensor, evenly spaced within one run.

    stamps_ns (n,) and time_s (n,) are the instants without the filter delay (time_s since epoch_ns, the sensor's first
    stamp, for alignment); levelled_mps2 (n, 3), gravity-free, third axis up, before the low-pass; low_passed_mps2 (n,),
    vertical, up to cutoff_hz. gap_s: gap before the first sample of a run. lost (n,): of each interpolated sample,
    the number of samples that were lost with it, 0 for measured ones; None without any.
    """

    stamps_ns: Integers
    time_s: Floats
    levelled_mps2: Floats
    low_passed_mps2: Floats
    begins_run: bool
    gap_s: float
    epoch_ns: int
    rate_hz: float
    cutoff_hz: float
    lost: Integers | None = None

    @property
    def losses(self) -> Integers:
        """`lost` (n,), zeros without any."""
        return np.zeros(len(self.levelled_mps2), dtype=np.int64) if self.lost is None else self.lost

    def part(self, begin: int, end: int) -> Block:
        """The samples from `begin` up to `end`."""
        return self._replace(
            stamps_ns=self.stamps_ns[begin:end],
            time_s=self.time_s[begin:end],
            levelled_mps2=self.levelled_mps2[begin:end],
            low_passed_mps2=self.low_passed_mps2[begin:end],
            begins_run=self.begins_run and begin == 0,
            lost=None if self.lost is None else self.lost[begin:end],
        )


def lost_samples(source: Integers) -> Integers:
    """`Block.lost` from the index (n,) of each sample among the raw ones, which is negative where interpolated."""
    lost = np.zeros(len(source), dtype=np.int64)
    edges = np.flatnonzero(np.diff(source < 0, prepend=False, append=False))
    for begin, end in edges.reshape(-1, 2).tolist():
        lost[begin:end] = end - begin
    return lost


@dataclass(frozen=True)
class SensorStatus:
    """State of one sensor's conditioning; `fault`: why there are no blocks, in one line, None without a fault.

    waiting: why gravity is still unknown, and the remedy, in one line. rate_hz: tracked by the sensor's clock;
    period_s: at rest, the length of a lost sample, 0 before rest. accepted: conditioned, so without those of the rest
    and before it. Rejected samples by cause, those before gravity was known included: unset stamp, reading not finite
    or impossible, duplicate, late, stray stamp. filled: interpolated; flat: of a long constant reading; dead: with an
    axis that has a part in the figures and is constant while another one moves. run_s: length of the present run, with
    the rest before the first one, None before it. uncounted_s: time before gravity was known; unrested_s: its part in
    motion; set_back_s: time with late stamps in a row, as of a clock that was set back; gap_s: between runs;
    unusable_s: time of the rejected samples since the last accepted one, 0 while it is no gap.
    """

    rate_hz: float | None
    period_s: float
    jitter_s: float | None
    gravity_mps2: float | None
    vertical: Vector | None
    filter_delay_s: float | None
    accepted: int
    unset: int
    non_finite: int
    duplicate: int
    late: int
    stray: int
    filled: int
    flat: int
    dead: int
    clipped: int
    runs: int
    run_s: float | None
    uncounted_s: float
    unrested_s: float
    set_back_s: float
    gap_s: float
    unusable_s: float
    warnings: tuple[str, ...]
    fault: str | None
    waiting: str | None

    @property
    def rejected(self) -> int:
        """All rejected samples."""
        return self.unset + self.non_finite + self.duplicate + self.late + self.stray

    @property
    def filled_s(self) -> float:
        """Interpolated seconds."""
        return self.filled * self.period_s

    @property
    def flat_s(self) -> float:
        """Seconds of long constant readings."""
        return self.flat * self.period_s

    @property
    def dead_s(self) -> float:
        """Seconds with a dead axis."""
        return self.dead * self.period_s

    @property
    def recorded_s(self) -> float:
        """Seconds from the first sample to the newest, by accepted samples, so that a stray stamp has no effect."""
        counted_s = (self.accepted + self.filled) / self.rate_hz if self.rate_hz else 0.0
        return self.uncounted_s + counted_s + self.gap_s
