"""Settings of the pipeline, with those that are lists in one text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import check_settings, setting
from biodyn_core.base.suggestions import did_you_mean, known_are

if TYPE_CHECKING:
    from biodyn_core.conditioning.tilt import Vector
    from biodyn_core.signals.weighting import WeightingName


@dataclass(frozen=True)
class PipelineSettings:
    """Settings of the pipeline itself; conditioning has its own."""

    window_s: float = setting(10.0, "length of the rolling window", "s", 0.5, 3600.0)
    wait_s: float = setting(1.0, "how long measurements wait for the slowest sensor, in stamp time", "s", 0.3, 10.0)
    yaw_deg: float | None = setting(
        None, "angle from the vehicle's forward direction to the seat sensor's first axis", "deg", -360.0, 360.0
    )
    vertical: str = setting(
        "", "direction of up in the axes of sensors, instead of that at rest, such as 'seat=0,0,1 head=-1,0,0'"
    )
    also_weighted: str = setting("", "further weightings of every sensor's vertical, such as 'Wb Wj'")

    def __post_init__(self) -> None:
        check_settings(self)
        self.verticals()
        self.weightings()

    def verticals(self) -> dict[str, Vector]:
        """The given verticals by sensor; raises InputError for a part that is none."""
        from biodyn_core.base.segments import SENSORS

        given: dict[str, Vector] = {}
        for part in self.vertical.split():
            sensor, _, axes = part.partition("=")
            try:
                x, y, z = (float(value) for value in axes.split(","))
            except ValueError:
                x = y = z = math.nan
            if sensor not in SENSORS or not 0.0 < x * x + y * y + z * z < math.inf:
                near = "" if sensor in SENSORS else did_you_mean(sensor, SENSORS)
                known = ", ".join(SENSORS)
                raise InputError(f"vertical {part!r}: expected sensor=x,y,z with a sensor of {known}{near}")
            given[sensor] = x, y, z
        return given

    def weightings(self) -> tuple[WeightingName, ...]:
        """The further weightings; raises InputError for an unknown one."""
        from biodyn_core.signals.weighting import CURVES

        names = self.also_weighted.replace(",", " ").split()
        for name in names:
            if name not in CURVES:
                raise InputError(f"also_weighted {name!r} is no weighting, {known_are(name, CURVES)}")
        return tuple(name for name in CURVES if name in names)
