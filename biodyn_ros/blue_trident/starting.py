"""The start time of a recording without a time of day, as given by the user."""

from __future__ import annotations

from datetime import datetime

from biodyn_core.base.errors import InputError
from biodyn_ros.blue_trident.samples import LATEST_S


def parse_start(text: str) -> int:
    """Nanoseconds since 1970 of an ISO 8601 time with its zone, or of Unix seconds; raises InputError for others."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = _iso(text)
    if not 0.0 < seconds < LATEST_S:
        raise InputError(f"--start {text}: must be between 1970 and 2038, the range of ROS stamps")
    return round(seconds * 1e6) * 1000


def _iso(text: str) -> float:
    try:
        time = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        raise InputError(
            f"--start {text}: expected a time such as 2026-05-12T10:32:00+02:00, or Unix seconds"
        ) from None
    if time.tzinfo is None:
        raise InputError(f"--start {text}: has no time zone: add one, such as {text}+02:00, or Z")
    return time.timestamp()
