"""`biodyn info`: shows the content of a bag by sensor."""

from __future__ import annotations

import argparse
import importlib
from typing import Final

from biodyn_ros.base.environment import variables_set
from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import add_bag, add_map, add_settings, add_time, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser

UNCOMPILED_UP_TO: Final = 125_000
"""Total number of samples, 18 s of six sensors at 1129 Hz.

Plain Python needs 0.7 s for them. numba needs 0.4 s to load, and 3 s to compile without a cache.
"""


def _add(command: CommandParser) -> None:
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings

    add_bag(command)
    add_map(command)
    add_time(command)
    add_settings(command, "conditioning", ConditioningSettings)


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_ros.bag import open_bag
    from biodyn_ros.reading.mapping import imu_messages, parse_map
    from biodyn_ros.reading.sensors import ReadingOptions

    how = ReadingOptions(parse_map(options.map), options.time, settings_of(options, ConditioningSettings))
    with Progress("reading") as progress, open_bag(options.bag) as reader:
        _load_kernels(compiled=imu_messages(reader) > UNCOMPILED_UP_TO)
        from biodyn_ros.info.document import info_document
        from biodyn_ros.info.report import info_of
        from biodyn_ros.info.text import text_of

        report = info_of(reader, options.bag, how, progress)
    show(options, info_document(report), text_of(report))


def _load_kernels(compiled: bool) -> None:
    """Load the kernels with or without numba; the first import decides for the whole process."""
    with variables_set({} if compiled else {"NUMBA_DISABLE_JIT": "1"}):
        importlib.import_module("biodyn_core.kernels")


COMMAND = Command(
    line="shows a bag: rates, clocks, gaps, gravity",
    examples=(
        "biodyn info drive.mcap",
        "biodyn info drive.mcap --map seat=/car/floor/imu",
    ),
    add=_add,
    run=_run,
)
