"""The `biodyn` command: a shell over functions. A known error is one line and exit code 2; results can be JSON."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import Final

from biodyn_core.errors import InputError
from biodyn_ros.commands.live import run_node
from biodyn_ros.commands.parsing import EXIT_INPUT
from biodyn_ros.commands.table import NAMES, command_of, parser
from biodyn_ros.environment import ONE_THREAD
from biodyn_ros.nearby import did_you_mean

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
    except BrokenPipeError:
        return 0
    except OSError as error:  # a name that no file can have, a disk that is full: what the machine refuses is told too
        told = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        print(f"biodyn {name}: {InputError(told)}", file=sys.stderr)
        return EXIT_INPUT


def _parsed(given: list[str]) -> argparse.Namespace:
    """What was asked for; only the subcommand that was named is built, because its settings cost imports."""
    name = given[0] if given else ""
    asked = parser([name] if name in NAMES else [])
    if not name:
        asked.error("what to do is missing")
    if name not in NAMES and name not in TOP_LEVEL:
        kind = "option" if name.startswith("-") else "command"
        near = did_you_mean(name, NAMES)
        asked.error(f"there is no {kind} {name}{';' if near else ''}{near}")
    return asked.parse_args(given)


if __name__ == "__main__":
    sys.exit(main())
