"""`biodyn compare`: compares the parameters of two subjects."""

from __future__ import annotations

import argparse

from biodyn_ros.commands.arguments import show
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_core.identification.settings import THRESHOLD_PERCENT

    command.add_argument("first", metavar="A", help="reference: a subject file or bundled name")
    command.add_argument("second", metavar="B", help="the other subject")
    command.add_argument(
        "--threshold", type=float, default=THRESHOLD_PERCENT, metavar="PERCENT",
        help=f"deviation from which a parameter diverges (default {THRESHOLD_PERCENT:g} %%)",
    )  # fmt: skip


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.body.subject import load_subject
    from biodyn_core.identification.compare import compare
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.fit.comparison import comparison_document, text_of

    a, b = (load_subject(subject_file(name)) for name in (options.first, options.second))
    comparison = compare(a, b, options.threshold)
    show(options, comparison_document(comparison), text_of(comparison))


COMMAND = Command(
    line="compares the parameters of two subjects",
    examples=(
        "biodyn compare subject_1 subject_2",
        "biodyn compare anna_fitted.yaml subject_2 --threshold 10 --json",
    ),
    add=_add,
    run=_run,
)
