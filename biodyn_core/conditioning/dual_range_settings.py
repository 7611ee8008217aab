"""Settings of dual-range sensors."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings


@dataclass(frozen=True)
class DualRangeSettings:
    """Conditions under which the wide channel replaces the fine one."""

    saturation_mps2: float = setting(
        ConditioningSettings.saturation_mps2,
        "reading of one axis from which the low-g channel is at the end of its range",
        "m/s^2", 10.0, 5000.0,
    )  # fmt: skip
    compared_s: float = setting(
        5.0, "seconds before and after each shock in which the channels are compared", "s", 0.5, 60.0
    )

    def __post_init__(self) -> None:
        check_settings(self)
