"""Exposure report: all results of one recording, for `exposure.json`, terminal and page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from biodyn_core.base.segments import HEAD, SEAT, SEGMENTS, SENSORS
from biodyn_core.base.wording import counted
from biodyn_core.body.model import Chain, slow_seat
from biodyn_core.body.origin import Origin, origin_of
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.conditioner import Mode
from biodyn_core.exposure.injury import Dri, Hic
from biodyn_core.exposure.joint_forces import JointForce, joint_weights
from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.limits import Limits
from biodyn_core.exposure.losses import Losses
from biodyn_core.exposure.meters import Dose
from biodyn_core.pipeline.fit_monitor import sensor_effects
from biodyn_core.pipeline.intervals import NO_WINDOW, SegmentSpread
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.run_status import RunStatus
from biodyn_ros.base.wording import (
    INTERVAL_OF_MISFIT,
    MODEL,
    REJECTED,
    compared_without,
    left_range,
    rejected,
    unchanging,
)
from biodyn_ros.reading.marks import Mark
from biodyn_ros.reports.intervals import DoseIntervals, ForceIntervals, dose_intervals, force_intervals, interval_notes

EDGE_S: Final = 0.1
"""Part of a comparison that may lack its sensor at the start and end of a record, at rest."""


class ChannelExposure(NamedTuple):
    """The dose of one channel, and the losses that make it a lower bound."""

    dose: Dose
    losses: Losses


class JointExposure(NamedTuple):
    """The force in one joint, the losses that make it a lower bound, and the weight of the body above, N."""

    force: JointForce
    losses: Losses
    static_n: float


class Residual(NamedTuple):
    """Rms of predicted minus measured, m/s^2, and in percent of the measured rms, None where that is zero."""

    rms_mps2: float
    nrmse_rms_percent: float | None


class MisfitTime(NamedTuple):
    """A time in which the model does not fit a segment, seconds after the seat's first sample; None while it lasts.

    ratio: rms of the residual over the usual one of the subject.
    """

    segment: str
    begin_s: float
    end_s: float | None
    ratio: float


@dataclass(frozen=True, eq=False)
class ExposureReport:
    """Results of one recording of run.seconds; channels without a counted sample are absent.

    uncounted_s: of the seat. sensors: Wk-weighted, before the low-pass. predicted and measured_low_passed: comparable
    with each other. also_weighted: by weighting and sensor. seat: None before it has counted. joint_forces: predicted,
    by the segment above the joint. origin: of the subject's parameters. spreads: of the predicted figures, by segment;
    no_interval: why there is none, empty if there are. not_monitored: why it is unknown whether the model fits, empty
    if it is known; monitored: the segments for which it is. warnings to is_made_by_model: of the bag; times: the stamps
    used, by sensor.
    """

    bag: str
    subject: str
    mass_matrix: str
    path: Mode
    window_s: float
    limits: Limits
    run: RunStatus
    uncounted_s: float
    sensors: Mapping[str, ChannelExposure]
    predicted: Mapping[str, ChannelExposure]
    measured_low_passed: Mapping[str, ChannelExposure]
    also_weighted: Mapping[str, Mapping[str, ChannelExposure]]
    seat: SeatExposure | None
    msdv_mps15: float | None
    dri: Dri | None
    hic15: Hic | None
    hic36: Hic | None
    residual: Mapping[str, Residual]
    joint_forces: Mapping[str, JointExposure]
    body_mass_kg: float
    origin: Origin = "unknown"
    spreads: Mapping[str, SegmentSpread] = field(default_factory=dict)
    no_interval: str = ""
    misfits: Sequence[MisfitTime] = ()
    not_monitored: str = ""
    monitored: Sequence[str] = ()
    warnings: Sequence[str] = ()
    times: Mapping[str, str] = field(default_factory=dict)
    marks: Sequence[Mark] = ()
    is_made_by_model: bool = False

    @property
    def prediction_status(self) -> str:
        """Held-out errors of a fit are of another vehicle and seat, so no prediction is validated."""
        return "extrapolated" if self.run.is_extrapolating else "not_validated"

    def dose_intervals(self, segment: str) -> DoseIntervals:
        """The 95 % intervals of a segment's predicted weighted acceleration."""
        return dose_intervals(self.predicted[segment].dose, self.spreads.get(segment))

    def force_intervals(self, segment: str) -> ForceIntervals:
        """The 95 % intervals of the predicted force in the joint below a segment."""
        return force_intervals(self.joint_forces[segment].force, self.spreads.get(segment))

    @property
    def interval_notes(self) -> list[str]:
        """What the intervals of the predictions are, or why there are none: sentences."""
        has_bounds = any(channel.losses.lower_bound for channel in self.predicted.values())
        notes = interval_notes(self.subject, self.origin, self.no_interval, has_bounds)
        return [*notes, INTERVAL_OF_MISFIT] if self.misfits and not self.no_interval else notes

    @property
    def lifts_off(self) -> bool:
        """Whether the tension between seat and pelvis exceeds the static weight, which a seat cannot exert."""
        seat_joint = self.joint_forces.get(SEGMENTS[0])
        return seat_joint is not None and seat_joint.force.tension_n > seat_joint.static_n

    @property
    def is_dri_lower_bound(self) -> bool:
        """Whether samples of the seat are missing, clipped or suspect."""
        return SEAT in self.sensors and self.sensors[SEAT].losses.lower_bound

    @property
    def is_hic_lower_bound(self) -> bool:
        """Whether samples of the head are missing, clipped or suspect, or an axis is dead: HIC is of the resultant."""
        if HEAD not in self.sensors:
            return False
        losses = self.sensors[HEAD].losses
        return losses.lower_bound or losses.dead_s > 0.0


def exposure_report(pipeline: Pipeline, bag: str = "", project: bool = False) -> ExposureReport:
    """Gather the figures of a pipeline since reset; project: to 8 h from under 20 minutes too."""
    since, run = pipeline.exposure(), pipeline.run_status()
    lost = {name: pipeline.losses(name) for name in SENSORS}
    unpredicted = _with_absent(lost[SEAT], run.unpredicted_s)  # predictions use the seat alone and have its losses
    if pipeline.predictor:
        unpredicted = unpredicted._replace(suspect_s=pipeline.predictor.suspect_s())
    low_passed = since.measured_low_passed
    compared = {name: _lost_compared(name, low_passed, lost) for name in low_passed}
    return ExposureReport(
        bag=bag,
        subject=pipeline.subject.name,
        mass_matrix=pipeline.subject.mass_matrix,
        path=pipeline.mode,
        window_s=pipeline.settings.window_s,
        limits=pipeline.limits,
        run=run,
        uncounted_s=pipeline.status(SEAT).uncounted_s if SEAT in since.sensors else run.seconds,
        sensors=_channels(since.sensors, lost),
        predicted=_channels(since.predicted, dict.fromkeys(since.predicted, unpredicted)),
        measured_low_passed=_channels(low_passed, compared),
        also_weighted={weighting: _channels(doses, lost) for weighting, doses in since.further.items()},
        seat=pipeline.seat(project),
        msdv_mps15=since.msdv_mps15,
        dri=since.dri,
        hic15=since.hic15,
        hic36=since.hic36,
        residual={
            name: Residual(rms, percent if math.isfinite(percent) else None)
            for name, (rms, percent) in since.residual.items()
        },
        joint_forces=_joints(since.joint_forces, pipeline.subject, unpredicted),
        body_mass_kg=pipeline.subject.body_mass_kg,
        origin=origin_of(pipeline.subject),
        spreads=since.spreads,
        no_interval="" if since.spreads else pipeline.no_interval or NO_WINDOW,
        misfits=list(_misfits(pipeline)),
        not_monitored=pipeline.fit_unknown,
        monitored=pipeline.fit_monitor.tested,
    )


def sensor_warnings(pipeline: Pipeline, sensors: Iterable[str]) -> list[str]:
    """Warnings about the conditioning of these sensors and about the model, one line each."""
    lines, left_out = [], sensor_effects(pipeline.subject)
    for name in sensors:
        status = pipeline.status(name)
        if status.fault:
            lines.append(status.fault)
        elif status.rate_hz is None:
            lines.append(f"{name}: nothing counted, gravity was not found")
        lines += [f"{name}: {text}" for text in status.warnings]
        if name in left_out:
            lines.append(f"{name}: {compared_without(left_out[name])}")
        if status.set_back_s > 0.0:
            lines.append(f"{name}: its stamps jumped back by {status.set_back_s:.3f} s in total: was its clock set?")
        if status.rejected:
            causes = rejected({cause: getattr(status, cause) for cause in REJECTED})
            lines.append(f"{name}: {counted(status.rejected, 'sample')} rejected: {causes}")
        if status.unusable_s > 0.0:
            lines.append(f"{name}: the last {status.unusable_s:.3f} s have no usable sample")
        lines += [f"{name}: {text}" for text in unchanging(status.flat, status.dead)]
        lost = pipeline.losses(name)
        if lost.clipped:
            lines.append(f"{name}: {counted(lost.clipped, 'sample')} clipped: doses and peaks are lower bounds")
        if lost.missing_s > 0.0:
            lines.append(f"{name}: {lost.missing_s:.3f} s missing: doses and peaks are lower bounds")
        if lost.suspect_s > 0.0:
            lines.append(f"{name}: {lost.suspect_s:.3f} s after losses within strong motion left out: lower bounds")
    return [*lines, *_model_warnings(pipeline)]


def _model_warnings(pipeline: Pipeline) -> Iterator[str]:
    run, seat_hz = pipeline.run_status(), pipeline.status(SEAT).rate_hz
    if seat_hz is not None and (slow := slow_seat(seat_hz)):
        yield f"{SEAT}: {slow}"
    if run.divergences:
        yield f"{MODEL}: {left_range(run.divergences)}"
    if run.unpredicted_s > 0.0:
        yield (
            f"{MODEL}: {run.unpredicted_s:.2f} s of predictions are not counted, in which it settles from rest:"
            " measured figures contain this time"
        )


def _channels(doses: Mapping[str, Dose], lost: Mapping[str, Losses]) -> dict[str, ChannelExposure]:
    """Doses with their losses; the seconds that are left out are suspect, also where a weighting settles."""
    return {name: ChannelExposure(dose, lost[name]._replace(suspect_s=dose.left_out_s)) for name, dose in doses.items()}


def _misfits(pipeline: Pipeline) -> Iterator[MisfitTime]:
    first_ns = pipeline.conditioners[SEAT].first_ns or 0
    for one in pipeline.fit_monitor.misfits():
        end_s = None if one.end_ns is None else 1e-9 * (one.end_ns - first_ns)
        yield MisfitTime(one.segment, max(0.0, 1e-9 * (one.begin_ns - first_ns)), end_s, one.ratio)


def _joints(forces: Mapping[str, JointForce], subject: Subject, lost: Losses) -> dict[str, JointExposure]:
    static_n = joint_weights(Chain.of(subject).loaded_mass_kg(subject.effects))
    return {name: JointExposure(force, lost, static_n[name]) for name, force in forces.items()}


def _with_absent(lost: Losses, seconds: float) -> Losses:
    return lost._replace(absent_s=lost.absent_s + seconds)


def _lost_compared(name: str, doses: Mapping[str, Dose], lost: Mapping[str, Losses]) -> Losses:
    """Losses of a low-passed sensor: with those of the seat, and instants without a sample."""
    if name == SEAT:
        return lost[SEAT]
    alone_s = doses[SEAT].seconds - doses[name].seconds if SEAT in doses else 0.0
    seat_s = lost[SEAT].missing_s + (alone_s if alone_s > EDGE_S else 0.0)
    return _with_absent(lost[name], max(0.0, seat_s - lost[name].missing_s))
