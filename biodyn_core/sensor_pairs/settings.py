"""Settings of the check of a sensor by another one."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class PairSettings:
    """Settings of a check."""

    lowest_hz: float = setting(0.5, "lowest frequency compared, above gravity and biases", "Hz", 0.05, 10.0)
    highest_share: float = setting(0.36, "highest frequency compared, in shares of the rate", "", 0.05, 0.48)
    transfer_s: float = setting(0.06, "longest background filter before and after", "s", 0.0, 1.0)
    window_s: float = setting(0.5, "length of a window", "s", 0.05, 10.0)
    least_s: float = setting(5.0, "shortest stretch", "s", 0.5, 3600.0)
    least_explained: float = setting(
        0.4, "least share of a channel's rms that the reference has to predict", "", 0.0, 1.0
    )
    replicates: int = setting(2000, "random draws of the largest gain", "", 100, 1_000_000)
    chance: float = setting(0.05, "share of random draws above the threshold", "", 0.001, 0.5)
    change_ratio: float = setting(2.0, "multiple of the background's own gain between both halves", "", 0.0, 100.0)
    least_ratio: float = setting(0.3, "least change of a fault over the background", "", 0.0, 10.0)
    most_residual: float = setting(
        2.0, "error over the background's above which a fault explains nothing", "", 1.0, 100.0
    )
    floor: float = setting(1.3, "error over the background's above which it is unexplained", "", 1.0, 10.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class StretchSettings:
    """Settings of the stretches that are cut out of recordings."""

    stretch_s: float = setting(12.0, "length of a compared stretch", "s", 5.0, 120.0)
    stretches: int = setting(3, "stretches of the checked recording, evenly distributed", "", 1, 100)
    highest_rate_hz: float = setting(250.0, "rate of comparison; slower sensors have their own", "Hz", 50.0, 2000.0)
    longest_gap_s: float = setting(0.1, "longest gap that is interpolated in a stretch", "s", 0.0, 1.0)
    read_s: float = setting(600.0, "length that is read from the start of each bag", "s", 10.0, 86400.0)

    def __post_init__(self) -> None:
        check_settings(self)
