"""Readings of the seat as on a vibration meter: counted time, aw and VDV by axis, MTVV and peak; for all pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from biodyn_core.base.segments import SEAT
from biodyn_core.base.wording import counted
from biodyn_ros.base.wording import HORIZONTAL

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


def meter_readings(document: dict[str, Any]) -> MeterReadings | None:
    """The readings from the mapping of `exposure.json`; None before the seat has counted anything."""
    seat, dose = document["seat"], document["sensors"].get(SEAT)
    if seat is None or dose is None:
        return None
    return MeterReadings(
        counted_s=seat["seconds"],
        axes=tuple(_axis(axis, seat, dose) for axis in AXES),
        mtvv_mps2=dose["mtvv_mps2"],
        peak_mps2=dose["peak_mps2"],
        lower_bound=dose["lower_bound"],
        note=HORIZONTAL[seat["horizontal"]],
        bounds=_bounds(seat, dose),
    )


def _axis(axis: str, seat: dict[str, Any], dose: dict[str, Any]) -> AxisReading:
    aw, vdv = seat["aw_weighted_mps2"], seat["vdv_weighted_mps175"]
    known = axis if axis in aw else "worst_direction"
    lower = dose["lower_bound"] if axis == "z" else seat["lower_bound"]
    return AxisReading(axis, aw.get(known), vdv.get(known), dose["aw_lower_bound"], lower)


def _bounds(seat: dict[str, Any], dose: dict[str, Any]) -> str:
    if dose["lower_bound"]:
        clipped = dose["clipped_samples"]
        and_clipped = f", {counted(clipped, 'sample')} clipped" if clipped else ""
        return f"≥ means at least: {dose['missing_s']:.3f} s are missing{and_clipped}."
    return "≥ means at least: a horizontal axis has no data." if seat["lower_bound"] else ""
