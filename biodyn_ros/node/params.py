"""Settings as ROS parameters: dataclass fields become declared parameters with descriptors, and dataclasses again.

A whole number is accepted for a real one, which rclpy alone refuses; an override that no field declares is an error
that names it, which rclpy alone ignores.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Container, Iterable
from typing import Any, Final, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.qos_overriding_options import QoSOverridingOptions

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import Range
from biodyn_core.base.suggestions import did_you_mean

T = TypeVar("T")

OVERRIDABLE: Final = "history, depth and reliability of input subscriptions and sample publishers can be"
_OF_RCLPY: Final = ("use_sim_time", "start_type_description_service")


def names(kinds: tuple[type[Any], ...]) -> set[str]:
    """The names of all their parameters."""
    return {item.name for kind in kinds for item in dataclasses.fields(kind)}


def declare(node: Node, kinds: tuple[type[Any], ...], qos: Container[str] = ()) -> None:
    """Declare every field of the dataclasses as a parameter; raises InputError for an override that does not fit.

    qos: the overrides of QoS that the node accepts, `qos_overrides.TOPIC.subscription.POLICY`.
    """
    fields = [item for kind in kinds for item in dataclasses.fields(kind)]
    for item in fields:
        default = math.nan if item.default is None else item.default
        try:
            node.declare_parameter(item.name, default, _descriptor(item, default))
        except (InvalidParameterValueException, InvalidParameterTypeException) as error:
            raise InputError(f"parameter {item.name}: {error}") from None
    known = names(kinds)
    for name in node._parameter_overrides:  # rclpy has no public list of overrides that are not declared
        if name.startswith("qos_overrides.") and name not in qos:
            raise InputError(f"parameter {name} overrides nothing: only {OVERRIDABLE}")
        if name not in known and name not in _OF_RCLPY and name not in qos:
            near = did_you_mean(name, known) or f"; known are {', '.join(sorted(known))}"
            raise InputError(f"parameter {name} is unknown{near}")


def qos_overrides(node: Node, topics: Iterable[str], entity: str) -> set[str]:
    """The overrides of publishers or subscriptions (entity) that are made with rclpy's default overriding options."""
    policies = QoSOverridingOptions.with_default_policies().policy_kinds
    return {
        f"qos_overrides.{node.resolve_topic_name(topic)}.{entity}.{policy.name.lower()}"
        for topic in topics
        for policy in policies
    }


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


def description(item: dataclasses.Field[Any]) -> str:
    """A parameter's meaning, with its unit."""
    allowed: Range = item.metadata["range"]
    return f"{allowed.meaning} [{allowed.unit}]" if allowed.unit else allowed.meaning


def _descriptor(item: dataclasses.Field[Any], default: Any) -> ParameterDescriptor:
    allowed: Range = item.metadata["range"]
    # Dynamic typing, so that 10 is accepted for 10.0; `_value` checks the type instead of rclpy.
    descriptor = ParameterDescriptor(description=description(item), dynamic_typing=True)
    if math.isfinite(allowed.lower) and item.default is not None:
        if isinstance(default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(allowed.lower), to_value=int(allowed.upper), step=1)
            ]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=allowed.lower, to_value=allowed.upper)]
    return descriptor
