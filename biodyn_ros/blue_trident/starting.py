"""When a recording began that keeps no time of day: as its user says."""

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
        raise InputError(f"--start {text}: from 1970 to 2038, as stamps of ROS are")
    return round(seconds * 1e6) * 1000


def _iso(text: str) -> float:
    try:
        time = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        raise InputError(
            f"--start {text}: expected a time such as 2026-05-12T10:32:00+02:00, or Unix seconds"
        ) from None
    if time.tzinfo is None:
        raise InputError(f"--start {text}: has no zone: add one, such as {text}+02:00, or Z")
    return time.timestamp()
