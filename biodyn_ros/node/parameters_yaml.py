"""The live node's parameters as a file for `--params-file`, from the fields that declare them.

python -m biodyn_ros.node.parameters_yaml > config/live.yaml
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from typing import Any, Final

from biodyn_core.base.settings import Range, described
from biodyn_ros.node.params import description
from biodyn_ros.node.settings import SETTINGS

HEAD: Final = """\
# The live node's parameters with their defaults. Ranges and meanings are those the node declares;
# made by `python -m biodyn_ros.node.parameters_yaml`, and a test keeps this file and the code the same.
/**:
  ros__parameters:
"""


def parameters_yaml() -> str:
    """Every parameter with its default, and its meaning in a comment."""
    lines = [
        f"    {item.name}: {_value(item.default)}  # {_meaning(item)}" for kind in SETTINGS for item in described(kind)
    ]
    return HEAD + "\n".join(lines) + "\n"


def _value(default: Any) -> str:
    """A default as YAML that ROS reads with the type that the node declares."""
    if default is None:
        return ".nan"
    return json.dumps(default)


def _meaning(item: dataclasses.Field[Any]) -> str:
    allowed: Range = item.metadata["range"]
    span = f", {allowed.lower:g} to {allowed.upper:g}" if math.isfinite(allowed.lower) else ""
    return f"{description(item)}{span}"


if __name__ == "__main__":
    sys.stdout.write(parameters_yaml())
