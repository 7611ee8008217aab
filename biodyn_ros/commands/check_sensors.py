"""`biodyn check-sensors`: checks each sensor against another one of the same recording."""

from __future__ import annotations

import argparse

from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import add_bag, add_map, add_seed, add_settings, add_time, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_core.sensor_pairs.settings import PairSettings, StretchSettings

    add_bag(command)
    good = command.add_mutually_exclusive_group(required=True)
    good.add_argument(
        "--good", nargs="+", action="extend", default=[], metavar="BAG",
        help="recordings of the same sensors and mounting, known to be without a fault",
    )  # fmt: skip
    good.add_argument(
        "--good-until", type=float, metavar="SECONDS", help="the first part of the bag is without a fault"
    )
    command.add_argument(
        "--pair", nargs="+", action="extend", default=[], metavar="SENSOR=REF",
        help="a sensor and the one that checks it, or their topics (default: each by the next lower one)",
    )  # fmt: skip
    add_map(command)
    add_time(command)
    add_seed(command, "seed of the random draws")
    add_settings(command, "stretches", StretchSettings, everyday=("stretches",))
    add_settings(command, "check of a pair", PairSettings)


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.sensor_pairs.settings import PairSettings, StretchSettings
    from biodyn_ros.check_sensors.checking import CheckOptions, check_sensors, parse_pairs
    from biodyn_ros.check_sensors.document import check_document
    from biodyn_ros.check_sensors.records import RecordOptions
    from biodyn_ros.check_sensors.text import text_of
    from biodyn_ros.reading.mapping import parse_map

    stretches = settings_of(options, StretchSettings)
    how = CheckOptions(
        pairs=parse_pairs(options.pair),
        reading=RecordOptions(parse_map(options.map), options.time, stretches.read_s),
        stretches=stretches,
        settings=settings_of(options, PairSettings),
        good_until_s=options.good_until,
        seed=options.seed,
    )
    with Progress("checking") as progress:
        report = check_sensors(options.bag, options.good, how, progress)
    show(options, check_document(report), text_of(report))


COMMAND = Command(
    line="checks each sensor against another one",
    examples=(
        "biodyn check-sensors drive.mcap --good before.mcap",
        "biodyn check-sensors drive.mcap --good before.mcap --pair head=neck neck=seat",
    ),
    add=_add,
    run=_run,
)
