"""Shock ratios: ratios of ISO 2631-1:1997 above which the rms of the acceleration does not suffice."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from biodyn_core.exposure.meters import Dose
from biodyn_core.exposure.seat_axes import SeatAxes


@dataclass(frozen=True)
class ShockRatio:
    """A ratio with its threshold for additional evaluation (ISO 2631-1:1997); value None if it was not measured."""

    name: str
    value: float | None
    threshold: float
    clause: str

    @property
    def exceeded(self) -> bool | None:
        """Whether the value is above the threshold; None where it is unknown."""
        return None if self.value is None else self.value > self.threshold


def shock_ratios(sure: tuple[Dose, SeatAxes], whole: tuple[Dose, SeatAxes], axis: str) -> tuple[ShockRatio, ...]:
    """The ratios of ISO 2631-1:1997 above which rms is not enough, without and with suspect samples.

    Unknown where one of the two exceeds the threshold and the other does not; otherwise the one nearer to it.
    """
    found = []
    for one, other in zip(_ratios(*sure, axis), _ratios(*whole, axis), strict=True):
        if one.exceeded is None or one.exceeded != other.exceeded:
            found.append(dataclasses.replace(one, value=None))
        else:
            found.append(min(one, other, key=lambda ratio: abs((ratio.value or 0.0) - ratio.threshold)))
    return tuple(found)


def _ratios(vertical: Dose, axes: SeatAxes, axis: str) -> tuple[ShockRatio, ...]:
    """Peak and MTVV exist for the vertical alone; the larger MTVV is used, because 6.3.3 does not specify the average.

    None without exposure along the axis.
    """
    aw, vdv = axes.aw_mps2.get(axis, 0.0), axes.vdv_mps175.get(axis, 0.0)
    steady = aw * vertical.seconds**0.25
    up = steady > 0.0 and axis == "z"
    return (
        ShockRatio("crest_factor", vertical.crest_factor if up else None, 9.0, "6.2.2"),
        ShockRatio("mtvv_over_aw", vertical.mtvv_mps2 / aw if up else None, 1.5, "6.3.3"),
        ShockRatio("vdv_over_aw_t", vdv / steady if steady > 0.0 else None, 1.75, "6.3.3"),
    )
