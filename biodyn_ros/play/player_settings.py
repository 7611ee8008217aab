"""Settings of playing a bag."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class PlayerSettings:
    """Settings of playing a bag."""

    rate: float = setting(1.0, "speed, as a multiple of recorded time", "", 0.01, 100.0)
    wait_s: float = setting(10.0, "how long to wait for subscribers; 0: do not wait", "s", 0.0, 3600.0)
    depth: int = setting(2000, "queue of every publisher, in messages", "", 1, 10_000_000)
    loop: bool = setting(False, "restart at the end, one period after the last sample")
    clock: bool = setting(False, "publish /clock, in place of a recorded one")
    keep_stamps: bool = setting(False, "leave the header stamps as recorded, also zero stamps")

    def __post_init__(self) -> None:
        check_settings(self)
