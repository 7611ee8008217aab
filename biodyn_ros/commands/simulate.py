"""`biodyn simulate`: simulates a bag of six IMUs from a subject and a seat motion."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import add_map, add_seed, add_settings, add_subject, add_time, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_core.body.synthesis_settings import CASE_S, CASES, SensorSettings

    add_subject(command)
    source = command.add_mutually_exclusive_group(required=True)
    source.add_argument("--seat", metavar="FILE", help="measured seat motion: CSV, or a bag")
    source.add_argument("--case", metavar="CASES", help=f"random loading conditions in sequence: {','.join(CASES)}")
    command.add_argument("--seat-rate", type=float, metavar="HZ", help="rate of a CSV without a time column")
    command.add_argument(
        "--seconds", type=float, metavar="N", help=f"length of each case (default {CASE_S:g}), or limit for the file"
    )
    add_seed(command, "seed of random numbers")
    command.add_argument(
        "--compression", choices=("none", "lz4", "zstd"), default="zstd", help="compression of chunks (default zstd)"
    )
    add_map(command)
    add_time(command)
    add_settings(command, "sensors", SensorSettings)
    command.add_argument("-o", "--output", required=True, metavar="BAG", help="FILE.mcap, or a directory")


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.body.subject import load_subject
    from biodyn_core.body.synthesis_settings import CASE_S, SensorSettings
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.reading.seat_motion import is_table, read_seat_motion
    from biodyn_ros.simulate import motion_of_cases, simulate_bag

    subject = load_subject(subject_file(options.subject))
    if options.seat_rate is not None and not is_table(options.seat or ""):
        raise InputError("--seat-rate needs a CSV file given by --seat: omit it")
    if (options.map or options.time != "header") and (not options.seat or is_table(options.seat)):
        raise InputError("--map and --time need a bag given by --seat: omit them")
    if options.seat:
        mapping = parse_map(options.map)
        lines: list[str] = []
        motion = read_seat_motion(options.seat, options.seat_rate, mapping, options.time, lines.append)
        motion = motion.first(options.seconds).from_rest()
        for line in lines:  # now, because a refusal is one line
            print(f"biodyn simulate: warning: {line}", file=sys.stderr)
    else:
        seconds = CASE_S if options.seconds is None else options.seconds
        motion = motion_of_cases(options.case.split(","), seconds, options.seed)
    sensors = settings_of(options, SensorSettings)
    with Progress("writing") as progress:
        result = simulate_bag(
            Path(options.output), subject, motion, options.seed, sensors, options.compression, progress
        )
    show(
        options,
        dataclasses.asdict(result),
        f"{result.bag}: {counted(result.messages, 'message')}, {result.seconds:.1f} s, six IMUs",
    )


COMMAND = Command(
    line="simulates a bag from a subject and seat motion",
    examples=(
        "biodyn simulate --subject subject_2 --case rail --seconds 8 -o simulated.mcap",
        "biodyn simulate --subject anna.yaml --seat seat.csv --seat-rate 500 -o ride.mcap",
    ),
    add=_add,
    run=_run,
)
