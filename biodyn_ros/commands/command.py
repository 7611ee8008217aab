"""The definition of a subcommand of `biodyn`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from biodyn_ros.commands.parsing import CommandParser


@dataclass(frozen=True)
class Command:
    """A subcommand: a module of this package ends in COMMAND = Command(...), and `GROUPS` of table.py lists its name.

    line: its line in the list of commands, 48 characters at most; examples: command lines, which tests run or parse.
    add: adds its options, importing its settings; run: runs it, raises InputError, and returns an exit code other than
    0 if needed. json: whether it has a result for --json.
    """

    line: str
    examples: tuple[str, ...]
    add: Callable[[CommandParser], None]
    run: Callable[[argparse.Namespace], int | None]
    json: bool = True
