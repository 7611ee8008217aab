"""Settings: dataclass fields that hold default, unit, range and meaning.

ROS parameters, options, the parameters file and tables of the documents are derived from these fields.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean


@dataclass(frozen=True)
class Range:
    """Allowed values of a setting, both ends included, and its meaning."""

    meaning: str
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    choices: tuple[str, ...] = ()


def setting(
    default: Any,
    meaning: str,
    unit: str = "",
    lower: float = -math.inf,
    upper: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """A dataclass field with its description."""
    return dataclasses.field(default=default, metadata={"range": Range(meaning, unit, lower, upper, choices)})


def check_settings(settings: Any) -> None:
    """Raise InputError for the first field that is not finite, outside its range or not among its choices."""
    for item in described(settings):
        allowed: Range = item.metadata["range"]
        value = getattr(settings, item.name)
        if allowed.choices and value not in allowed.choices:
            near = did_you_mean(value, allowed.choices)
            raise InputError(f"{item.name} is {value!r}, allowed are {' and '.join(allowed.choices)}{near}")
        if isinstance(value, (str, bool)) or value is None:
            continue
        if not (math.isfinite(value) and allowed.lower <= value <= allowed.upper):
            unit = f" {allowed.unit}" if allowed.unit else ""
            raise InputError(f"{item.name} is {value:g}, allowed are {allowed.lower:g} to {allowed.upper:g}{unit}")


def described(settings: Any) -> list[dataclasses.Field[Any]]:
    """The fields of a dataclass that are settings."""
    return [item for item in dataclasses.fields(settings) if "range" in item.metadata]
