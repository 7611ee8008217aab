"""The `biodyn` command: a shell over functions. A known error is one line and exit code 2; results can be JSON."""

from __future__ import annotations

import argparse
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
from biodyn_ros.commands.table import NAMES, command_of, parser

EXIT_INTERRUPTED: Final = 130
TOP_LEVEL: Final = ("-h", "--help", "--version")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code."""
    os.environ.update(ONE_THREAD)  # before numpy loads
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["help"]:
        given = [*given[1:2], "-h"]
    name = given[0] if given else ""
    try:
        if given[:2] == ["live", "--ros-args"]:
            return run_node(given[1:])  # what stands behind its name belongs to ROS
        options = _parsed(given)  # imports too, for some seconds in which one may change one's mind
        return command_of(options.command).run(options) or 0
    except InputError as error:
        print(f"biodyn {name}: {error}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print(f"biodyn {name}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except OSError as error:  # a name that no file can have, a disk that is full: what the machine refuses is told too
        if isinstance(error, BrokenPipeError) and not _is_read():
            return 0
        told = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        print(f"biodyn {name}: {InputError(told)}", file=sys.stderr)
        return EXIT_INPUT
    finally:
        _flush()


def _is_read() -> bool:
    """Whether anybody still reads what is printed, or it goes to no pipe."""
    pipes = select.poll()
    pipes.register(sys.stdout.fileno(), 0)
    return not pipes.poll(0)


def _flush() -> None:
    """Flush what was printed; where nobody reads it any more the rest goes nowhere, and fails nobody at exit."""
    try:
        if sys.stdout is not None:  # as it is where it was closed from the start
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parsed(given: list[str]) -> argparse.Namespace:
    """What was asked for; only the subcommand that was named is built, because its settings cost imports."""
    name = given[0] if given else ""
    asked = parser([name] if name in NAMES else [])
    if not name:
        asked.error("what to do is missing")
    if name not in NAMES and name not in TOP_LEVEL:
        kind = "option" if name.startswith("-") else "command"
        asked.error(f"there is no {kind} {name}{did_you_mean(name, NAMES)}")
    return asked.parse_args(given)


if __name__ == "__main__":
    sys.exit(main())
