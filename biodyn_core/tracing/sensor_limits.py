"""Limits of sensors: the errors that the data sheet of a good IMU allows, with the source of each.

An error within its limit is a finding about the sensor. It is the cause only if the verdict names it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from biodyn_core.effects import AppliedEffect
from biodyn_core.tracing.settings import TypicalSettings

_TYPICAL: Final = TypicalSettings()
"""The defaults, because a limit does not follow the settings of a trace."""

ICM_20948: Final = "TDK InvenSense ICM-20948, DS-000189 rev. 1.3, table 2"


@dataclass(frozen=True)
class SensorLimit:
    """The largest size of one fault, in `unit`, that a data sheet allows, and the size for given values."""

    limit: float
    unit: str
    source: str
    size: Callable[[Mapping[str, float]], float]


LIMITS: Final[Mapping[str, SensorLimit]] = {
    "gain": SensorLimit(
        0.005 + 0.005 + 20.0 * 0.00026,
        "",
        f"{ICM_20948}: 0.5 % initial, 0.5 % nonlinearity, 0.026 % per K over 20 K",
        lambda values: values["gain"],
    ),
    "tilt": SensorLimit(
        math.asin(0.05 + 0.02),
        "rad",
        f"{ICM_20948}: 50 mg zero-g output on a board, which tilts the level, and 2 % cross-axis sensitivity",
        lambda values: math.asin(min(1.0, math.hypot(values["lean_x"], values["lean_y"]))),
    ),
    "clock": SensorLimit(
        _TYPICAL.usual_clock_s,
        "s",
        "in no data sheet that we read; typical offset of a clock that is set once before an event",
        lambda values: values["delay_s"] + _TYPICAL.drift_s * values["drift"],
    ),
}
"""By the name of the effect. The size of a clock is its delay in the middle of an event."""


def within_limits(fault: AppliedEffect) -> bool:
    """Whether an effect is a fault of a sensor within its data sheet; False for any other effect."""
    known = LIMITS.get(fault.effect.name)
    return known is not None and abs(known.size(fault.values)) <= known.limit
