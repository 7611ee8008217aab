"""Recording: what identification and validation fit to, one event of six sensors on the seat's grid, zero-phase.

The conditioning is that of the live path but for its filter, which runs forward and backward. What a sensor did not
truly read is masked, never repaired: clipped and stuck readings, longer gaps, and as far around them as the low-pass
reaches.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biodyn_core.alignment import Aligner
from biodyn_core.channels import Channels, Gyro, bridged, laid_level
from biodyn_core.conditioning import (
    FILTER_ORDER,
    Block,
    Conditioner,
    ConditioningSettings,
    Vector,
    rotation_to_vertical,
)
from biodyn_core.errors import InputError
from biodyn_core.heading import bend_rates_radps, headings_rad
from biodyn_core.kernels.sensor import IMPLAUSIBLE
from biodyn_core.segments import HEAD, MEASURED_SEGMENTS, SEAT, SENSORS
from biodyn_core.settings import check_settings, setting
from biodyn_core.upright import BLIND_S, NobodysLean, followed_up, true_vertical_mps2

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

WARM_UP_S: Final = 2.0
"""A model that starts from rest is not compared before so long (Zaman et al., 5.3), nor behind a seat misread."""

LEFT_OF_AN_ERROR: Final = 1e-3
"""Of a wrong sample no more than this share is left where the low-pass is said to reach no further."""

SHORTEST_LEVEL_S: Final = 2.0
"""A level is taken from at least so long without a mask: three periods of a car's body bounce."""


WORTH_A_LINE_S: Final = 0.05
"""What is masked in all is said from here on: one clipped sample is more, the ends, where nothing is read, less."""

AS_AT_REST: Final = "its vertical is the axis that was up at rest"

_NONE: Final = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Recording:
    """One event, conditioned zero-phase and aligned on the seat's grid: what identification fits to."""

    name: str
    """Where it came from."""
    case: str
    """Loading condition: road, pothole, rail, ..."""
    rate_hz: float
    stamps_ns: Integers
    """(n,)"""
    seat_mps2: Floats
    """(n,) vertical, gravity-free, low-passed, no NaN."""
    measured_mps2: Floats
    """(n, 5) by `MEASURED_SEGMENTS`, NaN where a sensor brought nothing usable."""
    warnings: tuple[str, ...]
    """Quality: clipping, gaps, drift, missing segments, one line each."""
    channels: Mapping[str, Channels] = field(default_factory=dict)
    """What each of `SENSORS` measured beside its vertical; empty where it was not asked for."""
    leans: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """How far the sensors that were set upright lean on the mean, behind the warm-up, along x and y of `Channels`: what
    of a motion along these they would have read as vertical."""
    headings: Mapping[str, float] = field(default_factory=dict)
    """How far x of these sensors' `Channels` is turned to the left of the seat's, rad, where their motion tells it."""

    def named_channels(self) -> dict[str, Floats]:
        """Every channel by its name, such as `seat.x` or `head.bend_rate_y`, (n,) each, 0 where masked."""
        found = {
            f"{sensor}.{name}": column
            for sensor, channels in self.channels.items()
            for name, column in channels.columns().items()
        }
        found |= bend_rates_radps(self.channels, self.headings)
        return {name: np.nan_to_num(column) for name, column in found.items()}


@dataclass(frozen=True)
class RecordingSettings:
    """What a recording must be, and what is masked or taken off in it."""

    shortest_s: float = setting(3.0, "shortest recording, the 2 s of warm-up included", "s", 2.5, 3600.0)
    least_seat_rms_mps2: float = setting(
        0.1, "least rms of the seat, behind the warm-up, that counts as excitation", "m/s^2", 0.0, 100.0
    )
    bridge_s: float = setting(
        0.004, "a straight line across a gap up to this long is kept, a longer one is masked", "s", 0.0, 0.05
    )
    keep_level: bool = setting(False, "keep what a channel's level has moved by since rest, instead of taking it off")
    keep_lean: bool = setting(
        False, "keep verticals along the axis that was up at rest, though a gyro says that its sensor leans"
    )
    moved_level_mps2: float = setting(
        0.3, "a level moved by more than this is said: 14 deg of lean, or a bias", "m/s^2", 0.0, 100.0
    )

    def __post_init__(self) -> None:
        check_settings(self)


class Recorder:
    """`push(sensor, stamps_ns, samples)` raw samples as they come, `finish()` gives the recordings; any cut, same bits.

    verticals: where sensors' axes see up, for those whose rest is not to tell it. channels: whether the channels of a
    recording are wanted, for which rates are pushed too.
    """

    def __init__(
        self,
        case: str,
        name: str,
        conditioning: ConditioningSettings | None = None,
        settings: RecordingSettings | None = None,
        verticals: Mapping[str, Vector] | None = None,
        channels: bool = False,
    ) -> None:
        self.case, self.name = case, name
        self.settings = settings or RecordingSettings()
        given = verticals or {}
        self._with_channels = channels
        self._sensors = {
            sensor: _Sensor(
                Conditioner(sensor, conditioning, "zero_phase", given.get(sensor)), channels, self.settings.keep_lean
            )
            for sensor in SENSORS
        }

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats, rates_radps: Floats | None = None) -> None:
        """Take raw specific force (n, 3) m/s^2 of one sensor with its stamps (n,) ns, in order of arrival.

        rates_radps (n, 3) in the same axes, NaN where there are none: with them verticals stay upright.
        """
        if sensor not in self._sensors:
            raise InputError(f"sensor {sensor!r} is unknown, known are {', '.join(SENSORS)}")
        if rates_radps is not None and rates_radps.shape != samples_mps2.shape:
            raise InputError(f"{sensor}: rates of shape {rates_radps.shape}, samples have {samples_mps2.shape}")
        self._sensors[sensor].push(stamps_ns, samples_mps2, rates_radps)

    def finish(self) -> list[Recording]:
        """The record has ended: one recording for each run of the seat that can be fitted to, in order.

        Raises InputError, saying why, where there is none: no seat, no other sensor, too short, no excitation.
        """
        for sensor in self._sensors.values():
            sensor.finish()
        believed = not any(sensor.turns_too_far for sensor in self._sensors.values())
        for sensor in self._sensors.values():
            sensor.set_upright(believed)
        seat, others = self._sensors[SEAT], [self._sensors[name] for name in MEASURED_SEGMENTS]
        if not seat.runs:
            raise InputError(f"{self.name}: {seat.why_nothing()}")
        if not any(sensor.runs for sensor in others):
            raise InputError(f"{self.name}: {others[-1].why_nothing()}, nor is any other segment: nothing to compare")
        aligners = {name: self._sensors[name].aligners(self.settings.bridge_s) for name in MEASURED_SEGMENTS}
        recordings, reasons = [], []
        for run in seat.runs:
            try:
                recordings.append(self._recording(run, aligners))
            except InputError as error:
                reasons.append((-run.block.time_s.size, str(error)))
        if not recordings:
            raise InputError(f"{self.name}: {min(reasons)[1]}")  # that of the longest run
        return self._told(recordings, [reason for _, reason in reasons])

    def _recording(self, run: _Run, aligners: Mapping[str, Sequence[Aligner]]) -> Recording:
        """One run of the seat, less the ends that the low-pass could not see beyond, and the others beside it."""
        seat, rate_hz = self._sensors[SEAT], _mean_rate_hz(run.block)
        reach = seat.reach(run.block.rate_hz)
        inner = slice(reach, run.block.time_s.size - reach)
        block = run.block.part(inner.start, inner.stop)
        misread = seat.misread(run.block, self.settings.bridge_s)
        tracks = {SEAT: [track[inner] for track in seat.tracks(run, misread, self.settings.bridge_s)]}
        unsettled = around(np.isnan(tracks[SEAT][0]), 0, round(WARM_UP_S * rate_hz))
        self._check(tracks[SEAT][0], rate_hz)
        for name in MEASURED_SEGMENTS:
            read = [aligner.read(block.time_s, block.epoch_ns)[0] for aligner in aligners[name]]
            tracks[name] = [np.where(unsettled, np.nan, track) for track in read]
        levels = {name: self._level(vertical, rate_hz) for name, (vertical, *_) in tracks.items()}
        measured = np.column_stack([tracks[name][0] - levels[name] for name in MEASURED_SEGMENTS])
        channels = {name: self._beside(tracks[name], rate_hz) for name in SENSORS} if self._with_channels else {}
        return Recording(
            name=self.name,
            case=self.case,
            rate_hz=rate_hz,
            stamps_ns=block.stamps_ns.copy(),
            seat_mps2=block.low_passed_mps2 - levels[SEAT],
            measured_mps2=measured,
            warnings=(*self._moved(levels), *self._masked(unsettled, measured, rate_hz)),
            channels=channels,
            leans={name: sensor.lean for name, sensor in self._sensors.items() if sensor.lean is not None},
            headings=headings_rad(channels, rate_hz),
        )

    def _beside(self, tracks: Sequence[Floats], rate_hz: float) -> Channels:
        """A sensor's tracks but its vertical; what is no sensor in the record has no numbers."""
        if len(tracks) == 1:
            return Channels(np.full((tracks[0].size, 2), np.nan), None)
        horizontal = [track - self._level(track, rate_hz) for track in tracks[1:3]]
        return Channels(np.column_stack(horizontal), np.column_stack(tracks[3:]) if tracks[3:] else None)

    def _masked(self, unsettled: Flags, measured_mps2: Floats, rate_hz: float) -> Iterator[str]:
        """How long nothing can be compared, one line for the seat and each segment."""
        if unsettled.any():
            seconds = np.count_nonzero(unsettled) / rate_hz
            yield f"seat: misread, so all segments are masked there and {WARM_UP_S:g} s on: {seconds:.2f} s"
        for name, column in zip(MEASURED_SEGMENTS, measured_mps2.T, strict=True):
            masked_s = np.count_nonzero(np.isnan(column)) / rate_hz
            if masked_s > WORTH_A_LINE_S and self._sensors[name].runs:
                yield f"{name}: nothing usable in {masked_s:.2f} s of {column.size / rate_hz:.2f} s"

    def _check(self, seat_mps2: Floats, rate_hz: float) -> None:
        """Raise InputError for what no model can be fitted to; what was misread (NaN) is no excitation."""
        seconds, s = seat_mps2.size / rate_hz, self.settings
        if seconds < s.shortest_s:
            raise InputError(
                f"{seconds:.2f} s between rest, gaps and ends are too short: {s.shortest_s:g} s are needed,"
                f" {WARM_UP_S:g} s of them warm-up: record longer"
            )
        behind = seat_mps2[round(WARM_UP_S * rate_hz) :]
        behind = behind[~np.isnan(behind)]
        rms = float(behind.std()) if behind.size else 0.0
        if rms < s.least_seat_rms_mps2:
            raise InputError(
                f"the seat moves by {rms:.2g} m/s^2 rms behind the warm-up, {s.least_seat_rms_mps2:g} are needed:"
                " without excitation nothing can be told"
            )

    def _level(self, values: Floats, rate_hz: float) -> float:
        """What is taken off a channel; 0 where its level is kept or cannot be told."""
        return 0.0 if self.settings.keep_level else level_mps2(values, rate_hz) or 0.0

    def _moved(self, levels: Mapping[str, float]) -> Iterator[str]:
        """The levels that have moved far since rest, one line each."""
        for name, level in levels.items():
            if abs(level) > self.settings.moved_level_mps2:
                yield f"{name}: its level has moved by {level:+.2f} m/s^2 since rest (taken off): did it lean over?"

    def _told(self, recordings: list[Recording], left_out: list[str]) -> list[Recording]:
        """The recordings, each named and with what is to be said of all."""
        of_all = [line for sensor in self._sensors.values() for line in sensor.warnings()]
        of_all += [f"a part is left out: {reason}" for reason in left_out]
        several = len(recordings) > 1
        if several:
            of_all.append(f"gaps of the seat split the record into {len(recordings)} recordings")
        return [
            dataclasses.replace(
                recording,
                name=f"{self.name} ({number} of {len(recordings)})" if several else self.name,
                warnings=(*of_all, *recording.warnings),
            )
            for number, recording in enumerate(recordings, 1)
        ]


class _Run(NamedTuple):
    """A conditioned run of a sensor, and the rates read with it: (n, 3) rad/s in its own axes, NaN where none was."""

    block: Block
    rates_radps: Floats | None = None

    def turning(self, rotation: Floats) -> Floats:
        """Rates (n, 3) in the axes that were level at rest; raises ValueError where the gyro has a gap."""
        assert self.rates_radps is not None
        longest = max((end - begin for begin, end in stretches(np.isnan(self.rates_radps[:, 0]))), default=0)
        if longest > BLIND_S * self.block.rate_hz:
            raise ValueError(f"its gyro has a gap of {longest / self.block.rate_hz:.2g} s")
        return np.asarray(bridged(self.block.time_s, self.rates_radps) @ rotation.T)


class _Sensor:
    """One sensor on its way into a recording: its conditioned runs, and which of their samples were not truly read."""

    def __init__(self, conditioner: Conditioner, with_channels: bool, keep_lean: bool) -> None:
        self._conditioner = conditioner
        self._with_channels, self._keep_lean = with_channels, keep_lean
        self._gyro = Gyro()
        self._said: list[str] = []
        self._usable: list[Integers] = []
        self._clipped: list[Integers] = []
        self._read = self._clipped_ns = _NONE
        self._blocks: list[Block] = []
        self.runs: list[_Run] = []
        self.turns_too_far = False
        self._ups: list[Floats] = []
        self.lean: tuple[float, float] | None = None
        """On the mean, where it was set upright."""

    def push(self, stamps_ns: Integers, samples_mps2: Floats, rates_radps: Floats | None) -> None:
        # The largest of the axes is NaN where one is: then neither usable nor clipped.
        largest, limit = np.abs(samples_mps2).max(axis=1), self._conditioner.settings.saturation_mps2
        usable = largest < IMPLAUSIBLE * limit
        self._usable.append(stamps_ns[usable].astype(np.int64))
        self._clipped.append(stamps_ns[largest >= limit].astype(np.int64))
        self._gyro.push(stamps_ns, usable, rates_radps)
        self._blocks += self._conditioner.push(stamps_ns, samples_mps2)

    def finish(self) -> None:
        blocks = self._blocks + self._conditioner.finish()
        self.runs = [_Run(block) for block in blocks]
        if blocks:
            try:
                rates = self._gyro.on(blocks, self._conditioner)
            except InputError as error:
                self._said += [str(error)] if self._with_channels else []
            else:
                self.runs = [_Run(*pair) for pair in zip(blocks, rates, strict=True)]
                self._ups = self._followed()
        # Sorted once: a record full of gaps has thousands of runs to look up.
        self._read, self._clipped_ns = (
            np.unique(np.concatenate([*part, _NONE])) for part in (self._usable, self._clipped)
        )

    def _followed(self) -> list[Floats]:
        """Where up is in every run, (n, 3), by its gyro; nothing, and a line saying why, where that cannot be told."""
        status = self._conditioner.status()
        if self._keep_lean:
            return []
        assert status.vertical is not None and status.gravity_mps2 is not None  # it has been levelled by it
        gravity_mps2, rotation = status.gravity_mps2, rotation_to_vertical(np.array(status.vertical))
        try:
            if not self._gyro.still:
                raise ValueError("its gyro does not rest at the begin")
            return [
                followed_up(run.block.levelled_mps2, run.turning(rotation), run.block.rate_hz, gravity_mps2)
                for run in self.runs
            ]
        except ValueError as error:
            self.turns_too_far = isinstance(error, NobodysLean)
            self._said.append(f"{self._conditioner.sensor}: {error}, so {AS_AT_REST}")
            return []

    def set_upright(self, believed: bool) -> None:
        """Read the verticals of all runs along where up is; not where the rates of the record are not believed."""
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
        moving = np.concatenate([up[round(WARM_UP_S * run.block.rate_hz) :] for run, up in followed])
        if len(moving):
            turn = laid_level(status.vertical) @ rotation_to_vertical(np.array(status.vertical)).T
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
        filled = ~_among(block.stamps_ns, self._read)
        unchanged = np.append(False, (np.diff(block.levelled_mps2, axis=0) == 0.0).all(axis=1))
        flat_for = math.ceil(self._conditioner.settings.flat_s * block.rate_hz)
        stuck = around(unchanged, 1, 0, least=flat_for)
        return _among(block.stamps_ns, self._clipped_ns) | self._too_long(filled, block, bridge_s) | stuck

    def _too_long(self, missing: Flags, block: Block, bridge_s: float) -> Flags:
        """Which samples of a run (n,) lie in gaps that no straight line may bridge."""
        return around(missing, 0, 0, least=max(1, math.floor(bridge_s * block.rate_hz + 1e-9)))

    def tracks(self, run: _Run, misread: Flags, bridge_s: float) -> list[Floats]:
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
        axes = laid_level(up)
        turn = axes @ rotation_to_vertical(np.array(up)).T
        horizontal = self._conditioner.zero_phase(block.levelled_mps2 @ turn[:2].T)
        tracks += [np.where(masked, np.nan, track) for track in horizontal.T]
        if run.rates_radps is not None:
            missing = np.isnan(run.rates_radps[:, 0])
            masked = around(misread | self._too_long(missing, block, bridge_s), reach, reach)
            rates = self._conditioner.zero_phase(bridged(block.time_s, run.rates_radps) @ axes.T)
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
                aligner.feed([run.block._replace(low_passed_mps2=track)])
        return aligners

    def why_nothing(self) -> str:
        """Why there is no run, in one line."""
        sensor = self._conditioner.sensor
        if not self._usable:
            return f"{sensor}: not in the record"
        shorter = "shorter than the seconds of rest that gravity needs: record longer, or lower rest_s"
        return self._conditioner.fault or f"{sensor}: {shorter}"

    def warnings(self) -> Iterator[str]:
        """What is to be said of the sensor, one line each."""
        sensor, status = self._conditioner.sensor, self._conditioner.status()
        if not self.runs:
            yield self.why_nothing()
            return
        yield from self._said
        yield from (f"{sensor}: {line}" for line in status.warnings)
        if status.clipped:
            yield f"{sensor}: {status.clipped} samples clipped, masked"
        if status.filled:
            yield f"{sensor}: {status.filled} samples interpolated, gaps above the bridge masked"
        if status.rejected:
            yield f"{sensor}: {status.rejected} samples rejected"
        if status.runs > 1:
            yield f"{sensor}: {status.runs - 1} gaps or jumps of the stamps, {status.gap_s:.3f} s missing"


def representative(recordings: Sequence[Recording]) -> Recording:
    """The repetition of a case with the largest rms acceleration of the head (Zaman et al., 5.3).

    Raises InputError where the head was measured in none.
    """
    measured = [recording for recording in recordings if np.isfinite(_head(recording)).any()]
    if not measured:
        raise InputError("no recording has a head: the representative trial is the one with the largest head rms")
    return max(measured, key=lambda recording: float(np.nanmean(_head(recording) ** 2)))


def _head(recording: Recording) -> Floats:
    behind = round(WARM_UP_S * recording.rate_hz)
    return recording.measured_mps2[behind:, MEASURED_SEGMENTS.index(HEAD)]


def level_mps2(values: Floats, rate_hz: float) -> float | None:
    """The level of a channel (n,) with NaN, by its longest stretch without; None where that is too short.

    A tapered mean: a plain one (Zaman et al., 5.2: all channels demeaned) takes the velocity gained between the ends
    for a level.
    """
    begin, end = max(stretches(~np.isnan(values)), key=lambda stretch: stretch[1] - stretch[0], default=(0, 0))
    if end - begin < SHORTEST_LEVEL_S * rate_hz:
        return None
    taper = np.hanning(end - begin)
    return float(taper @ values[begin:end] / taper.sum())


def stretches(flags: Flags) -> list[tuple[int, int]]:
    """Where flags (n,) are set: (first, end) of every stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def around(flags: Flags, before: int, after: int, least: int = 1) -> Flags:
    """Flags (n,) widened by so many samples before and after each stretch; stretches shorter than `least` are gone."""
    wide = np.zeros(flags.shape, dtype=np.bool_)
    for begin, end in stretches(flags):
        if end - begin >= least:
            wide[max(0, begin - before) : end + after] = True
    return wide


def _among(values: Integers, ascending: Integers) -> Flags:
    """Which values (n,) are among ascending ones (m,)."""
    if ascending.size == 0:
        return np.zeros(values.shape, dtype=np.bool_)
    at = np.minimum(np.searchsorted(ascending, values), ascending.size - 1)
    return ascending[at] == values


def _mean_rate_hz(block: Block) -> float:
    """The rate a run truly had; that of its design where it is one sample long."""
    return (
        float((block.time_s.size - 1) / (block.time_s[-1] - block.time_s[0]))
        if block.time_s.size > 1
        else block.rate_hz
    )
