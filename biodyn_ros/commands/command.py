"""What a subcommand of `biodyn` is."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from biodyn_ros.commands.parsing import CommandParser


@dataclass(frozen=True)
class Command:
    """A subcommand: one file of this room ends in COMMAND = Command(...), and `GROUPS` of table.py has its name.

    line: its line in the list of commands, 48 characters at most; examples: each as it is typed, which tests run or
    parse. add: adds its options, with the imports that its settings cost; run: does it; raises InputError where it
    cannot, and returns an exit code where that is not 0. json: whether it has a result that --json prints.
    """

    line: str
    examples: tuple[str, ...]
    add: Callable[[CommandParser], None]
    run: Callable[[argparse.Namespace], int | None]
    json: bool = True
