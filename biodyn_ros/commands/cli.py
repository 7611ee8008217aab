"""The `biodyn` command: runs a subcommand. A known error is one line and exit code 2; results can be JSON."""

from __future__ import annotations

import argparse
import io
import os
import select
import sys
from collections.abc import Sequence
from typing import Final

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean
from biodyn_ros.base.environment import ONE_THREAD
from biodyn_ros.commands.live import run_node
from biodyn_ros.commands.parsing import EXIT_INPUT
from biodyn_ros.commands.table import NAMES, NESTED, command_of, nested, parser

EXIT_INTERRUPTED: Final = 130
TOP_LEVEL: Final = ("-h", "--help", "--version")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code."""
    os.environ.update(ONE_THREAD)  # before numpy loads
    _escape_unprintable()
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["help"]:
        given = [*given[1:2], "-h"]
    name = given[0] if given else ""
    try:
        if given[:2] == ["live", "--ros-args"]:
            return run_node(given[1:])  # ROS parses the arguments
        options = parsed(given)  # imports for some seconds, during which Ctrl-C must work
        if getattr(options, "output", None) == "":  # a variable of the shell that is not set
            raise InputError("-o is an empty text: give a file or directory, . for the present one")
        return command_of(options.command).run(options) or 0
    except InputError as error:
        print(f"biodyn {name}: {error}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print(f"biodyn {name}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except OSError as error:  # an impossible file name, a full disk
        if isinstance(error, BrokenPipeError) and not _is_read():
            return 0
        reason = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        print(f"biodyn {name}: {InputError(reason)}", file=sys.stderr)
        return EXIT_INPUT
    finally:
        _flush()


def _escape_unprintable() -> None:
    """Print characters that cannot be encoded as escapes: a file name that is not UTF-8 has such characters."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="backslashreplace")


def _is_read() -> bool:
    """Whether standard output is no pipe, or its reader is still connected."""
    pipes = select.poll()
    pipes.register(sys.stdout.fileno(), 0)
    return not pipes.poll(0)


def _flush() -> None:
    """Flush standard output; if its reader has closed the pipe, discard the rest without an error at exit."""
    try:
        if sys.stdout is not None:  # None if it was closed before the start
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def parsed(given: list[str]) -> argparse.Namespace:
    """Parse the arguments; only the given subcommand is built, because its settings cost imports."""
    name = given[0] if given else ""
    if (words := " ".join(given[:2])) in NESTED:
        return nested(words).parse_args(given[2:])
    command_line = parser([name] if name in NAMES else [])
    if not name:
        command_line.error("no command is given")
    if name not in NAMES and name not in TOP_LEVEL:
        kind = "option" if name.startswith("-") else "command"
        command_line.error(f"there is no {kind} {name}{did_you_mean(name, NAMES)}")
    return command_line.parse_args(given)


if __name__ == "__main__":
    sys.exit(main())
