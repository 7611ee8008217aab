"""`biodyn subject new`: a subject for a person who was never recorded."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_ros.commands.arguments import show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    command.add_argument("--mass", type=float, required=True, metavar="KG", help="body mass")
    command.add_argument("--stature", type=float, required=True, metavar="M", help="stature; the model does not use it")
    command.add_argument("--name", default="", metavar="NAME", help="name (default: that of the file)")
    command.add_argument("--force", action="store_true", help="replace an existing file")
    command.add_argument("-o", "--output", required=True, metavar="OUT.yaml", help="file of the subject")


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.population.population import beyond, new_subject
    from biodyn_ros.base.files import make_directory, write_text

    output = Path(options.output)
    if output.exists() and not options.force:
        raise InputError(f"{output} exists: name another file, or replace it with --force")
    subject = new_subject(options.name or output.stem, options.mass, options.stature)
    make_directory(output.parent)
    write_text(output, subject.to_yaml())
    if reason := beyond(options.mass, options.stature):
        print(f"biodyn subject new: warning: {reason}", file=sys.stderr)
    text = (
        f"{output}: {options.mass:g} kg, {options.stature:g} m; parameters of published groups of people, no recording"
    )
    show(options, {"subject": str(output), **subject.to_dict()}, text)


COMMAND = Command(
    line="makes a subject from published groups of people",
    examples=("biodyn subject new --mass 75 --stature 1.75 -o me.yaml",),
    add=_add,
    run=_run,
)
