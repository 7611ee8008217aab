"""What conditioning gives: blocks of samples, and what was seen of a sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.conditioning.tilt import Vector


class Block(NamedTuple):
    """Conditioned samples of one sensor, evenly spaced within one run.

    stamps_ns (n,) and time_s (n,) are the instants answered, filter delay taken off (time_s since epoch_ns, the
    sensor's first stamp, for alignment); levelled_mps2 (n, 3), gravity-free, third axis up, before the low-pass;
    low_passed_mps2 (n,), vertical, up to cutoff_hz. gap_s: what lies between a run's first sample and the one before.
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

    def part(self, begin: int, end: int) -> Block:
        """The samples from `begin` up to `end`."""
        return self._replace(
            stamps_ns=self.stamps_ns[begin:end],
            time_s=self.time_s[begin:end],
            levelled_mps2=self.levelled_mps2[begin:end],
            low_passed_mps2=self.low_passed_mps2[begin:end],
            begins_run=self.begins_run and begin == 0,
        )


@dataclass(frozen=True)
class SensorStatus:
    """What one sensor's conditioning has seen so far; `fault` says in one line why it answers nothing.

    `waiting` says in one line why gravity is not known yet, and what helps.

    rate_hz follows the sensor's clock; period_s is that of rest, by which lost samples are seconds, 0 before it.
    Rejected samples by cause: stamp unset, reading not finite, duplicate, late, stamp astray. filled: interpolated;
    flat: of one that never changed for long. run_s: how long this run goes on, the rest before the first one included,
    None until there is one. uncounted_s passed before gravity was known, unrested_s of it in motion; set_back_s while
    stamps were late behind each other, as of a clock that was set back; gap_s lies between runs.
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
    clipped: int
    runs: int
    run_s: float | None
    uncounted_s: float
    unrested_s: float
    set_back_s: float
    gap_s: float
    warnings: tuple[str, ...]
    fault: str | None
    waiting: str | None

    @property
    def rejected(self) -> int:
        """Samples that were not used, for whatever cause."""
        return self.unset + self.non_finite + self.duplicate + self.late + self.stray

    @property
    def filled_s(self) -> float:
        """Seconds that are interpolated."""
        return self.filled * self.period_s

    @property
    def flat_s(self) -> float:
        """Seconds of a reading that never changed for long."""
        return self.flat * self.period_s

    @property
    def recorded_s(self) -> float:
        """Seconds from the first sample to the newest, by accepted samples: one wild stamp does not count."""
        counted_s = (self.accepted + self.filled) / self.rate_hz if self.rate_hz else 0.0
        return self.uncounted_s + counted_s + self.gap_s
