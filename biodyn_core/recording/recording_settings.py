"""Settings of recordings: requirements, masks and levels."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class RecordingSettings:
    """Requirements of a recording, and its masks and levels."""

    shortest_s: float = setting(3.0, "shortest recording, the 2 s of warm-up included", "s", 2.5, 3600.0)
    least_seat_rms_mps2: float = setting(
        0.1, "least rms of the seat, behind the warm-up, that counts as excitation", "m/s^2", 0.0, 100.0
    )
    bridge_s: float = setting(
        0.004, "a straight line across a gap up to this long is kept, a longer one is masked", "s", 0.0, 0.05
    )
    keep_level: bool = setting(False, "keep what a channel's level has moved by since rest, instead of taking it off")
    keep_lean: bool = setting(
        False, "keep verticals along the axis that was up at rest, though a gyro says that its sensor leans"
    )
    moved_level_mps2: float = setting(
        0.3, "a level moved by more than this is said: 14 deg of lean, or a bias", "m/s^2", 0.0, 100.0
    )

    def __post_init__(self) -> None:
        check_settings(self)
