"""`biodyn compile`: compiles the kernels once, so that the next first prediction does not wait for it."""

from __future__ import annotations

import argparse
import time

from biodyn_core.base.errors import InputError
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    command.add_argument(
        "--subject", default="subject_1", metavar="S",
        help="subject file, or the name of a bundled one, whose effects are compiled too (default subject_1)",
    )  # fmt: skip


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.body.subject import load_subject
    from biodyn_core.kernels.compiling import CACHE, COMPILED
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.node.warmup import warm_up

    if not COMPILED:
        raise InputError("numba is missing or switched off, kernels run uncompiled: pip install 'biodyn_ros[fast]'")
    if CACHE is None:
        raise InputError("no folder is writable, so compiled code is lost at the end: set NUMBA_CACHE_DIR")
    subject = load_subject(subject_file(options.subject))
    begin_s = time.perf_counter()
    warm_up(subject)
    print(f"compiled for {subject.name} in {time.perf_counter() - begin_s:.1f} s, in {CACHE}")


COMMAND = Command(
    line="compiles once, for a quick first prediction",
    examples=(
        "biodyn compile",
        "biodyn compile --subject anna.yaml",
    ),
    add=_add,
    run=_run,
    json=False,  # it has no result
)
