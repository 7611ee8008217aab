"""Seat axes: weighted exposure of the seat along its known axes, without and with the factors of ISO 2631-1:1997."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from biodyn_core.exposure.meters import Dose, HorizontalMeter

Horizontal = Literal["yaw_given", "worst_direction", "missing"]

HORIZONTAL_FACTOR: Final = 1.4
"""k of the horizontal axes for health, seated (ISO 2631-1:1997, 7.2.3; 2002/44/EC)."""

MIN_AXIS_SHARE: Final = 1e-6
"""An axis below this share of the strongest one carries no data: any real sensor has more noise."""


@dataclass(frozen=True)
class SeatAxes:
    """aw m/s^2 and VDV m/s^1.75 of the known axes, without k; missing_axes: number of horizontal axes without data."""

    aw_mps2: dict[str, float]
    vdv_mps175: dict[str, float]
    horizontal: Horizontal
    missing_axes: int

    @classmethod
    def of(
        cls, vertical: Dose, plane: HorizontalMeter, yaw_rad: float | None, missing_axes: int, suspect: bool = False
    ) -> SeatAxes:
        """Of the seat's meters; suspect: with suspect samples, as in the given vertical."""
        along = functools.partial(plane.along, suspect=suspect)
        up_aw, up_vdv = {"z": vertical.aw_mps2}, {"z": vertical.vdv_mps175}
        if missing_axes == 2:
            return cls(up_aw, up_vdv, "missing", missing_axes)
        if yaw_rad is None:
            aws, vdvs = along(np.linspace(0.0, np.pi, 361))
            aw, vdv = {"worst_direction": float(aws.max())}, {"worst_direction": float(vdvs.max())}
            return cls(aw | up_aw, vdv | up_vdv, "worst_direction", missing_axes)
        aws, vdvs = along([yaw_rad, yaw_rad + np.pi / 2.0])
        aw, vdv = dict(zip("xy", aws.tolist(), strict=True)), dict(zip("xy", vdvs.tolist(), strict=True))
        return cls(aw | up_aw, vdv | up_vdv, "yaw_given", missing_axes)

    @staticmethod
    def factor(axis: str) -> float:
        """The factor k of an axis."""
        return 1.0 if axis == "z" else HORIZONTAL_FACTOR

    def largest(self, figures: dict[str, float]) -> str:
        """The axis with the largest figure, k applied; z among equals."""
        return max(figures, key=lambda axis: (self.factor(axis) * figures[axis], axis))


def axes_without_data(vertical: Dose, plane: HorizontalMeter, suspect: bool) -> int:
    """The number of horizontal axes without data."""
    first, second = plane.along([0.0, np.pi / 2.0], suspect=suspect)[0].tolist()
    least = MIN_AXIS_SHARE * max(first, second, vertical.aw_mps2)
    return int(first <= least) + int(second <= least)
