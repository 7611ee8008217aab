"""Exposure: every figure that the pipeline counts, since reset or over the rolling window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from biodyn_core.base.segments import HEAD, SEAT
from biodyn_core.exposure.injury import Dri, Hic
from biodyn_core.exposure.joint_forces import JointForce
from biodyn_core.exposure.meters import Dose
from biodyn_core.exposure.sensor_meters import SensorMeters
from biodyn_core.pipeline.comparison import Compared
from biodyn_core.pipeline.intervals import SegmentSpread
from biodyn_core.pipeline.prediction import SeatPredictor
from biodyn_core.signals.weighting import WeightingName


@dataclass(frozen=True)
class Exposure:
    """Every figure of one span (since reset, or rolling); figures without a counted sample are absent.

    Rolling figures of a sensor are absent too where all its samples are suspect.

    sensors: Wk-weighted, before the low-pass. predicted and measured_low_passed are comparable with each other: a
    prediction counts at once, a measurement when it is compared. compared: by segment, over the same samples of both.
    further: by weighting and sensor. residual: by segment, rms m/s^2 and rms over measured rms in percent. msdv_mps15:
    motion sickness dose of the seat's vertical, Wf, since reset alone. joint_forces: predicted, by the segment above
    the joint. spreads: of the predicted figures, by segment, for their intervals.
    """

    sensors: dict[str, Dose]
    predicted: dict[str, Dose]
    measured_low_passed: dict[str, Dose]
    dri: Dri | None
    hic15: Hic | None
    hic36: Hic | None
    msdv_mps15: float | None
    further: dict[str, dict[str, Dose]]
    residual: dict[str, tuple[float, float]]
    compared: dict[str, Compared]
    joint_forces: dict[str, JointForce]
    spreads: dict[str, SegmentSpread]


def exposure_of(
    meters: Mapping[str, SensorMeters],
    predictor: SeatPredictor | None,
    weightings: tuple[WeightingName, ...],
    rolling: bool,
) -> Exposure:
    """Read the figures from the sensors' meters and the predictor, whose figures need the seat's."""
    counted = {name: one for name, one in meters.items() if not rolling or one.has_sure_samples(rolling)}
    seat, head = counted.get(SEAT), counted.get(HEAD)
    side, sure_side = (predictor if SEAT in known else None for known in (meters, counted))
    further = {name: one.further(rolling) for name, one in counted.items()}
    return Exposure(
        sensors={name: one.vertical(rolling) for name, one in counted.items()},
        predicted=sure_side.predicted(rolling) if sure_side else {},
        measured_low_passed=side.measured(rolling, tuple(meters)) if side else {},
        dri=seat.dri(rolling) if seat else None,
        hic15=head.hic("hic15", rolling) if head else None,
        hic36=head.hic("hic36", rolling) if head else None,
        msdv_mps15=seat.msdv_mps15() if seat and not rolling else None,
        further={weighting: {name: doses[weighting] for name, doses in further.items()} for weighting in weightings},
        residual=side.residual(rolling) if side else {},
        compared=side.comparison.compared_doses(rolling) if side else {},
        joint_forces=sure_side.joint_forces(rolling) if sure_side else {},
        spreads=sure_side.spreads(rolling) if sure_side else {},
    )
