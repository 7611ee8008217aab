"""Pipeline: six raw streams in, predictions, aligned measurements, residual and exposure out; live and replay are one.

The live node pushes from callbacks, replay from a bag. Predictions need the seat alone and never wait; measurements and
residual wait for the slowest sensor, in stamp time and within a bound. Any cut into blocks and any interleaving of the
sensors within that bound gives the same frames.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import HEAD, SEAT, SENSORS
from biodyn_core.base.suggestions import did_you_mean
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.conditioned import Block, SensorStatus
from biodyn_core.conditioning.conditioner import Conditioner, Mode, SettingsOf, settings_for
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.tilt import Vector, first_axis_rad
from biodyn_core.conditioning.timelines import Timelines
from biodyn_core.exposure.exposure_store import ExposureCheckpoint, Lost
from biodyn_core.exposure.injury import Dri, Hic
from biodyn_core.exposure.limit_assessment import DataQuality, SeatExposure, seat_exposure
from biodyn_core.exposure.limits import EU_LIMITS, Limits
from biodyn_core.exposure.meters import Dose
from biodyn_core.exposure.sensor_meters import SensorMeters
from biodyn_core.pipeline.comparison import Compared
from biodyn_core.pipeline.counting import Counting
from biodyn_core.pipeline.frames import (
    NO_FRAMES,
    NO_MEASURED,
    NO_PREDICTED,
    Frames,
    MeasuredFrames,
    PredictedFrames,
    joined,
)
from biodyn_core.pipeline.interleaving import in_turns
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_core.pipeline.prediction import SeatPredictor

SLICE_S: Final = 0.25
"""What sensors still hold at the end is taken from them in turns of so much."""


@dataclass(frozen=True)
class Exposure:
    """Every figure of one span (since reset, or rolling). Whatever has not been counted yet is absent.

    sensors: Wk-weighted, before the low-pass; predicted and measured_low_passed are comparable with each other. A
    prediction counts at once and a measurement when it is compared; compared (by segment) counts the same samples of
    both. also: by weighting and sensor. residual: (rms m/s^2, rms over measured rms in percent) by segment.
    msdv_mps15 (since reset alone): motion sickness dose of the seat's vertical, Wf.
    """

    sensors: dict[str, Dose]
    predicted: dict[str, Dose]
    measured_low_passed: dict[str, Dose]
    dri: Dri | None
    hic15: Hic | None
    hic36: Hic | None
    msdv_mps15: float | None
    also: dict[str, dict[str, Dose]]
    residual: dict[str, tuple[float, float]]
    compared: dict[str, Compared]


class Latency(NamedTuple):
    """What an answer waits for beyond transport, seconds: the filter (taken off its stamp), samples to come, others."""

    filter_s: float
    look_ahead_s: float
    wait_s: float


class Pipeline:
    """`push(sensor, stamps_ns, samples)` gives frames, `finish()` those still waiting, `exposure()` the figures.

    gravity: of sensors whose whole record was searched for rest, as it can be offline.
    """

    def __init__(
        self,
        subject: Subject,
        conditioning: SettingsOf = None,
        settings: PipelineSettings | None = None,
        limits: Limits = EU_LIMITS,
        mode: Mode = "causal",
        gravity: Mapping[str, Gravity] | None = None,
    ) -> None:
        self.subject = subject
        self.settings = settings or PipelineSettings()
        self.limits = limits
        self.mode = mode
        _check_effects(subject)
        self._chain = Chain.of(subject)
        verticals, known = self.settings.verticals(), gravity or {}
        self._conditioners = {
            name: Conditioner(name, settings_for(name, conditioning), mode, verticals.get(name), known.get(name))
            for name in SENSORS
        }
        self._timelines = Timelines(self._conditioners, self.settings.wait_s)
        self._counting = Counting(self._conditioners, self._timelines, self.settings)
        self._seat: SeatPredictor | None = None
        self._whole_runs: list[tuple[str, Block]] = []
        self._early: dict[str, deque[Block]] = {name: deque() for name in SENSORS}

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> Frames:
        """Take raw specific force (n, 3) m/s^2 of one sensor with its stamps (n,) ns, in order of arrival."""
        if sensor not in self._conditioners:
            raise InputError(
                f"sensor {sensor!r} is unknown, known are {', '.join(SENSORS)}{did_you_mean(sensor, SENSORS)}"
            )
        return self._push(sensor, *self._counting.earlier.begun(sensor, stamps_ns, samples_mps2))

    def _push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> Frames:
        blocks = self._conditioners[sensor].push(stamps_ns, samples_mps2)
        self._timelines.note(sensor)
        if self.mode == "zero_phase":  # a whole run at once would leave those that still go on behind
            self._whole_runs += [(sensor, block) for block in blocks]
            return NO_FRAMES
        return self._take(sensor, blocks)

    def finish(self) -> Frames:
        """The record has ended: take what the sensors still hold, and answer every instant with what is there."""
        frames = [self._push(name, *samples) for name, samples in self._counting.earlier.waiting()]
        held = self._whole_runs + [(name, block) for name, c in self._conditioners.items() for block in c.finish()]
        self._whole_runs = []
        frames += [self._take(name, [block]) for name, block in _in_turns(held)]
        if self._seat:
            frames.append(Frames(NO_PREDICTED, self._seat.comparison.release(give_up=True)))
        return joined(frames)

    def reset(self) -> None:
        """Start exposure "since reset" anew; filters, model and rolling figures go on."""
        if self._seat:
            self._seat.reset()
        self._counting.reset()

    def resume(self, kept: ExposureCheckpoint) -> None:
        """Go on with the exposure of a run before this one, whose first sample is still to come.

        Raises InputError where it does not fit.
        """
        if SEAT in kept.sensors:  # whether what is kept beside it fits is to be known now, not amid the ride
            self._new_seat_side(1.0 / kept.sensors[SEAT].rest.period_s).resume(kept.beside, 0.0)
        self._counting.resume(kept)

    def kept(self, belongs: Mapping[str, str]) -> ExposureCheckpoint | None:
        """Exposure since reset as plain data, None while nothing was counted; belongs: see `ExposureCheckpoint`."""
        sensors = self._counting.kept()
        beside = self._seat.kept() if self._seat else self._counting.earlier.beside
        return ExposureCheckpoint(belongs, sensors, beside) if sensors else None

    def exposure(self, rolling: bool = False) -> Exposure:
        """The figures since reset, or over the last `window_s`, in which a sensor that is silent counts nothing."""
        counted = self._counting.rolling() if rolling else self._counting.since_reset()
        side = self._seat if SEAT in counted else None
        seat, head = counted.get(SEAT), counted.get(HEAD)
        return Exposure(
            sensors={name: meters.vertical(rolling) for name, meters in counted.items()},
            predicted=side.predicted(rolling) if side else {},
            measured_low_passed=side.measured(rolling, tuple(counted)) if side else {},
            dri=seat.dri(rolling) if seat else None,
            hic15=head.hic("hic15", rolling) if head else None,
            hic36=head.hic("hic36", rolling) if head else None,
            msdv_mps15=seat.msdv_mps15() if seat and not rolling else None,
            also=self._also(counted, rolling),
            residual=side.residual(rolling) if side else {},
            compared=side.compared(rolling) if side else {},
        )

    def _also(self, counted: Mapping[str, SensorMeters], rolling: bool) -> dict[str, dict[str, Dose]]:
        doses = {name: meters.also(rolling) for name, meters in counted.items()}
        return {w: {name: by[w] for name, by in doses.items()} for w in self.settings.weightings()}

    def seat(self, project: bool = False) -> SeatExposure | None:
        """The seat's three axes against the limits, since reset; None until the seat counts.

        project: to eight hours from less than 20 minutes too.
        """
        meters = self._counting.since_reset().get(SEAT)
        if meters is None:
            return None
        status = self.status(SEAT)
        grounds = DataQuality(
            lost=self.lost(SEAT),
            silent=self._timelines.silent_s(SEAT) > 0.0,
            gravity_mps2=status.gravity_mps2,
            fault=status.fault,
        )
        forward_rad = self._forward_rad(status.vertical)
        return seat_exposure(meters.vertical(), meters.plane(), forward_rad, self.limits, grounds, project)

    def _forward_rad(self, vertical: Vector | None) -> float | None:
        """The vehicle's forward direction in the seat's levelled axes; None where no yaw, or no vertical, tells it."""
        if self.settings.yaw_deg is None or vertical is None:
            return None
        return first_axis_rad(vertical) - math.radians(self.settings.yaw_deg)

    def status(self, sensor: str) -> SensorStatus:
        """What a sensor's conditioning has seen."""
        return self._conditioners[sensor].status()

    def lost(self, sensor: str) -> Lost:
        """What a sensor lost since reset."""
        return self._counting.lost(sensor)

    def seconds(self) -> float:
        """Length of the record by the samples that were accepted: one wild stamp does not count."""
        return max(conditioner.status().recorded_s for conditioner in self._conditioners.values())

    def clock_apart_s(self, sensor: str) -> float:
        """How far a sensor's clock was set ahead of the others', so that nothing can be compared; mostly 0."""
        return self._timelines.apart_s(sensor)

    def latency(self) -> dict[str, Latency]:
        """What every output waits for: predictions the seat alone, comparisons the slowest sensor, exposure nothing.

        Empty while the seat's rate is unknown.
        """
        if self._seat is None:
            return {}
        delay_s = self._conditioners[SEAT].delay_s
        rates = [meters.rate_hz for meters in self._counting.meters.values()]
        look_ahead_s = self._seat.comparison.look_ahead() / min(rates)
        compared = Latency(delay_s, look_ahead_s, self.settings.wait_s)
        return {
            "predicted": Latency(delay_s, 0.0, 0.0), "measured": compared, "residual": compared,
            "exposure": Latency(0.0, 0.0, 0.0),
        }  # fmt: skip

    @property
    def overdue(self) -> bool:
        """Whether the seat's next sample gives instants up: push first the samples that have arrived of all sensors."""
        return self._seat is not None and self._seat.comparison.overdue

    @property
    def cutoff_hz(self) -> float:
        """The low-pass's cut-off of the model's input and of comparisons."""
        return self._conditioners[SEAT].settings.cutoff_hz

    @property
    def substeps(self) -> int | None:
        """Integration steps per seat sample; None until the seat's rate is known."""
        return self._seat.stepper.substeps if self._seat else None

    @property
    def divergences(self) -> int:
        """At how many samples the model left its range, was put back to rest, and predicted nothing."""
        return self._seat.divergences if self._seat else 0

    @property
    def unpredicted_s(self) -> float:
        """Seconds since reset for which the model predicted nothing."""
        return self._seat.unpredicted / self._conditioners[SEAT].rate_hz if self._seat else 0.0

    @property
    def is_extrapolating(self) -> bool:
        """Whether the seat moved harder, since reset, than where the subject was fitted, as far as its file says."""
        fitted_mps2 = self.subject.provenance.get("seat_peak_mps2")
        if self._seat is None or not isinstance(fitted_mps2, (int, float)):
            return False
        return self._seat.seat_peak_mps2 > fitted_mps2

    def _take(self, sensor: str, blocks: list[Block]) -> Frames:
        """Count what a sensor's conditioning brought forth; the seat's is predicted from, the others' compared."""
        if not blocks:
            return NO_FRAMES
        self._counting.count(sensor, blocks)
        return self._predict(blocks) if sensor == SEAT else Frames(NO_PREDICTED, self._compare(sensor, blocks))

    def _predict(self, blocks: list[Block]) -> Frames:
        """Carry the chain over the seat's samples; what they complete in the comparison comes along."""
        if self._seat is None:
            rate_hz = self._conditioners[SEAT].rate_hz
            self._seat = self._new_seat_side(rate_hz)
            earlier = self._counting.earlier
            self._seat.resume(earlier.beside, earlier.between_s(SEAT))
            for sensor, early in self._early.items():
                if early:
                    self._seat.comparison.sensor(sensor, list(early))
            self._early.clear()
        side, gives_up = self._seat, self.overdue
        accel = [side.push(block) for block in blocks]
        measured = side.comparison.release() if gives_up or blocks[0].stamps_ns.size > 1 else NO_MEASURED
        if len(blocks) == 1:
            return Frames(PredictedFrames(blocks[0].stamps_ns, accel[0]), measured)
        stamps = np.concatenate([block.stamps_ns for block in blocks])
        return Frames(PredictedFrames(stamps, np.concatenate(accel)), measured)

    def _new_seat_side(self, rate_hz: float) -> SeatPredictor:
        return SeatPredictor(self._chain, rate_hz, self.settings.wait_s, self.settings.window_s)

    def _compare(self, sensor: str, blocks: list[Block]) -> MeasuredFrames:
        if self._seat is None:
            # Without a seat nothing is compared: no more is kept than its first instants could ask for.
            early = self._early[sensor]
            early.extend(blocks)
            while abs(early[-1].time_s[-1] - early[0].time_s[-1]) > 2.0 * self.settings.wait_s:
                early.popleft()
            return NO_MEASURED
        self._seat.comparison.sensor(sensor, blocks)
        return self._seat.comparison.release()


def _in_turns(held: list[tuple[str, Block]]) -> list[tuple[str, Block]]:
    """Blocks of several sensors cut into slices, so that none runs far ahead of the others."""
    turns = in_turns([block.epoch_ns * 1e-9 + block.time_s for _, block in held], SLICE_S)
    return [(held[number][0], held[number][1].part(begin, end)) for number, begin, end in turns]


def _check_effects(subject: Subject) -> None:
    """Raise InputError for an effect on predictions that needs more than the seat's vertical, sample by sample."""
    for applied in subject.effects:
        effect, needed = applied.effect, applied.effect.required_channels(applied.site)
        if not (applied.absent or effect.supports_live):
            raise InputError(
                f"{subject.name}: effect {effect.name} needs {', '.join(needed)}, which predictions sample by"
                " sample do not have: validate with it, or take it out of the subject's file"
            )
