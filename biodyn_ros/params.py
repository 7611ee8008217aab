"""Settings as ROS parameters: dataclass fields become declared parameters with descriptors, and dataclasses again.

Whole numbers are taken where a real number is meant, which rclpy alone refuses; an override that no field declares is
an error naming it, which rclpy alone ignores.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from biodyn_core.errors import InputError
from biodyn_core.settings import Range
from biodyn_ros.nearby import did_you_mean

T = TypeVar("T")

_OF_RCLPY: Final = ("use_sim_time", "start_type_description_service")


def names(kinds: tuple[type[Any], ...]) -> set[str]:
    """The names of all their parameters."""
    return {item.name for kind in kinds for item in dataclasses.fields(kind)}


def declare(node: Node, kinds: tuple[type[Any], ...]) -> None:
    """Declare every field of the dataclasses as a parameter; raises InputError for an override that does not fit."""
    fields = [item for kind in kinds for item in dataclasses.fields(kind)]
    for item in fields:
        default = math.nan if item.default is None else item.default
        try:
            node.declare_parameter(item.name, default, _descriptor(item, default))
        except (InvalidParameterValueException, InvalidParameterTypeException) as error:
            raise InputError(f"parameter {item.name}: {error}") from None
    known = names(kinds)
    for name in node._parameter_overrides:  # rclpy offers no public list of what was given but never declared
        if name not in known and name not in _OF_RCLPY and not name.startswith("qos_overrides."):
            near = did_you_mean(name, known) or f" known are {', '.join(sorted(known))}"
            raise InputError(f"parameter {name} is unknown;{near}")


def read(node: Node, kind: type[T]) -> T:
    """Build a settings dataclass from the node's parameters; raises InputError naming the parameter."""
    return kind(**{item.name: _value(node, item) for item in dataclasses.fields(kind)})  # type: ignore[arg-type]


def _value(node: Node, item: dataclasses.Field[Any]) -> Any:
    value = node.get_parameter(item.name).value
    wanted = float if item.default is None else type(item.default)
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not wanted:
        raise InputError(f"parameter {item.name} is {value!r}, expected a {_WORDS[wanted]}")
    return None if item.default is None and math.isnan(value) else value


_WORDS: Final = {float: "number", int: "whole number", bool: "true or false", str: "text"}


def _descriptor(item: dataclasses.Field[Any], default: Any) -> ParameterDescriptor:
    allowed: Range = item.metadata["range"]
    unit = f" [{allowed.unit}]" if allowed.unit else ""
    # Dynamic, so that 10 is taken for 10.0; `_value` checks the type in rclpy's place.
    descriptor = ParameterDescriptor(description=f"{allowed.meaning}{unit}", dynamic_typing=True)
    if math.isfinite(allowed.lower) and item.default is not None:
        if isinstance(default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(allowed.lower), to_value=int(allowed.upper), step=1)
            ]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=allowed.lower, to_value=allowed.upper)]
    return descriptor
