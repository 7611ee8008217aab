"""Settings of recordings: requirements, masks and levels."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class RecordingSettings:
    """Requirements of a recording, and its masks and levels."""

    shortest_s: float = setting(3.0, "shortest recording, the 2 s of warm-up included", "s", 2.5, 3600.0)
    least_seat_rms_mps2: float = setting(
        0.1, "least rms of the seat, after the warm-up, that counts as excitation", "m/s^2", 0.0, 100.0
    )
    bridge_s: float = setting(
        0.004, "a straight line across a gap up to this long is kept, a longer one is masked", "s", 0.0, 0.05
    )
    keep_level: bool = setting(False, "keep the change of a channel's level since rest instead of subtracting it")
    keep_lean: bool = setting(False, "keep the vertical measured at rest, also if the gyro shows that the sensor tilts")
    moved_level_mps2: float = setting(
        0.3, "report a larger change of level since rest: by 14 deg of tilt, or a bias", "m/s^2", 0.0, 100.0
    )

    def __post_init__(self) -> None:
        check_settings(self)
