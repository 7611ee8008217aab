"""`biodyn demo`: live prediction and replay of the bundled bag."""

from __future__ import annotations

import argparse
from pathlib import Path

from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    command.add_argument("--out", default="out", metavar="DIR", help="directory for report and bag (default out)")
    command.add_argument("--subject", metavar="S", help="subject file or name (default: a new one, DIR/me.yaml)")


def _run(options: argparse.Namespace) -> None:
    from biodyn_ros.demo import demo

    demo(Path(options.out), options.subject)


COMMAND = Command(
    line="plays the bundled bag live, then replays it",
    examples=("biodyn demo --out demo_results",),
    add=_add,
    run=_run,
    json=False,  # its output is a live display; `biodyn replay --json` gives the values
)
