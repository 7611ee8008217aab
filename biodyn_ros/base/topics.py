"""All topics: relative names, for namespaces and remapping (REP-145 inputs), and the values of the scalars."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEGMENTS, SENSORS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from biodyn_core.exposure.limit_assessment import SeatExposure
    from biodyn_core.pipeline.exposure import Exposure
    from biodyn_core.pipeline.pipeline import Pipeline

NODE_NAME: Final = "biodyn"
INPUT: Final = {sensor: f"imu/{sensor}/data" for sensor in SENSORS}
PREDICTED: Final = {segment: f"~/predicted/{segment}/accel" for segment in SEGMENTS}
MEASURED: Final = {sensor: f"~/measured/{sensor}/accel" for sensor in SENSORS}
PREDICTED_BLOCK: Final = "~/predicted/block"
MEASURED_BLOCK: Final = "~/measured/block"
"""Blocks of samples, a trajectory_msgs/JointTrajectory each; `joint_names` are segments, or sensors."""

RESIDUAL: Final = {segment: f"~/residual/{segment}" for segment in MEASURED_SEGMENTS}
EXPOSURE: Final = "~/exposure"
ROLLING: Final = "~/exposure/rolling"
SNAPSHOT: Final = "~/snapshot"
"""Data of the live page, as JSON in a std_msgs/String; published while it has a subscriber."""

MARKS: Final = "~/marks"
"""The name of every mark when it is set, in a std_msgs/String; a replay lists the recorded marks."""

RESET: Final = "~/reset"
MARK: Final = "~/mark"
DIAGNOSTICS: Final = "/diagnostics"

_SPAN: Final = (
    "dri",
    "head/hic15",
    *(f"{sensor}/{figure}" for sensor in SENSORS for figure in ("vdv", "aw")),
    *(f"predicted/{segment}/{figure}" for segment in SEGMENTS for figure in ("vdv", "aw")),
)
_SEAT: Final = ("a8", "time_to_action_value", "time_to_limit_value")
SCALARS: Final = (
    *RESIDUAL.values(),
    *(f"{root}/{name}" for root in (EXPOSURE, ROLLING) for name in _SPAN),
    *(f"{EXPOSURE}/seat/{name}" for name in _SEAT),
)
"""Every std_msgs/Float64 topic of the live node."""


def absolute(topic: str, node: str = NODE_NAME) -> str:
    """The full name of the topic when the node runs under its own name."""
    return topic.replace("~", f"/{node}", 1)


def status_name(of: str, node: str = NODE_NAME) -> str:
    """The name of a diagnostic status: of a sensor, or of `prediction`, `exposure`, `sending` or `page`."""
    return f"{node}: {of}"


def scalar_values(
    pipeline: Pipeline, silent_s: Mapping[str, float] | None = None, seat_at_fault: bool = False
) -> dict[str, float]:
    """The value of each scalar topic; a value not available is absent.

    silent_s: time since the last message of a sensor, by arrival. seat_at_fault: no time left is given.
    """
    since, rolling = pipeline.exposure(), pipeline.exposure(True, silent_s)
    values = exposure_values(since, EXPOSURE) | exposure_values(rolling, ROLLING)
    values |= {RESIDUAL[segment]: rms for segment, (rms, _) in rolling.residual.items()}
    return values | seat_values(pipeline.seat(), seat_at_fault)


def exposure_values(exposure: Exposure, root: str) -> dict[str, float]:
    """The value of each topic of one time span; a value not available yet is absent."""
    values = {}
    for sensor, dose in exposure.sensors.items():
        values[f"{root}/{sensor}/vdv"], values[f"{root}/{sensor}/aw"] = dose.vdv_mps175, dose.aw_mps2
    for segment, dose in exposure.predicted.items():
        values[f"{root}/predicted/{segment}/vdv"] = dose.vdv_mps175
        values[f"{root}/predicted/{segment}/aw"] = dose.aw_mps2
    if exposure.dri:
        values[f"{root}/dri"] = exposure.dri.compression
    if exposure.hic15:
        values[f"{root}/head/hic15"] = exposure.hic15.resultant
    return values


def seat_values(seat: SeatExposure | None, at_fault: bool = False) -> dict[str, float]:
    """The seat's exposure and times to its limits.

    An unknown time is absent. Every time is absent while the seat is at fault, and where it has no data of an axis:
    then a limit may be reached earlier.
    """
    if seat is None:
        return {}
    if at_fault or seat.projected_lower_bound:
        return {f"{EXPOSURE}/seat/a8": seat.a8_so_far_mps2}
    values = {
        "a8": seat.a8_so_far_mps2,
        "time_to_action_value": seat.time_to_action_value_s,
        "time_to_limit_value": seat.time_to_limit_value_s,
    }
    return {f"{EXPOSURE}/seat/{name}": value for name, value in values.items() if value is not None}
