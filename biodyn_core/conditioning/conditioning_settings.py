"""Settings of conditioning. Like all modules of settings it imports no numpy, since the options are built from it."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class ConditioningSettings:
    """Settings of the conditioning of every sensor."""

    cutoff_hz: float = setting(100.0, "low-pass cut-off of the model's input and of comparisons", "Hz", 5.0, 200.0)
    rest_s: float = setting(0.8, "seconds at rest from which gravity, vertical and clock are taken", "s", 0.2, 60.0)
    rest_patience_s: float = setting(
        10.0, "live: seconds to wait for rest before motion is averaged instead", "s", 0.2, 600.0
    )
    rest_rms_mps2: float = setting(0.3, "largest rms about the mean that still counts as rest", "m/s^2", 0.01, 5.0)
    max_gap_s: float = setting(
        0.05, "longest gap that is interpolated; a longer one splits the record", "s", 0.002, 1.0
    )
    saturation_mps2: float = setting(
        156.8,
        "reading of one axis that counts as clipped (16 g, less one step of 12 bits)"
        "; offline a limit that the bag states replaces the default",
        "m/s^2",
        10.0,
        5000.0,
    )
    flat_s: float = setting(2.0, "seconds of one unchanging reading that count as a stuck sensor", "s", 0.05, 3600.0)
    gravity_tracker_s: float | None = setting(
        None,
        "time constant of a slow level that is subtracted from predictions and comparisons, never from exposure",
        "s",
        40.0,
        3600.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)
