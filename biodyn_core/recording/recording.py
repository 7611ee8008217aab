"""Recording: data of identification and validation, one event of six sensors on the seat's time grid, zero-phase.

Conditioning is that of the live path, except for the filter, which runs forward and backward. Invalid samples are
masked, never repaired: clipped and stuck readings, longer gaps, and all samples within the low-pass's reach of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.errors import InputError, UnusableRecording
from biodyn_core.base.segments import HEAD, MEASURED_SEGMENTS, SEAT, SENSORS
from biodyn_core.base.suggestions import known_are
from biodyn_core.base.wording import counted
from biodyn_core.body.model import WARM_UP_S, slow_seat
from biodyn_core.conditioning.alignment import Aligner
from biodyn_core.conditioning.channels import Channels
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.conditioner import Conditioner, SettingsOf, settings_for
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.tilt import Vector
from biodyn_core.recording.body_sensor import Run, SensorTrack
from biodyn_core.recording.flags import around, stretches
from biodyn_core.recording.heading import bend_rates_radps, headings_rad
from biodyn_core.recording.recording_settings import RecordingSettings

SHORTEST_LEVEL_S: Final = 2.0
"""Shortest stretch without a mask for a level: three periods of a car's body bounce."""

REPORTED_S: Final = 0.05
"""Masked time that is reported, beyond the ends of a complete record: one clipped sample masks more."""


@dataclass(frozen=True, eq=False)
class Recording:
    """One event, conditioned zero-phase and aligned on the seat's time grid."""

    name: str
    """The source, such as a bag."""
    case: str
    """Loading condition: road, pothole, rail, ..."""
    rate_hz: float
    stamps_ns: Integers
    """(n,)"""
    seat_mps2: Floats
    """(n,) vertical, gravity-free, low-passed, no NaN."""
    measured_mps2: Floats
    """(n, 5) by `MEASURED_SEGMENTS`, NaN without a usable sample."""
    warnings: tuple[str, ...]
    """Quality: clipping, gaps, drift, missing segments, one line each."""
    channels: Mapping[str, Channels] = field(default_factory=dict)
    """Further channels by name in `SENSORS`; empty if not requested."""
    mean_tilts: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Mean tilt, after the warm-up, of the sensors with a known attitude: the share of motion along x and y of
    `Channels` that they would have read as vertical."""
    seat_invalid_s: float = 0.0
    """Seconds of invalid samples of the seat, and within the low-pass's reach of them."""
    left_out_s: float = 0.0
    """Seconds of the seat in other parts of the record, between its gaps, that are in no recording."""
    ends_s: Mapping[str, float] = field(default_factory=dict)
    """Seconds at each end that a complete record of a segment lacks: its low-pass and its interpolation reach further
    than the low-pass of the seat."""
    headings: Mapping[str, float] = field(default_factory=dict)
    """Rotation of x of these sensors' `Channels` to the left of the seat's, rad, where their motion shows it."""
    record: str = ""
    """The name of the whole record, of which gaps of the seat may leave several recordings."""
    cutoff_hz: float = ConditioningSettings().cutoff_hz
    """Of the seat's low-pass."""
    seat_lost: Integers | None = None
    """(n,) of the seat, as `Block.lost`."""

    @property
    def begin(self) -> int:
        """The first sample after the warm-up."""
        return round(WARM_UP_S * self.rate_hz)

    @property
    def seat_losses(self) -> Integers:
        """`seat_lost` (n,), zeros without any."""
        return np.zeros(self.seat_mps2.shape, dtype=np.int64) if self.seat_lost is None else self.seat_lost

    def named_channels(self) -> dict[str, Floats]:
        """Every channel by its name, such as `seat.x` or `head.bend_rate_y`, (n,) each, 0 where masked."""
        found = {
            f"{sensor}.{name}": column
            for sensor, channels in self.channels.items()
            for name, column in channels.columns().items()
        }
        found |= bend_rates_radps(self.channels, self.headings)
        return {name: np.nan_to_num(column) for name, column in found.items()}


class Recorder:
    """`push` raw samples, `finish` for the recordings; the same bits for any cut into blocks.

    verticals: up in the axes of sensors, where rest does not determine it. channels: whether recordings contain
    channels, for which rates are pushed too. gravity: of sensors whose whole record was searched for rest.
    """

    def __init__(
        self,
        case: str,
        name: str,
        conditioning: SettingsOf = None,
        settings: RecordingSettings | None = None,
        verticals: Mapping[str, Vector] | None = None,
        channels: bool = False,
        gravity: Mapping[str, Gravity] | None = None,
    ) -> None:
        self.case, self.name = case, name
        self.settings = settings or RecordingSettings()
        given, known = verticals or {}, gravity or {}
        self._with_channels = channels
        self._sensors = {
            sensor: SensorTrack(
                Conditioner(
                    sensor, settings_for(sensor, conditioning), "zero_phase", given.get(sensor), known.get(sensor)
                ),
                channels,
                self.settings.keep_lean,
            )
            for sensor in SENSORS
        }

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats, rates_radps: Floats | None = None) -> None:
        """Take raw specific force (n, 3) m/s^2 of one sensor with its stamps (n,) ns, in order of arrival.

        rates_radps (n, 3) in the same axes, NaN where there are none: with them verticals follow the sensor's tilt.
        """
        if sensor not in self._sensors:
            raise InputError(f"sensor {sensor!r} is unknown, {known_are(sensor, SENSORS)}")
        if rates_radps is not None and rates_radps.shape != samples_mps2.shape:
            raise InputError(f"{sensor}: rates of shape {rates_radps.shape}, samples have {samples_mps2.shape}")
        self._sensors[sensor].push(stamps_ns, samples_mps2, rates_radps)

    def finish(self) -> list[Recording]:
        """End the record: one recording for each usable run of the seat, in order.

        Raises UnusableRecording without any: no seat, no other sensor, too short, no excitation.
        """
        for sensor in self._sensors.values():
            sensor.finish()
        plausible = not any(sensor.tilt_is_implausible for sensor in self._sensors.values())
        for sensor in self._sensors.values():
            sensor.use_attitude(plausible, WARM_UP_S)
        seat, others = self._sensors[SEAT], [self._sensors[name] for name in MEASURED_SEGMENTS]
        if not seat.runs:
            raise UnusableRecording(f"{self.name}: {seat.why_missing()}")
        if not any(sensor.runs for sensor in others):
            why = f"{others[-1].why_missing()}, nor is any other segment: nothing to compare"
            raise UnusableRecording(f"{self.name}: {why}")
        aligners = {name: self._sensors[name].aligners(self.settings.bridge_s) for name in MEASURED_SEGMENTS}
        recordings: list[Recording] = []
        left_out: list[tuple[float, str]] = []
        for run in seat.runs:
            try:
                recordings.append(self._recording(run, aligners))
            except InputError as error:
                left_out.append((run.block.time_s.size / run.block.rate_hz, str(error)))
        if not recordings:
            raise UnusableRecording(f"{self.name}: {max(left_out)[1]}")  # the reason of the longest run
        return self._labelled(recordings, left_out)

    def _recording(self, run: Run, aligners: Mapping[str, Sequence[Aligner]]) -> Recording:
        """A recording from one run of the seat, without its ends, where the low-pass lacks samples."""
        seat, rate_hz = self._sensors[SEAT], _mean_rate_hz(run.block)
        reach = seat.reach()
        inner = slice(reach, run.block.time_s.size - reach)
        block = run.block.part(inner.start, inner.stop)
        invalid = seat.invalid(run.block, self.settings.bridge_s)
        ends_s = self._ends_s(reach / rate_hz)
        tracks = {SEAT: [track[inner] for track in seat.tracks(run, invalid, self.settings.bridge_s)]}
        unsettled = around(np.isnan(tracks[SEAT][0]), 0, round(WARM_UP_S * rate_hz))
        self._check(tracks[SEAT][0], rate_hz)
        for name in MEASURED_SEGMENTS:
            read = [aligner.read(block.time_s, block.epoch_ns)[0] for aligner in aligners[name]]
            tracks[name] = [np.where(unsettled, np.nan, track) for track in read]
        levels = {name: self._level(vertical, rate_hz) for name, (vertical, *_) in tracks.items()}
        measured = np.column_stack([tracks[name][0] - levels[name] for name in MEASURED_SEGMENTS])
        channels = {name: self._channels(tracks[name], rate_hz) for name in SENSORS} if self._with_channels else {}
        return Recording(
            name=self.name,
            case=self.case,
            rate_hz=rate_hz,
            stamps_ns=block.stamps_ns.copy(),
            seat_mps2=block.low_passed_mps2 - levels[SEAT],
            measured_mps2=measured,
            warnings=(
                *([f"{SEAT}: {slow}"] if (slow := slow_seat(rate_hz)) else []),
                *self._moved(levels),
                *self._masked(unsettled, measured, rate_hz, ends_s),
                *_without_rates(tracks, rate_hz),
            ),
            channels=channels,
            mean_tilts={name: tilt for name, sensor in self._sensors.items() if (tilt := sensor.mean_tilt) is not None},
            seat_invalid_s=float(np.count_nonzero(np.isnan(tracks[SEAT][0])) / rate_hz),
            ends_s=ends_s,
            headings=headings_rad(channels, rate_hz),
            record=self.name,
            cutoff_hz=block.cutoff_hz,
            seat_lost=block.lost,
        )

    def _channels(self, tracks: Sequence[Floats], rate_hz: float) -> Channels:
        """A sensor's tracks without its vertical; NaN for a sensor that is not in the record."""
        if len(tracks) == 1:
            return Channels(np.full((tracks[0].size, 2), np.nan), None)
        horizontal = [track - self._level(track, rate_hz) for track in tracks[1:3]]
        return Channels(np.column_stack(horizontal), np.column_stack(tracks[3:]) if tracks[3:] else None)

    def _ends_s(self, seat_s: float) -> dict[str, float]:
        """`Recording.ends_s`, of a seat whose ends are cut by seat_s."""
        lost_s = {name: self._sensors[name].lost_at_ends_s() for name in MEASURED_SEGMENTS}
        return {name: max(0.0, of_sensor_s - seat_s) for name, of_sensor_s in lost_s.items()}

    def _masked(
        self, unsettled: Flags, measured_mps2: Floats, rate_hz: float, ends_s: Mapping[str, float]
    ) -> Iterator[str]:
        """The masked time, one line for the seat and each segment."""
        if unsettled.any():
            seconds = np.count_nonzero(unsettled) / rate_hz
            yield f"seat: invalid samples, so all segments are masked there and {WARM_UP_S:g} s on: {seconds:.2f} s"
        for name, column in zip(MEASURED_SEGMENTS, measured_mps2.T, strict=True):
            masked_s = np.count_nonzero(np.isnan(column)) / rate_hz
            if masked_s > REPORTED_S + 2.0 * ends_s[name] and self._sensors[name].runs:
                yield f"{name}: nothing usable in {masked_s:.2f} s of {column.size / rate_hz:.2f} s"

    def _check(self, seat_mps2: Floats, rate_hz: float) -> None:
        """Raise InputError for a run that no model can be fitted to; NaN counts as no excitation."""
        seconds, s = seat_mps2.size / rate_hz, self.settings
        if seconds < s.shortest_s:
            raise InputError(
                f"{seconds:.2f} s between rest, gaps and ends are too short: {s.shortest_s:g} s are needed,"
                f" {WARM_UP_S:g} s of them warm-up: record longer"
            )
        moving = seat_mps2[round(WARM_UP_S * rate_hz) :]
        moving = moving[~np.isnan(moving)]
        rms = float(moving.std()) if moving.size else 0.0
        if rms < s.least_seat_rms_mps2:
            raise InputError(
                f"the seat moves by {rms:.2g} m/s^2 rms after the warm-up, {s.least_seat_rms_mps2:g} are needed:"
                " without excitation nothing can be identified"
            )

    def _level(self, values: Floats, rate_hz: float) -> float:
        """The level to subtract from a channel; 0 where it is kept or unknown."""
        return 0.0 if self.settings.keep_level else level_mps2(values, rate_hz) or 0.0

    def _moved(self, levels: Mapping[str, float]) -> Iterator[str]:
        """The levels that have changed much since rest, one line each."""
        for name, level in levels.items():
            if abs(level) > self.settings.moved_level_mps2:
                yield f"{name}: its level has moved by {level:+.2f} m/s^2 since rest (subtracted): did it tilt?"

    def _labelled(self, recordings: list[Recording], left_out: list[tuple[float, str]]) -> list[Recording]:
        """The recordings, each with its name and what concerns all; left_out: seconds and reason of each part."""
        shared = [line for sensor in self._sensors.values() for line in sensor.warnings()]
        shared += [f"a part is left out: {reason}" for _, reason in left_out]
        several = len(recordings) > 1
        if several:
            shared.append(f"gaps of the seat split the record into {counted(len(recordings), 'recording')}")
        return [
            dataclasses.replace(
                recording,
                name=f"{self.name} ({number} of {len(recordings)})" if several else self.name,
                warnings=(*shared, *recording.warnings),
                left_out_s=sum(seconds for seconds, _ in left_out),
            )
            for number, recording in enumerate(recordings, 1)
        ]


def _without_rates(tracks: Mapping[str, Sequence[Floats]], rate_hz: float) -> Iterator[str]:
    """The time in which a sensor reads its acceleration but no angular rates, one line each."""
    for name, (vertical, *others) in tracks.items():
        if len(others) > 2:  # x and y come before the rates
            lost_s = np.count_nonzero(np.isnan(others[2]) & ~np.isnan(vertical)) / rate_hz
            if lost_s > REPORTED_S:
                yield f"{name}: no angular rates in {lost_s:.2f} s, which effects take as zero"


def representative(recordings: Sequence[Recording]) -> Recording:
    """The repetition of a case with the largest rms acceleration of the head (Zaman et al., 5.3).

    Raises InputError where the head was measured in none.
    """
    measured = [recording for recording in recordings if np.isfinite(_head(recording)).any()]
    if not measured:
        raise InputError("no recording has a head: the representative trial is the one with the largest head rms")
    return max(measured, key=lambda recording: float(np.nanmean(_head(recording) ** 2)))


def _head(recording: Recording) -> Floats:
    return recording.measured_mps2[recording.begin :, MEASURED_SEGMENTS.index(HEAD)]


def level_mps2(values: Floats, rate_hz: float) -> float | None:
    """The level of a channel (n,) with NaN, by its longest stretch without NaN; None where that is too short.

    A tapered mean: a plain one (Zaman et al., 5.2: all channels demeaned) contains the change of velocity between the
    ends.
    """
    begin, end = max(stretches(~np.isnan(values)), key=lambda stretch: stretch[1] - stretch[0], default=(0, 0))
    if end - begin < SHORTEST_LEVEL_S * rate_hz:
        return None
    taper = np.hanning(end - begin)
    return float(taper @ values[begin:end] / taper.sum())


def _mean_rate_hz(block: Block) -> float:
    """The mean rate of a run; the design rate for a run of one sample."""
    return (
        float((block.time_s.size - 1) / (block.time_s[-1] - block.time_s[0]))
        if block.time_s.size > 1
        else block.rate_hz
    )
