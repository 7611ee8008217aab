"""`biodyn live`: runs the live node; ROS parses its arguments."""

from __future__ import annotations

import argparse

from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    command.usage = "biodyn live [--ros-args ...]"
    command.description += "\nParameters and ranges: python -m biodyn_ros.node.parameters_yaml > live.yaml"


def _run(options: argparse.Namespace) -> int:  # noqa: ARG001  # it has none: ROS parses them
    return run_node([])


def run_node(arguments: list[str]) -> int:
    """Run the live node with these ROS arguments and return its exit code."""
    from biodyn_ros.node.live import main

    return main(arguments)


COMMAND = Command(
    line="runs the live node; takes --ros-args",
    examples=(
        "biodyn live --ros-args -p subject_file:=anna.yaml -p publish_measured:=true",
        "biodyn live --ros-args -r imu/seat/data:=/car/floor/imu",
        "biodyn live --ros-args --params-file live.yaml",
    ),
    add=_add,
    run=_run,
    json=False,
)
