"""The names of the topics, once: relative, so that namespaces and remapping work (REP-145 for the inputs)."""

from __future__ import annotations

from typing import Final

from biodyn_core.segments import MEASURED_SEGMENTS, SEGMENTS, SENSORS

INPUT: Final = {sensor: f"imu/{sensor}/data" for sensor in SENSORS}
PREDICTED: Final = {segment: f"~/predicted/{segment}/accel" for segment in SEGMENTS}
MEASURED: Final = {sensor: f"~/measured/{sensor}/accel" for sensor in SENSORS}
RESIDUAL: Final = {segment: f"~/residual/{segment}" for segment in MEASURED_SEGMENTS}
EXPOSURE: Final = "~/exposure"
ROLLING: Final = "~/exposure/rolling"
RESET: Final = "~/reset"
MARK: Final = "~/mark"
DIAGNOSTICS: Final = "/diagnostics"


def absolute(topic: str, node: str = "biodyn") -> str:
    """The topic as a bag of the node's output names it."""
    return topic.replace("~", f"/{node}", 1)
