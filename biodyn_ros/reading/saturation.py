"""The limits from which samples of a bag count as clipped: a bag states them if its sensors have another range."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from biodyn_ros.bag import BagReader

KEY: Final = "saturation_mps2"
"""In the metadata record `biodyn`: {topic: m/s^2} of the topics whose limit is not the default."""


def stated(limits: Mapping[str, float]) -> dict[str, str]:
    """The metadata of a bag about its limits; empty if all have the default."""
    return {KEY: json.dumps(dict(limits))} if limits else {}


def limits_of(
    reader: BagReader, topics: Mapping[str, str], given: ConditioningSettings | None
) -> tuple[dict[str, ConditioningSettings], list[str]]:
    """Settings by sensor, for {topic: sensor} of a bag and all others, and a line for every limit from the bag.

    A given limit other than the default overrides the bag's. An invalid limit is ignored.
    """
    settings = given or ConditioningSettings()
    own = _stated(reader) if settings.saturation_mps2 == ConditioningSettings.saturation_mps2 else {}
    found, lines = dict.fromkeys(SENSORS, settings), []
    for topic, sensor in topics.items():
        found[sensor] = settings
        if topic in own:
            try:
                found[sensor] = dataclasses.replace(settings, saturation_mps2=own[topic])
            except InputError:
                continue
            lines.append(f"{sensor}: counts as clipped from {own[topic]:.0f} m/s^2 on, as the bag states")
    return found, lines


def _stated(reader: BagReader) -> dict[str, float]:
    try:
        limits = json.loads(reader.metadata("biodyn").get(KEY, "{}"))
    except (ValueError, RecursionError):
        return {}
    if not isinstance(limits, dict):
        return {}
    return {topic: float(limit) for topic, limit in limits.items() if type(limit) in (int, float)}
