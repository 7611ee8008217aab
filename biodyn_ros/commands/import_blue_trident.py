"""`biodyn import-blue-trident`: converts CSV exports of Blue Trident sensors to one bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import add_settings, settings_of, show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_core.conditioning.dual_range_settings import DualRangeSettings

    command.add_argument("exports", metavar="DIR", help="directory of one recording's CSV files, or one file")
    command.add_argument(
        "--map",
        action="append",
        default=[],
        metavar="SENSOR=SERIAL",
        help="serial of a sensor: seat=TS-02374, or its last characters if unique: seat=2374",
    )
    command.add_argument(
        "--map-file", metavar="FILE.yaml", help="the same from a file with lines such as 'seat: TS-02374'"
    )
    command.add_argument("--take", metavar="TAKE", help="one of several takes: date (Capture.U) or file name (Nexus)")
    command.add_argument(
        "--start",
        metavar="TIME",
        help="time of the first row of Nexus: ISO 8601 with zone, or Unix seconds (default: none)",
    )
    command.add_argument("--no-high-g", action="store_true", help="do not replace clipped samples by high-g")
    command.add_argument(
        "--compression", choices=("none", "lz4", "zstd"), default="zstd", help="compression of chunks (default zstd)"
    )
    add_settings(command, "two ranges", DualRangeSettings)
    command.add_argument("-o", "--output", required=True, metavar="BAG", help="FILE.mcap, or a directory")


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.conditioning.dual_range_settings import DualRangeSettings
    from biodyn_ros.blue_trident import ImportOptions, document_of, import_blue_trident, text_of
    from biodyn_ros.blue_trident.exports import parse_serials
    from biodyn_ros.blue_trident.nexus import parse_start

    how = ImportOptions(
        mapping=parse_serials(options.map, options.map_file),
        take=options.take,
        start_ns=parse_start(options.start) if options.start else None,
        high_g=not options.no_high_g,
        settings=settings_of(options, DualRangeSettings),
        compression=options.compression,
    )
    with Progress("importing") as progress:
        outcome = import_blue_trident(Path(options.exports), Path(options.output), how, progress)
    show(options, document_of(outcome), text_of(outcome))


COMMAND = Command(
    line="converts CSV of Blue Trident sensors to a bag",
    examples=(
        "biodyn import-blue-trident exports -o imported.mcap --map seat=TS-02374 --map head=TS-02375",
        "biodyn import-blue-trident trial.csv -o trial.mcap --map-file sensors.yaml --start 2026-05-12T10:32:00Z",
    ),
    add=_add,
    run=_run,
)
