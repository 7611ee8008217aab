"""Sensor track: the conditioned runs of one sensor of a recording, along the true vertical, with invalid samples."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_core.conditioning.alignment import Aligner, half_width
from biodyn_core.conditioning.attitude import (
    MAX_GYRO_GAP_S,
    ImplausibleTilt,
    estimated_attitude,
    true_vertical_mps2,
    up_after_break,
)
from biodyn_core.conditioning.channels import Gyro, interpolated
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.rails import LEAST_MPS2
from biodyn_core.conditioning.tilt import UP, horizontal_axes, rotation_to_vertical
from biodyn_core.kernels.sensor import IMPLAUSIBLE
from biodyn_core.recording.flags import among, around, stretches

REACH_SHARE: Final = 1e-3
"""The low-pass reaches as far as a larger share of a wrong sample remains."""

VERTICAL_AT_REST: Final = "its vertical is the axis that was up at rest"

_NONE: Final = np.empty(0, dtype=np.int64)


class Run(NamedTuple):
    """A conditioned run of a sensor, and its angular rates (n, 3) rad/s in its own axes, NaN where none was read."""

    block: Block
    rates_radps: Floats | None = None

    def levelled_rates(self, rotation: Floats) -> Floats:
        """Rates (n, 3) in the axes that were level at rest; raises ValueError where the gyro has a gap."""
        assert self.rates_radps is not None
        longest = max((end - begin for begin, end in stretches(np.isnan(self.rates_radps[:, 0]))), default=0)
        if longest > MAX_GYRO_GAP_S * self.block.rate_hz:
            raise ValueError(f"its gyro has a gap of {longest / self.block.rate_hz:.2g} s")
        return np.asarray(interpolated(self.block.time_s, self.rates_radps) @ rotation.T)


class SensorTrack:
    """`push` raw samples of one sensor, `finish`, then read its conditioned runs with their invalid samples.

    tilt_is_implausible: whether its gyro gives an impossible tilt. mean_tilt: along x and y of `Channels` after
    `use_attitude`, None without a usable gyro.
    """

    def __init__(self, conditioner: Conditioner, with_channels: bool, vertical_at_rest: bool) -> None:
        self._conditioner = conditioner
        self._with_channels, self._vertical_at_rest = with_channels, vertical_at_rest
        self._gyro = Gyro()
        self._lines: list[str] = []
        self._usable: list[Integers] = []
        self._high: list[tuple[Integers, Floats]] = []
        self._read = self._clipped_ns = _NONE
        self._blocks: list[Block] = []
        self.runs: list[Run] = []
        self.tilt_is_implausible = False
        self._ups: list[Floats] = []
        self.mean_tilt: tuple[float, float] | None = None

    def push(self, stamps_ns: Integers, samples_mps2: Floats, rates_radps: Floats | None) -> None:
        """Add raw samples (n, 3) with their stamps (n,) ns, and rates (n, 3), if any."""
        # NaN on one axis makes the largest NaN, which is neither usable nor clipped.
        largest, limit = np.abs(samples_mps2).max(axis=1), self._conditioner.settings.saturation_mps2
        usable, high = largest < IMPLAUSIBLE * limit, largest >= min(limit, LEAST_MPS2)
        self._usable.append(stamps_ns[usable].astype(np.int64))
        self._high.append((stamps_ns[high].astype(np.int64), samples_mps2[high].astype(np.float64)))
        self._gyro.push(stamps_ns, usable, rates_radps)
        self._blocks += self._conditioner.push(stamps_ns, samples_mps2)

    def finish(self) -> None:
        """End the record: build the runs, and their attitude where a gyro gives it."""
        blocks = self._blocks + self._conditioner.finish()
        self.runs = [Run(block) for block in blocks]
        if blocks:
            try:
                rates = self._gyro.on(blocks, self._conditioner)
            except InputError as error:
                self._lines += [str(error)] if self._with_channels else []
            else:
                self.runs = [Run(*pair) for pair in zip(blocks, rates, strict=True)]
                self._ups = self._attitudes()
        # Sorted once, for the look-up of thousands of runs in a record with many gaps.
        clipped = [self._clipped_of(*high) for high in self._high]
        self._read, self._clipped_ns = (np.unique(np.concatenate([*part, _NONE])) for part in (self._usable, clipped))

    def _clipped_of(self, stamps_ns: Integers, samples_mps2: Floats) -> Integers:
        """The stamps (k,) of clipped ones among samples (n, 3), by rails known at the end of the record."""
        limit = self._conditioner.settings.saturation_mps2
        beyond = np.abs(samples_mps2).max(axis=1, initial=0.0) >= limit
        return stamps_ns[beyond | self._conditioner.clipping().at_rails(samples_mps2)]

    def _attitudes(self) -> list[Floats]:
        """The direction of up in every run, (n, 3), by the gyro; empty, with a warning, where it is unknown."""
        status = self._conditioner.status()
        if self._vertical_at_rest:
            return []
        assert status.vertical is not None and status.gravity_mps2 is not None  # known once there are runs
        gravity_mps2, rotation = status.gravity_mps2, rotation_to_vertical(np.array(status.vertical))
        try:
            gravity = self._conditioner.gravity
            # A part of a session begins with the tilt at its rest: changes within it are small beside those since.
            if not self._gyro.is_still or (gravity is not None and gravity.rates_radps is None):
                raise ValueError("its gyro does not rest at the start")
            return self._integrated(rotation, gravity_mps2)
        except ValueError as error:
            self.tilt_is_implausible = isinstance(error, ImplausibleTilt)
            self._lines.append(f"{self._conditioner.sensor}: {error}, so {VERTICAL_AT_REST}")
            return []

    def _integrated(self, rotation: Floats, gravity_mps2: float) -> list[Floats]:
        """The direction of up in every run: the first begins level, the next with the end of the run just before."""
        ups: list[Floats] = []
        breaks_s: list[float] = []
        before: tuple[int, Floats] | None = None
        for run in self.runs:
            block, rates, begin = run.block, run.levelled_rates(rotation), np.array(UP)
            if before is not None:
                away_s = 1e-9 * float(block.stamps_ns[0] - before[0])
                if 0.0 < away_s <= MAX_GYRO_GAP_S:
                    begin = up_after_break(ups[-1][-1], before[1], rates[0], away_s)
                else:
                    breaks_s.append(abs(away_s))
            ups.append(estimated_attitude(block.levelled_mps2, rates, block.rate_hz, gravity_mps2, begin))
            before = int(block.stamps_ns[-1]), rates[-1]
        if breaks_s:
            which = f"after {counted(len(breaks_s), 'break')} of up to {max(breaks_s):.2g} s"
            self._lines.append(f"{self._conditioner.sensor}: {which} {VERTICAL_AT_REST}")
        return ups

    def use_attitude(self, plausible: bool, skip_s: float) -> None:
        """Set the verticals of all runs along the true vertical; not where a gyro of the record is implausible.

        `mean_tilt` is the mean tilt after skip_s of each run.
        """
        if not self._ups:
            return
        status = self._conditioner.status()
        if not plausible:
            self._lines.append(
                f"{self._conditioner.sensor}: another gyro of the record is not plausible, so {VERTICAL_AT_REST}"
            )
            return
        assert status.vertical is not None and status.gravity_mps2 is not None
        pairs = list(zip(self.runs, self._ups, strict=True))
        verticals = [true_vertical_mps2(up, run.block.levelled_mps2, status.gravity_mps2) for run, up in pairs]
        self.runs = [
            run._replace(block=run.block._replace(low_passed_mps2=self._conditioner.zero_phase(vertical)))
            for run, vertical in zip(self.runs, verticals, strict=True)
        ]
        moving = np.concatenate([up[round(skip_s * run.block.rate_hz) :] for run, up in pairs])
        if len(moving):
            turn = horizontal_axes(status.vertical) @ rotation_to_vertical(np.array(status.vertical)).T
            x, y, _ = (-turn @ moving.mean(axis=0)).tolist()
            self.mean_tilt = x, y

    def reach(self) -> int:
        """Number of samples that the low-pass reaches to either side: the decay of its slowest pole to REACH_SHARE."""
        return self._conditioner.reach(REACH_SHARE)

    def lost_at_ends_s(self) -> float:
        """Seconds at each end of a complete run in which `aligners` read nothing; 0 without a run."""
        if not self.runs:
            return 0.0
        block = self.runs[0].block
        # The end sample counts as invalid, and an instant needs its neighbours on either side.
        return (1 + self.reach() + half_width(round(block.rate_hz, 1), block.cutoff_hz)) / block.rate_hz

    def invalid(self, block: Block, bridge_s: float) -> Flags:
        """Flags of samples of a run (n,) that are clipped, stuck, or interpolated across more than `bridge_s`."""
        # Measured samples keep their raw stamps: a zero-phase filter has no delay.
        filled = ~among(block.stamps_ns, self._read)
        unchanged = np.append(False, (np.diff(block.levelled_mps2, axis=0) == 0.0).all(axis=1))
        flat_for = math.ceil(self._conditioner.settings.flat_s * block.rate_hz)
        stuck = around(unchanged, 1, 0, least=flat_for)
        return among(block.stamps_ns, self._clipped_ns) | self._too_long(filled, block, bridge_s) | stuck

    def _too_long(self, missing: Flags, block: Block, bridge_s: float) -> Flags:
        """Flags of samples of a run (n,) in gaps longer than `bridge_s`."""
        return around(missing, 0, 0, least=max(1, math.floor(bridge_s * block.rate_hz + 1e-9)))

    def tracks(self, run: Run, invalid: Flags, bridge_s: float) -> list[Floats]:
        """Low-passed columns of a run, each (n,): its vertical, and with channels x, y and the rates, if any.

        NaN at invalid samples and within the low-pass's reach of them.
        """
        block, reach = run.block, self.reach()
        masked = around(invalid, reach, reach)
        tracks = [np.where(masked, np.nan, block.low_passed_mps2)]
        if not self._with_channels:
            return tracks
        up = self._conditioner.status().vertical
        assert up is not None  # known once there are runs
        axes = horizontal_axes(up)
        turn = axes @ rotation_to_vertical(np.array(up)).T
        horizontal = self._conditioner.zero_phase(block.levelled_mps2 @ turn[:2].T)
        tracks += [np.where(masked, np.nan, track) for track in horizontal.T]
        if run.rates_radps is not None:
            missing = np.isnan(run.rates_radps[:, 0])
            masked = around(invalid | self._too_long(missing, block, bridge_s), reach, reach)
            rates = self._conditioner.zero_phase(interpolated(block.time_s, run.rates_radps) @ axes.T)
            tracks += [np.where(masked, np.nan, track) for track in rates.T]
        return tracks

    def aligners(self, bridge_s: float) -> list[Aligner]:
        """An aligner for each track, for the seat's instants; NaN also at the ends of runs."""
        tracks = []
        for run in self.runs:
            invalid = self.invalid(run.block, bridge_s)
            invalid[0] = invalid[-1] = True
            tracks.append(self.tracks(run, invalid, bridge_s))
        aligners = [Aligner(keep_s=math.inf) for _ in (tracks[0] if tracks else [()])]
        for run, of_run in zip(self.runs, tracks, strict=True):
            for aligner, track in zip(aligners, of_run, strict=True):
                aligner.add([run.block._replace(low_passed_mps2=track)])
        return aligners

    def why_missing(self) -> str:
        """Why there is no run, in one line."""
        sensor = self._conditioner.sensor
        if not self._usable:
            return f"{sensor}: not in the record"
        return self._conditioner.fault or f"{sensor}: {self._conditioner.status().waiting}"

    def warnings(self) -> Iterator[str]:
        """Warnings about the sensor, one line each."""
        sensor, status = self._conditioner.sensor, self._conditioner.status()
        if not self.runs:
            yield self.why_missing()
            return
        yield from self._lines
        yield from (f"{sensor}: {line}" for line in status.warnings)
        if status.clipped:
            yield f"{sensor}: {counted(status.clipped, 'sample')} clipped, masked"
        if status.filled:
            yield f"{sensor}: {counted(status.filled, 'sample')} interpolated, longer gaps masked"
        if status.rejected:
            yield f"{sensor}: {counted(status.rejected, 'sample')} rejected"
        if status.runs > 1:
            breaks = counted(status.runs - 1, "gap or jump", "gaps or jumps")
            yield f"{sensor}: {breaks} of the stamps, {status.gap_s:.3f} s missing"
