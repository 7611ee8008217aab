"""`biodyn info`: what a bag holds, sensor by sensor."""

from __future__ import annotations

import argparse

from biodyn_ros.commands.arguments import add_bag, add_map, add_settings, add_time, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser
from biodyn_ros.progress import Progress


def _add(command: CommandParser) -> None:
    from biodyn_core.conditioning_settings import ConditioningSettings

    add_bag(command)
    add_map(command)
    add_time(command)
    add_settings(command, "conditioning", ConditioningSettings)


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.conditioning_settings import ConditioningSettings
    from biodyn_ros.info.document import info
    from biodyn_ros.info.text import text_of
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.reading.sensors import ReadingOptions

    how = ReadingOptions(parse_map(options.map), options.time, settings_of(options, ConditioningSettings))
    with Progress("reading") as progress:
        document = info(options.bag, how, progress)
    show(options, document, text_of(document))


COMMAND = Command(
    line="what a bag holds: rates, clocks, gaps, gravity",
    examples=(
        "biodyn info drive.mcap",
        "biodyn info drive.mcap --map seat=/car/floor/imu",
    ),
    add=_add,
    run=_run,
)
