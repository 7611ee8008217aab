"""Pipeline: raw streams of six sensors in, predictions, aligned measurements, residuals and exposure out.

The live node pushes from callbacks, replay from a bag. Predictions need the seat alone and never wait; measurements and
residuals wait for the slowest sensor, in stamp time and within a bound. Any cut into blocks and any interleaving of the
sensors within that bound gives the same frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.base.suggestions import known_are
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.conditioned import Block, SensorStatus
from biodyn_core.conditioning.conditioner import Conditioner, Mode, SettingsOf, settings_for
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.conditioning.tilt import Vector, first_axis_rad
from biodyn_core.conditioning.timelines import Timelines
from biodyn_core.effects import beyond_vertical
from biodyn_core.exposure.data_quality import DataQuality
from biodyn_core.exposure.limit_assessment import SeatExposure, seat_exposure
from biodyn_core.exposure.limits import EU_LIMITS, Limits
from biodyn_core.exposure.losses import Losses
from biodyn_core.pipeline.comparison import EarlyBlocks
from biodyn_core.pipeline.exposure import Exposure, exposure_of
from biodyn_core.pipeline.exposure_counter import ExposureCounter
from biodyn_core.pipeline.fit_monitor import FitMonitor, monitored_laws
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
from biodyn_core.pipeline.intervals import prediction_spread
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_core.pipeline.prediction import SeatPredictor
from biodyn_core.pipeline.run_status import NO_LATENCY, Latency, RunStatus

SLICE_S: Final = 0.25
"""At the end, the blocks that sensors still hold are taken in turns of this length."""


class Pipeline:
    """`push` samples and get frames, `finish` for the frames that still wait, `exposure` and `seat` for the figures.

    Each sample is conditioned and counted; the seat's are predicted from, the others' compared with the prediction.

    gravity: of sensors whose whole record was searched for rest, as is possible offline.
    conditioners, timelines, counter and predictor (None until the seat's rate is known) are the stages. fit_monitor
    tests the residual; not_monitored: why it does not, empty if it does. no_interval: why predictions have none.
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
        _check_effects(subject)
        self.subject, self.limits, self.mode = subject, limits, mode
        self.settings = settings or PipelineSettings()
        verticals, known = self.settings.verticals(), gravity or {}
        self.conditioners = {
            name: Conditioner(name, settings_for(name, conditioning), mode, verticals.get(name), known.get(name))
            for name in SENSORS
        }
        # With known gravity a sensor sends nothing until its clock is known, after `rest_patience_s` at the latest.
        waiting = (one for one in self.conditioners.values() if one.gravity is not None)
        clock_s = max((one.settings.rest_patience_s for one in waiting), default=0.0)
        self._wait_s = self.settings.wait_s + clock_s
        self.timelines = Timelines(self.conditioners, self.settings.wait_s)
        self.counter = ExposureCounter(self.conditioners, self.timelines, self.settings)
        self.predictor: SeatPredictor | None = None
        laws, self.not_monitored = monitored_laws(subject)
        self.fit_monitor = FitMonitor(laws)
        self._spread, self.no_interval = prediction_spread(subject)
        self._chain = Chain.of(subject)
        self._early = EarlyBlocks(2.0 * self._wait_s)
        self._whole_runs: list[tuple[str, Block]] = []

    # --- samples in, frames out --------------------------------------------------------------------------------------

    def push(self, sensor: str, stamps_ns: Integers, samples_mps2: Floats) -> Frames:
        """Take raw specific force (n, 3) m/s^2 of one sensor with its stamps (n,) ns, in order of arrival."""
        if sensor not in self.conditioners:
            raise InputError(f"sensor {sensor!r} is unknown, {known_are(sensor, SENSORS)}")
        blocks = self.conditioners[sensor].push(stamps_ns, samples_mps2)
        self.timelines.update(sensor)
        if self.mode == "zero_phase":  # a whole run at once would overtake the sensors whose runs still go on
            self._whole_runs += [(sensor, block) for block in blocks]
            return NO_FRAMES
        return self._monitored(self._process(sensor, blocks))

    def finish(self) -> Frames:
        """End the record: process the remaining samples of the sensors and interpolate every pending instant."""
        held = self._whole_runs + [(name, block) for name, c in self.conditioners.items() for block in c.finish()]
        self._whole_runs = []
        frames = [self._process(name, [block]) for name, block in _in_turns(held)]
        self.counter.finish()
        if self.predictor:
            frames.append(Frames(NO_PREDICTED, self.predictor.comparison.release(give_up=True)))
        return self._monitored(joined(frames))

    def _monitored(self, frames: Frames) -> Frames:
        if self.predictor:  # without one there is no rate, and nothing to compare
            self.fit_monitor.push(frames.measured, self.conditioners[SEAT].rate_hz)
        return frames

    def _process(self, sensor: str, blocks: list[Block]) -> Frames:
        if not blocks:
            return NO_FRAMES
        self.counter.count(sensor, blocks)
        return self._predict(blocks) if sensor == SEAT else Frames(NO_PREDICTED, self._compare(sensor, blocks))

    def _predict(self, blocks: list[Block]) -> Frames:
        """Carry the chain over the seat's samples, and release the instants that they complete in the comparison."""
        if self.predictor is None:
            self.predictor = self._first_predictor()
        # The other sensors release what they complete; here an attempt would cost as much as the prediction.
        predictor, releases = self.predictor, self.overdue
        predicted = [PredictedFrames(block.stamps_ns, *predictor.push(block)) for block in blocks]
        measured = predictor.comparison.release() if releases else NO_MEASURED
        if len(predicted) == 1:
            return Frames(predicted[0], measured)
        return Frames(PredictedFrames(*map(np.concatenate, zip(*predicted, strict=True))), measured)

    def _first_predictor(self) -> SeatPredictor:
        predictor = self.new_predictor(self.conditioners[SEAT].rate_hz)
        predictor.resume(self.counter.initial.prediction, self.counter.break_s(SEAT))
        self._early.move_to(predictor.comparison)
        return predictor

    def new_predictor(self, rate_hz: float) -> SeatPredictor:
        """A predictor at rest whose figures start at zero."""
        begins_at_rest = self.conditioners[SEAT].begins_at_rest
        return SeatPredictor(self._chain, rate_hz, self._wait_s, self.settings.window_s, self._spread, begins_at_rest)

    def _compare(self, sensor: str, blocks: list[Block]) -> MeasuredFrames:
        if self.predictor is None:
            self._early.add(sensor, blocks)
            return NO_MEASURED
        self.predictor.comparison.sensor(sensor, blocks)
        return self.predictor.comparison.release()

    def reset(self) -> None:
        """Set exposure "since reset" to zero; filters, model and rolling figures go on."""
        if self.predictor:
            self.predictor.reset()
        self.counter.reset()

    @property
    def overdue(self) -> bool:
        """Whether the seat's next sample gives up instants; first push the samples that have arrived of all sensors."""
        return self.predictor is not None and self.predictor.comparison.overdue

    # --- figures and status ------------------------------------------------------------------------------------------

    def exposure(self, rolling: bool = False, silent_s: Mapping[str, float] | None = None) -> Exposure:
        """The figures since reset, or over the last `window_s`, without the sensors that are silent for that long.

        silent_s: time since a sensor's last message, by another clock than the stamps.
        """
        meters = self.counter.rolling(silent_s) if rolling else self.counter.since_reset()
        if rolling and self.predictor:
            self.predictor.end_window(max(self.counter.absence_s(SEAT), (silent_s or {}).get(SEAT, 0.0)))
        return exposure_of(meters, self.predictor, self.settings.weightings(), rolling)

    def seat(self, project: bool = False) -> SeatExposure | None:
        """Assess the seat's three axes since reset against the limits; None until the seat counts.

        project: to eight hours from less than 20 minutes too.
        """
        meters, status = self.counter.since_reset().get(SEAT), self.status(SEAT)
        if meters is None:
            return None
        losses, is_silent = self.losses(SEAT), self.timelines.silent_s(SEAT) > 0.0
        quality = DataQuality(losses, is_silent, status.gravity_mps2, status.fault, status.unusable_s)
        yaw_rad = self._forward_rad(status.vertical)
        vertical, *complete = meters.vertical(), meters.vertical_with_suspect(), meters.vertical_with_suspect(True)
        if losses.suspect_s == 0.0 and complete[0] == complete[1]:
            complete = []
        return seat_exposure(vertical, meters.plane(), yaw_rad, self.limits, quality, project, *complete)

    def _forward_rad(self, vertical: Vector | None) -> float | None:
        """The vehicle's forward direction in the axes of the seat's horizontal meter; None where yaw is unknown.

        Without a vertical the meter has initial exposure alone, which is along the seat's own axes.
        """
        if self.settings.yaw_deg is None:
            return None
        return (first_axis_rad(vertical) if vertical else 0.0) - math.radians(self.settings.yaw_deg)

    def status(self, sensor: str) -> SensorStatus:
        """The state of a sensor's conditioning."""
        return self.conditioners[sensor].status()

    def losses(self, sensor: str) -> Losses:
        """The losses of a sensor since reset."""
        return self.counter.losses(sensor)

    def run_status(self) -> RunStatus:
        """The state of the model and of the outputs."""
        predictor, seat = self.predictor, self.conditioners[SEAT]
        fitted_mps2 = self.subject.provenance.get("seat_peak_mps2")
        peak_mps2 = predictor.seat_peak_mps2 if predictor else 0.0
        return RunStatus(
            seconds=max(conditioner.status().recorded_s for conditioner in self.conditioners.values()),
            cutoff_hz=seat.settings.cutoff_hz,
            substeps=predictor.stepper.substeps if predictor else None,
            divergences=predictor.divergences if predictor else 0,
            unpredicted_s=predictor.unpredicted / seat.rate_hz if predictor else 0.0,
            is_extrapolating=isinstance(fitted_mps2, (int, float)) and peak_mps2 > fitted_mps2,
            latency=self._latency(predictor) if predictor else {},
        )

    @property
    def fit_unknown(self) -> str:
        """Why it is unknown whether the model fits; empty if it is known."""
        return self.not_monitored or self.fit_monitor.unknown

    def _latency(self, predictor: SeatPredictor) -> dict[str, Latency]:
        delay_s = self.conditioners[SEAT].delay_s
        rates = [meters.rate_hz for meters in self.counter.meters.values()]
        look_ahead_s = predictor.comparison.look_ahead() / min(rates)
        compared = Latency(delay_s, look_ahead_s, self._wait_s)
        predicted = Latency(delay_s, 0.0, 0.0)
        return {"predicted": predicted, "measured": compared, "residual": compared, "exposure": NO_LATENCY}


def _in_turns(held: list[tuple[str, Block]]) -> list[tuple[str, Block]]:
    """Cut the blocks of several sensors into slices in order of time, so that no sensor runs far ahead of another."""
    turns = in_turns([block.epoch_ns * 1e-9 + block.time_s for _, block in held], SLICE_S)
    return [(held[number][0], held[number][1].part(begin, end)) for number, begin, end in turns]


def _check_effects(subject: Subject) -> None:
    """Raise InputError for an effect on predictions that needs more than the seat's vertical, sample by sample."""
    if found := beyond_vertical(subject.effects):
        needed = ", ".join(found.effect.required_channels(found.site))
        raise InputError(
            f"{subject.name}: effect {found.effect.name} needs {needed}, which predictions sample by sample do not"
            " have: validate with it, or take it out of the subject's file"
        )
