"""One sensor on its way into a recording: its conditioned runs, set upright, and what of them was not truly read."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_core.conditioning.alignment import Aligner
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
from biodyn_core.conditioning.low_pass import FILTER_ORDER
from biodyn_core.conditioning.rails import LEAST_MPS2
from biodyn_core.conditioning.tilt import UP, horizontal_axes, rotation_to_vertical
from biodyn_core.kernels.sensor import IMPLAUSIBLE
from biodyn_core.recording.flags import among, around, stretches

LEFT_OF_AN_ERROR: Final = 1e-3
"""Of a wrong sample no more than this share is left where the low-pass is said to reach no further."""

AS_AT_REST: Final = "its vertical is the axis that was up at rest"

_NONE: Final = np.empty(0, dtype=np.int64)


class Run(NamedTuple):
    """A conditioned run of a sensor, and the rates read with it: (n, 3) rad/s in its own axes, NaN where none was."""

    block: Block
    rates_radps: Floats | None = None

    def turning(self, rotation: Floats) -> Floats:
        """Rates (n, 3) in the axes that were level at rest; raises ValueError where the gyro has a gap."""
        assert self.rates_radps is not None
        longest = max((end - begin for begin, end in stretches(np.isnan(self.rates_radps[:, 0]))), default=0)
        if longest > MAX_GYRO_GAP_S * self.block.rate_hz:
            raise ValueError(f"its gyro has a gap of {longest / self.block.rate_hz:.2g} s")
        return np.asarray(interpolated(self.block.time_s, self.rates_radps) @ rotation.T)


class SensorTrack:
    """One sensor on its way into a recording: its conditioned runs, and which of their samples were not truly read."""

    def __init__(self, conditioner: Conditioner, with_channels: bool, keep_lean: bool) -> None:
        self._conditioner = conditioner
        self._with_channels, self._keep_lean = with_channels, keep_lean
        self._gyro = Gyro()
        self._said: list[str] = []
        self._usable: list[Integers] = []
        self._high: list[tuple[Integers, Floats]] = []
        self._read = self._clipped_ns = _NONE
        self._blocks: list[Block] = []
        self.runs: list[Run] = []
        self.turns_too_far = False
        self._ups: list[Floats] = []
        self.lean: tuple[float, float] | None = None
        """On the mean, where it was set upright."""

    def push(self, stamps_ns: Integers, samples_mps2: Floats, rates_radps: Floats | None) -> None:
        """Take raw samples (n, 3) with their stamps (n,) ns, and rates (n, 3) where there are any."""
        # The largest of the axes is NaN where one is: then neither usable nor clipped.
        largest, limit = np.abs(samples_mps2).max(axis=1), self._conditioner.settings.saturation_mps2
        usable, high = largest < IMPLAUSIBLE * limit, largest >= min(limit, LEAST_MPS2)
        self._usable.append(stamps_ns[usable].astype(np.int64))
        self._high.append((stamps_ns[high].astype(np.int64), samples_mps2[high].astype(np.float64)))
        self._gyro.push(stamps_ns, usable, rates_radps)
        self._blocks += self._conditioner.push(stamps_ns, samples_mps2)

    def finish(self) -> None:
        """The record has ended: runs are there from here on, and where up is in them if a gyro tells it."""
        blocks = self._blocks + self._conditioner.finish()
        self.runs = [Run(block) for block in blocks]
        if blocks:
            try:
                rates = self._gyro.on(blocks, self._conditioner)
            except InputError as error:
                self._said += [str(error)] if self._with_channels else []
            else:
                self.runs = [Run(*pair) for pair in zip(blocks, rates, strict=True)]
                self._ups = self._followed()
        # Sorted once: a record full of gaps has thousands of runs to look up.
        clipped = [self._clipped_of(*high) for high in self._high]
        self._read, self._clipped_ns = (np.unique(np.concatenate([*part, _NONE])) for part in (self._usable, clipped))

    def _clipped_of(self, stamps_ns: Integers, samples_mps2: Floats) -> Integers:
        """The stamps (k,) of what is clipped among samples (n, 3): a rail is known only at the end of the record."""
        limit = self._conditioner.settings.saturation_mps2
        beyond = np.abs(samples_mps2).max(axis=1, initial=0.0) >= limit
        return stamps_ns[beyond | self._conditioner.clipping().at_rails(samples_mps2)]

    def _followed(self) -> list[Floats]:
        """Where up is in every run, (n, 3), by its gyro; nothing, and a line saying why, where that cannot be told."""
        status = self._conditioner.status()
        if self._keep_lean:
            return []
        assert status.vertical is not None and status.gravity_mps2 is not None  # it has been levelled by it
        gravity_mps2, rotation = status.gravity_mps2, rotation_to_vertical(np.array(status.vertical))
        try:
            if not self._gyro.is_still or self._conditioner.gravity is not None:
                raise ValueError("its gyro does not rest at the begin")
            return self._followed_from(rotation, gravity_mps2)
        except ValueError as error:
            self.turns_too_far = isinstance(error, ImplausibleTilt)
            self._said.append(f"{self._conditioner.sensor}: {error}, so {AS_AT_REST}")
            return []

    def _followed_from(self, rotation: Floats, gravity_mps2: float) -> list[Floats]:
        """Where up is in every run: the first begins upright, the next as the one before ended, if just before."""
        ups: list[Floats] = []
        breaks_s: list[float] = []
        before: tuple[int, Floats] | None = None
        for run in self.runs:
            block, rates, begin = run.block, run.turning(rotation), np.array(UP)
            if before is not None:
                away_s = 1e-9 * float(block.stamps_ns[0] - before[0])
                if 0.0 < away_s <= MAX_GYRO_GAP_S:
                    begin = up_after_break(ups[-1][-1], before[1], rates[0], away_s)
                else:
                    breaks_s.append(abs(away_s))
            ups.append(estimated_attitude(block.levelled_mps2, rates, block.rate_hz, gravity_mps2, begin))
            before = int(block.stamps_ns[-1]), rates[-1]
        if breaks_s:
            which = f"behind {counted(len(breaks_s), 'break')} of up to {max(breaks_s):.2g} s"
            self._said.append(f"{self._conditioner.sensor}: {which} {AS_AT_REST}")
        return ups

    def set_level(self, believed: bool, behind_s: float) -> None:
        """Read the verticals of all runs along where up is; not where the rates of the record are not believed.

        Its lean is the mean of what comes later than behind_s in each.
        """
        if not self._ups:
            return
        status = self._conditioner.status()
        if not believed:
            self._said.append(
                f"{self._conditioner.sensor}: another gyro of the record is not believed, so {AS_AT_REST}"
            )
            return
        assert status.vertical is not None and status.gravity_mps2 is not None
        followed = list(zip(self.runs, self._ups, strict=True))
        verticals = [true_vertical_mps2(up, run.block.levelled_mps2, status.gravity_mps2) for run, up in followed]
        self.runs = [
            run._replace(block=run.block._replace(low_passed_mps2=self._conditioner.zero_phase(vertical)))
            for run, vertical in zip(self.runs, verticals, strict=True)
        ]
        moving = np.concatenate([up[round(behind_s * run.block.rate_hz) :] for run, up in followed])
        if len(moving):
            turn = horizontal_axes(status.vertical) @ rotation_to_vertical(np.array(status.vertical)).T
            x, y, _ = (-turn @ moving.mean(axis=0)).tolist()
            self.lean = x, y

    def reach(self, rate_hz: float) -> int:
        """How many samples the low-pass reaches to either side: until its slowest pole has died away."""
        cutoff_hz = self._conditioner.settings.cutoff_hz
        decay_per_s = 2.0 * math.pi * cutoff_hz * math.sin(math.pi / (2.0 * FILTER_ORDER))
        return math.ceil(-math.log(LEFT_OF_AN_ERROR) / decay_per_s * rate_hz)

    def misread(self, block: Block, bridge_s: float) -> Flags:
        """Which samples of a run (n,) are clipped, stuck, or interpolated across more than `bridge_s`."""
        # What was read carries its raw stamp: a zero-phase filter takes no delay off.
        filled = ~among(block.stamps_ns, self._read)
        unchanged = np.append(False, (np.diff(block.levelled_mps2, axis=0) == 0.0).all(axis=1))
        flat_for = math.ceil(self._conditioner.settings.flat_s * block.rate_hz)
        stuck = around(unchanged, 1, 0, least=flat_for)
        return among(block.stamps_ns, self._clipped_ns) | self._too_long(filled, block, bridge_s) | stuck

    def _too_long(self, missing: Flags, block: Block, bridge_s: float) -> Flags:
        """Which samples of a run (n,) lie in gaps that no straight line may bridge."""
        return around(missing, 0, 0, least=max(1, math.floor(bridge_s * block.rate_hz + 1e-9)))

    def tracks(self, run: Run, misread: Flags, bridge_s: float) -> list[Floats]:
        """What is low-passed of a run, each (n,): its vertical, and with channels x and y, and the rates if there are.

        NaN where it is misread, and as far around as the low-pass reaches.
        """
        block, reach = run.block, self.reach(run.block.rate_hz)
        masked = around(misread, reach, reach)
        tracks = [np.where(masked, np.nan, block.low_passed_mps2)]
        if not self._with_channels:
            return tracks
        up = self._conditioner.status().vertical
        assert up is not None  # it has been levelled by it
        axes = horizontal_axes(up)
        turn = axes @ rotation_to_vertical(np.array(up)).T
        horizontal = self._conditioner.zero_phase(block.levelled_mps2 @ turn[:2].T)
        tracks += [np.where(masked, np.nan, track) for track in horizontal.T]
        if run.rates_radps is not None:
            missing = np.isnan(run.rates_radps[:, 0])
            masked = around(misread | self._too_long(missing, block, bridge_s), reach, reach)
            rates = self._conditioner.zero_phase(interpolated(block.time_s, run.rates_radps) @ axes.T)
            tracks += [np.where(masked, np.nan, track) for track in rates.T]
        return tracks

    def aligners(self, bridge_s: float) -> list[Aligner]:
        """For each of the tracks, answers at the seat's instants; NaN also at the ends of runs."""
        tracks = []
        for run in self.runs:
            misread = self.misread(run.block, bridge_s)
            misread[0] = misread[-1] = True
            tracks.append(self.tracks(run, misread, bridge_s))
        aligners = [Aligner(keep_s=math.inf) for _ in (tracks[0] if tracks else [()])]
        for run, of_run in zip(self.runs, tracks, strict=True):
            for aligner, track in zip(aligners, of_run, strict=True):
                aligner.add([run.block._replace(low_passed_mps2=track)])
        return aligners

    def why_nothing(self) -> str:
        """Why there is no run, in one line."""
        sensor = self._conditioner.sensor
        if not self._usable:
            return f"{sensor}: not in the record"
        return self._conditioner.fault or f"{sensor}: {self._conditioner.status().waiting}"

    def warnings(self) -> Iterator[str]:
        """What is to be said of the sensor, one line each."""
        sensor, status = self._conditioner.sensor, self._conditioner.status()
        if not self.runs:
            yield self.why_nothing()
            return
        yield from self._said
        yield from (f"{sensor}: {line}" for line in status.warnings)
        if status.clipped:
            yield f"{sensor}: {counted(status.clipped, 'sample')} clipped, masked"
        if status.filled:
            yield f"{sensor}: {counted(status.filled, 'sample')} interpolated, gaps above the bridge masked"
        if status.rejected:
            yield f"{sensor}: {counted(status.rejected, 'sample')} rejected"
        if status.runs > 1:
            breaks = counted(status.runs - 1, "gap or jump", "gaps or jumps")
            yield f"{sensor}: {breaks} of the stamps, {status.gap_s:.3f} s missing"
