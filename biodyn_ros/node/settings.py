"""Settings of the live node; all settings of `SETTINGS` are its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import check_settings, setting
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.dashboard.settings import ServingSettings
from biodyn_ros.node.exposure_store import POLICIES

SHORTEST_BLOCK_MS: Final = 1.0
"""A shorter block has at most one sample, and a timer would cost more than the sample."""


@dataclass(frozen=True)
class LiveSettings:
    """Settings of the live node itself; the pipeline's settings are further parameters."""

    subject_file: str = setting("subject_1", "path of a subject file, or the name of a bundled subject")
    limits_file: str = setting("", "path of a file with action and limit values; empty: those of 2002/44/EC")
    autostart: bool = setting(True, "configure and activate at start")
    queue_depth: int = setting(2000, "subscription queue of every sensor, in messages", "", 200, 10_000_000)
    block_ms: float = setting(
        5.0, "the seat is processed in blocks of this length, 1 ms or longer; 0: each sample at once", "ms", 0.0, 100.0
    )
    publish_measured: bool = setting(False, "publish the conditioned measurements too")
    exposure_rate_hz: float = setting(2.0, "how often exposure is published", "Hz", 1.0, 10.0)
    state_file: str = setting(
        "", "file that stores exposure across restarts; empty: in the user's state directory; none: nowhere"
    )
    kept_exposure: str = setting(
        "fitting",
        "which stored exposure a new start continues: fitting (same subject and topics, recent), any, or none",
        choices=POLICIES,
    )
    exposure_max_age_h: float = setting(
        12.0, "how old, by its stamps, a stored exposure may be to be continued", "h", 0.0, 8760.0
    )
    dashboard: bool = setting(False, "serve the live page while the node is active")
    shock_mps2: float = setting(5.0, "acceleration of the seat from which the page lists a shock", "m/s^2", 0.5, 1000.0)

    def __post_init__(self) -> None:
        check_settings(self)
        if 0.0 < self.block_ms < SHORTEST_BLOCK_MS:
            raise InputError(f"block_ms is {self.block_ms:g}, allowed are 0 and {SHORTEST_BLOCK_MS:g} to 100 ms")


SETTINGS: Final = (LiveSettings, ServingSettings, ConditioningSettings, PipelineSettings)
