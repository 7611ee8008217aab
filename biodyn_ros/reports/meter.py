"""Readings of the seat as on a vibration meter: counted time, aw and VDV by axis, MTVV and peak; for all pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.losses import Losses
from biodyn_ros.base.wording import losses_text
from biodyn_ros.reports.exposure_report import ChannelExposure
from biodyn_ros.reports.verdict import HORIZONTAL

AXES: Final = ("x", "y", "z")


@dataclass(frozen=True)
class AxisReading:
    """One axis, weighted, without the factor k; None without data."""

    axis: str
    aw_mps2: float | None
    vdv_mps175: float | None
    aw_lower_bound: bool
    vdv_lower_bound: bool


@dataclass(frozen=True)
class MeterReadings:
    """Since reset: seconds counted, three axes, MTVV and peak of the vertical.

    lower_bound: of MTVV and peak. note: source of the horizontal axes. bounds: reason for lower bounds, empty if there
    is none.
    """

    counted_s: float
    axes: tuple[AxisReading, ...]
    mtvv_mps2: float
    peak_mps2: float
    lower_bound: bool
    note: str
    bounds: str


def meter_readings(seat: SeatExposure | None, channel: ChannelExposure | None) -> MeterReadings | None:
    """The readings of the seat and of its vertical channel; None before it has counted anything."""
    if seat is None or channel is None:
        return None
    dose, losses = channel
    return MeterReadings(
        counted_s=seat.seconds,
        axes=tuple(axis_reading(axis, seat, losses) for axis in AXES),
        mtvv_mps2=dose.mtvv_mps2,
        peak_mps2=dose.peak_mps2,
        lower_bound=losses.lower_bound,
        note=HORIZONTAL[seat.horizontal],
        bounds=_bounds(seat, losses),
    )


def axis_reading(axis: str, seat: SeatExposure, losses: Losses) -> AxisReading:
    """The reading of x, y, z or `worst_direction`."""
    aw, vdv = seat.aw_weighted_mps2, seat.vdv_weighted_mps175
    known = axis if axis in aw else "worst_direction"
    lower = losses.lower_bound if axis == "z" else seat.lower_bound
    dead = axis != "z" and losses.dead_s > 0.0
    return AxisReading(axis, aw.get(known), vdv.get(known), losses.mean_lower_bound or dead, lower)


def _bounds(seat: SeatExposure, losses: Losses) -> str:
    if losses.lower_bound:
        return f"≥ means at least: {losses_text(losses)}."
    return "≥ means at least: a horizontal axis has no data." if seat.lower_bound else ""
