"""Comparison: measurement and prediction on the seat's time grid, their residual, and doses of the low-passed sensors.

Instants wait until every sensor has reached them. The seat's samples give up instants that are `wait_s` of stamp time
older; missing values are NaN.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from biodyn_core import kernels
from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, N_SEGMENTS, N_SENSORS, SEGMENTS
from biodyn_core.conditioning.alignment import Aligner
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.meters import Dose, DoseMeter, Meter
from biodyn_core.exposure.suspect import SHORTEST_LOSS_S, constant_parts
from biodyn_core.exposure.tally import Tally
from biodyn_core.pipeline.frames import NO_MEASURED, MeasuredFrames


class ResidualMeter(Meter[tuple[Floats, Floats]]):
    """Rms of predicted minus measured per channel: `push` both (n, c) m/s^2; rows with NaN are left out.

    Figures: rms m/s^2 and rms over measured rms in percent, each (c,), NaN where nothing was compared.
    """

    def __init__(self, rate_hz: float, channels: int, window_s: float) -> None:
        self._tally = Tally(rate_hz, channels, 3, 3, window_s)

    def push(self, predicted_mps2: Floats, measured_mps2: Floats) -> None:
        """Count a block."""
        t = self._tally
        kernels.residual(predicted_mps2, measured_mps2, t.bin, t.total, t.ring, t.position, t.length)

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        self._tally.skip(seconds)

    def _figures(self, rows: Floats, rolling: bool) -> tuple[Floats, Floats]:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(rows[:, 0] / rows[:, 2]), 100.0 * np.sqrt(rows[:, 0] / rows[:, 1])


class Compared(NamedTuple):
    """Doses of one segment and of the seat over the same samples, all low-passed; measured is None without a sensor."""

    measured: Dose | None
    predicted: Dose
    seat: Dose


_COMPARED: Final = 3 * len(MEASURED_SEGMENTS)
"""Columns of measurement, prediction and seat with the same mask; all predictions, and the seat beside each, follow."""

_GROUPS: Final = np.concatenate(
    [np.tile(np.arange(len(MEASURED_SEGMENTS)), 3), _COMPARED + np.tile(np.arange(N_SEGMENTS), 2)]
)
"""The columns of a segment are counted over the same samples, also where a weighting has restarted."""


def _compared_columns(seat_mps2: Floats, predicted_mps2: Floats, measured_mps2: Floats) -> Floats:
    """Lay out seat (n,), predictions (n, 6) and measurements (n, 5) for one meter: a missing value masks all three."""
    predicted, seat = predicted_mps2[:, MEASURED_SEGMENT_INDEX], seat_mps2[:, None]
    missing = np.isnan(predicted) | np.isnan(measured_mps2)
    triples = [np.where(missing, np.nan, values) for values in (measured_mps2, predicted, seat)]
    return np.hstack([*triples, predicted_mps2, np.where(np.isnan(predicted_mps2), np.nan, seat)])


def _lost_of_columns(lost: Integers) -> Integers:
    """Losses by sensor (n, 6) as those of `_compared_columns`: a line is in the measurement."""
    found = np.zeros((len(lost), _GROUPS.size), dtype=np.int64)
    found[:, : len(MEASURED_SEGMENTS)] = lost[:, 1:]
    return found


def _by_segment(doses: tuple[Dose, ...]) -> dict[str, Compared]:
    """The doses of `_compared_columns` by segment; without a measured sample all predictions count."""
    triples, segments, seats = doses[:_COMPARED], doses[_COMPARED:-N_SEGMENTS], doses[-N_SEGMENTS:]
    found = {name: Compared(None, dose, seat) for name, dose, seat in zip(SEGMENTS, segments, seats, strict=True)}
    for column, name in enumerate(MEASURED_SEGMENTS):
        measured, predicted, seat_there = triples[column :: len(MEASURED_SEGMENTS)]
        if measured.has_figures:
            found[name] = Compared(measured, predicted, seat_there)
    return {name: compared for name, compared in found.items() if compared.predicted.has_figures}


_NO_BREAK: Final = np.full(1, np.nan)
"""The break_s of a live block of one instant: a new array each time would double the block's cost."""


class _Instants(NamedTuple):
    """Instants of the seat that wait for the other sensors: stamps, time, seat (n,), and all predictions (n, 6).

    break_s (n,): length of the break before an instant that begins a run, NaN elsewhere. suspect (n,): see `suspect`.
    """

    stamps_ns: Integers
    time_s: Floats
    seat_mps2: Floats
    predicted_mps2: Floats
    break_s: Floats
    suspect: Flags

    @classmethod
    def of(cls, block: Block, predicted_mps2: Floats, suspect: Flags) -> _Instants:
        """The instants of a block of the seat."""
        break_s = _NO_BREAK
        if block.begins_run or block.stamps_ns.size > 1:
            break_s = np.full(block.stamps_ns.size, np.nan)
            break_s[0] = block.gap_s if block.begins_run else np.nan
        return cls(block.stamps_ns, block.time_s, block.low_passed_mps2, predicted_mps2, break_s, suspect)

    @classmethod
    def join(cls, parts: list[_Instants]) -> _Instants:
        """Concatenate several."""
        return parts[0] if len(parts) == 1 else cls(*map(np.concatenate, zip(*parts, strict=True)))

    def after(self, at: int) -> _Instants:
        """The instants from `at` on."""
        return _Instants(
            self.stamps_ns[at:], self.time_s[at:], self.seat_mps2[at:], self.predicted_mps2[at:], self.break_s[at:],
            self.suspect[at:],
        )  # fmt: skip


class Comparison:
    """Add samples by `seat` and `sensor`; `release` returns every instant that is complete or given up.

    Doses do not contain the instants at which the seat is suspect, as those of the predictions, or the sensor; the
    residual does.
    """

    def __init__(self, seat_rate_hz: float, wait_s: float, window_s: float) -> None:
        self._seat_rate_hz, self._wait_s = seat_rate_hz, wait_s
        self._aligners = {name: Aligner(2.0 * wait_s, SHORTEST_LOSS_S) for name in MEASURED_SEGMENTS}
        self._pending: list[_Instants] = []
        self._given_up: list[MeasuredFrames] = []
        self._before_reset = 0
        self._epoch_ns = 0
        self.residual = ResidualMeter(seat_rate_hz, len(MEASURED_SEGMENTS), window_s)
        self.doses = DoseMeter("Wk", seat_rate_hz, N_SENSORS, window_s, np.arange(N_SENSORS))
        self.compared = DoseMeter("Wk", seat_rate_hz, _GROUPS.size, window_s, _GROUPS)

    def seat(self, block: Block, predicted_mps2: Floats, suspect: Flags) -> None:
        """Add the seat's instants, their predictions (n, 6) and suspect flags (n,); give up those overdue before."""
        self._epoch_ns = block.epoch_ns
        if self._pending and block.time_s[0] <= self._pending[-1].time_s[-1]:  # stamps that had leapt ahead return
            self._given_up.append(self._released(give_up_s=math.inf))
        elif self.overdue:
            self._given_up.append(self._released(give_up_s=float(self._pending[-1].time_s[-1]) - self._wait_s))
        self._pending.append(_Instants.of(block, predicted_mps2, suspect))

    def sensor(self, name: str, blocks: list[Block]) -> None:
        """Add another sensor's samples."""
        self._aligners[name].add(blocks)

    @property
    def overdue(self) -> bool:
        """Whether instants wait longer than they may: the seat's next sample gives them up."""
        waiting = self._pending
        return bool(waiting) and float(waiting[-1].time_s[-1] - waiting[0].time_s[0]) > 1.1 * self._wait_s

    def _first_is_reached(self) -> bool:
        first_s = float(self._pending[0].time_s[0])
        return all(aligner.reaches(first_s, self._epoch_ns) for aligner in self._aligners.values())

    def release(self, give_up: bool = False) -> MeasuredFrames:
        """Return the comparisons at instants that all sensors have reached or are given up; `give_up`: at all."""
        found = self._released(math.inf if give_up else -math.inf)
        if not self._given_up:
            return found
        parts, self._given_up = [*self._given_up, found], []
        return MeasuredFrames(*map(np.concatenate, zip(*parts, strict=True)))

    def _released(self, give_up_s: float) -> MeasuredFrames:
        """Return the comparisons at the instants that all sensors have reached, and at all before `give_up_s`."""
        if not self._pending or not (give_up_s > self._pending[0].time_s[0] or self._first_is_reached()):
            return NO_MEASURED
        grid = _Instants.join(self._pending)
        answers = [aligner.read(grid.time_s, self._epoch_ns) for aligner in self._aligners.values()]
        given_up = int(np.searchsorted(grid.time_s, give_up_s))
        ready = max(given_up, min(answered for _, answered in answers))
        self._pending = [grid.after(ready)] if ready < grid.time_s.size else []
        if ready == 0:
            return NO_MEASURED
        lost = self._lost(grid.time_s[:ready])
        for aligner in self._aligners.values():
            aligner.drop(float(grid.time_s[ready - 1]), self._epoch_ns)
        accel = np.column_stack([grid.seat_mps2[:ready], *(values[:ready] for values, _ in answers)])
        measured = np.ascontiguousarray(accel[:, 1:])
        predicted = np.ascontiguousarray(grid.predicted_mps2[:ready, MEASURED_SEGMENT_INDEX])
        columns = _compared_columns(grid.seat_mps2[:ready], grid.predicted_mps2[:ready], measured)
        self._count(lost, grid.suspect[:ready], grid.break_s[:ready], accel, columns, predicted, measured)
        return MeasuredFrames(grid.stamps_ns[:ready], accel, predicted - measured)

    def _lost(self, time_s: Floats) -> Integers | None:
        """Length of the loss in whose line each instant lies, by sensor (n, 6), in seat samples; None without lines."""
        if not any(aligner.has_lines for aligner in self._aligners.values()):
            return None
        lost, rate_hz = np.zeros((time_s.size, N_SENSORS), dtype=np.int64), self._seat_rate_hz
        for column, aligner in enumerate(self._aligners.values(), 1):
            if aligner.has_lines:
                length_s = aligner.lost_s(time_s, self._epoch_ns, 1.0 / rate_hz)
                lost[:, column] = np.where(length_s > 0.0, np.maximum(np.rint(length_s * rate_hz), 1.0), 0.0)
        return lost

    def compared_doses(self, rolling: bool) -> dict[str, Compared]:
        """Doses by segment since reset, or over the last `window_s`, of the instants answered and predicted."""
        return _by_segment(self.compared.rolling() if rolling else self.compared.since_reset())

    def _count(self, lost: Integers | None, suspect: Flags, *instants: Floats) -> None:
        """Count the answered instants; those that were waiting at the last reset count in rolling figures alone."""
        waiting = self._before_reset
        if waiting > 0:
            before = None if lost is None else lost[:waiting]
            self._count_runs(before, suspect[:waiting], *(values[:waiting] for values in instants))
            self._before_reset -= min(waiting, suspect.size)
            self._reset_meters()
        if waiting < suspect.size:
            after = None if lost is None else lost[waiting:]
            self._count_runs(after, suspect[waiting:], *(values[waiting:] for values in instants))

    def _count_runs(
        self,
        lost: Integers | None,
        suspect: Flags,
        break_s: Floats,
        accel: Floats,
        columns: Floats,
        predicted: Floats,
        measured: Floats,
    ) -> None:
        """Count run by run of the seat: nothing integrates across a break."""
        of_columns = None if lost is None else _lost_of_columns(lost)
        begins = np.flatnonzero(~np.isnan(break_s)).tolist()
        for begin, end in pairwise([*([] if begins[:1] == [0] else [0]), *begins, break_s.size]):
            if not np.isnan(break_s[begin]):
                self.doses.skip(float(break_s[begin]))
                self.residual.skip(float(break_s[begin]))
                self.compared.skip(float(break_s[begin]))
            self.residual.push(predicted[begin:end], measured[begin:end])
            for first, stop in constant_parts(suspect[begin:end]):
                part, is_suspect = slice(begin + first, begin + stop), bool(suspect[begin + first])
                self.doses.push(accel[part], is_suspect, None if lost is None else lost[part])
                self.compared.push(columns[part], is_suspect, None if of_columns is None else of_columns[part])

    def look_ahead(self) -> int:
        """Samples needed beyond an instant by the longest interpolator of all sensors."""
        return max(aligner.look_ahead for aligner in self._aligners.values())

    def reset(self) -> None:
        """Set everything "since reset" to zero, also for the instants that still wait."""
        self._before_reset = sum(part.time_s.size for part in self._pending)
        self._reset_meters()

    def _reset_meters(self) -> None:
        """Reset the meters; running averages begin again only once no instant from before the reset waits."""
        self.residual.reset()
        for meter in (self.doses, self.compared):
            meter.reset(averages=self._before_reset == 0)


class EarlyBlocks:
    """Hold the newest blocks of each sensor, up to `keep_s`, until the seat's rate is known and comparison begins."""

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self.blocks: defaultdict[str, deque[Block]] = defaultdict(deque)

    def add(self, sensor: str, blocks: list[Block]) -> None:
        """Add a sensor's blocks; drop those that the seat's first instants cannot need."""
        held = self.blocks[sensor]
        held.extend(blocks)
        while abs(held[-1].time_s[-1] - held[0].time_s[-1]) > self._keep_s:
            held.popleft()

    def move_to(self, comparison: Comparison) -> None:
        """Move all blocks to a comparison."""
        for sensor, held in self.blocks.items():
            comparison.sensor(sensor, list(held))
        self.blocks.clear()
