"""95 % intervals of the predicted figures of one segment, and what they are."""

from __future__ import annotations

from typing import NamedTuple

from biodyn_core.body.origin import Origin
from biodyn_core.exposure.figure_spread import interval
from biodyn_core.exposure.joint_forces import JointForce
from biodyn_core.exposure.meters import Dose
from biodyn_core.pipeline.intervals import SegmentSpread
from biodyn_ros.base.wording import INTERVAL_MEANS, INTERVAL_OF_BOUND, INTERVAL_OF_GROUP

Interval = tuple[float, float]
"""Lower and upper end."""


class DoseIntervals(NamedTuple):
    """Of a segment's weighted acceleration; None where there is no interval."""

    aw_interval_mps2: Interval | None
    vdv_interval_mps175: Interval | None
    peak_interval_mps2: Interval | None


class ForceIntervals(NamedTuple):
    """Of the force in the joint below a segment; None where there is no interval."""

    compression_interval_n: Interval | None
    tension_interval_n: Interval | None
    rms_interval_n: Interval | None


def dose_intervals(dose: Dose, spread: SegmentSpread | None) -> DoseIntervals:
    """The intervals of a predicted dose; spread: None if it is not known."""
    if spread is None:
        return DoseIntervals(None, None, None)
    return DoseIntervals(
        figure_interval(dose.aw_mps2, spread.accel.of_means),
        figure_interval(dose.vdv_mps175, spread.accel.of_vdv),
        figure_interval(dose.peak_mps2, spread.accel.of_peaks),
    )


def force_intervals(force: JointForce, spread: SegmentSpread | None) -> ForceIntervals:
    """The intervals of a predicted joint force; spread: None if it is not known."""
    if spread is None:
        return ForceIntervals(None, None, None)
    return ForceIntervals(
        figure_interval(force.compression_n, spread.force.of_compression),
        figure_interval(force.tension_n, spread.force.of_tension),
        figure_interval(force.rms_n, spread.force.of_rms),
    )


def figure_interval(value: float, spread: float | None) -> Interval | None:
    """The interval of a figure; None for zero, which has no logarithm, and for an unknown spread."""
    return interval(value, spread) if spread is not None and value > 0.0 else None


def interval_notes(subject: str, origin: Origin, no_interval: str, has_bounds: bool) -> list[str]:
    """What the intervals of a subject's predictions are, or why there are none: sentences.

    has_bounds: whether predicted figures are lower bounds.
    """
    if no_interval:
        return [f"Predictions for {subject} have no 95 % interval: {no_interval}."]
    means = INTERVAL_OF_GROUP if origin == "group" else INTERVAL_MEANS
    return [means, INTERVAL_OF_BOUND] if has_bounds else [means]
