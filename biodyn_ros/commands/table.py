"""The subcommands of `biodyn` in the order of use, and their common parser."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import Any, Final

from biodyn_ros import __version__
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser, Parser

PURPOSE: Final = "Six IMUs on a seated person in a vehicle: predicted motion, exposure, a model."

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "data": ("import-blue-trident", "info", "check-sensors", "events", "simulate", "demo"),
    "online": ("live", "page", "play", "compile"),
    "offline": ("replay",),
    "model": ("subject", "fit", "compare", "validate"),
    "effects": ("trace",),
    "shell": ("completion",),
}
"""All commands; each has a module of its name in this package."""

NAMES: Final = tuple(name for names in GROUPS.values() for name in names)

NESTED: Final = ("subject new",)
"""Commands of two words: the first is a command of its own as well."""


def command_of(name: str) -> Command:
    """The command with this name of NAMES or NESTED."""
    module = name.replace("-", "_").replace(" ", "_")
    found: Command = import_module(f"biodyn_ros.commands.{module}").COMMAND
    return found


class WholeParser(Parser):
    """The parser of `biodyn`: its help lists all subcommands; `commands` are the built ones by name."""

    def __init__(self) -> None:
        super().__init__(prog="biodyn")
        self.add_argument("-h", "--help", action="help", help="show this help")
        self.add_argument("--version", action="version", version=f"biodyn {__version__}", help="show the version")
        self.commands: dict[str, CommandParser] = {}

    def format_help(self) -> str:
        """The commands by group; fits a screen of 24 lines and 80 columns."""
        rows = [(title if name == names[0] else "", name) for title, names in GROUPS.items() for name in names]
        wide = max(map(len, NAMES))
        lines = [f"  {title:<8}{name:<{wide}}  {command_of(name).line}" for title, name in rows]
        ends = ("biodyn COMMAND -h shows everyday options and examples, --help-all every setting;", "biodyn --version.")
        return "\n".join(["usage: biodyn COMMAND [option ...]", "", PURPOSE, "", *lines, "", *ends, ""])


def parser(names: Iterable[str] = NAMES) -> WholeParser:
    """The parser with these subcommands; `command` of the parsed options is the name of the given one.

    Each subcommand costs the imports of its settings: name only the needed one.
    """
    whole = WholeParser()
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=CommandParser)
    whole.commands.update((name, _added(commands, name, command_of(name))) for name in names)
    return whole


def nested(name: str) -> CommandParser:
    """The parser of a command of NESTED."""
    what = command_of(name)
    made = CommandParser(prog=f"biodyn {name}", description=_described(what), examples=what.examples)
    _fill(made, what)
    made.set_defaults(command=name)
    return made


def add_nested(whole: WholeParser, name: str) -> CommandParser:
    """Add a command of NESTED below the command of its first word, for completion: `parsed` uses `nested`."""
    outer, word = name.split()
    return _added(whole.commands[outer].add_subparsers(parser_class=CommandParser), word, command_of(name))


def _described(what: Command) -> str:
    return f"{what.line[0].upper()}{what.line[1:]}."


def _added(commands: Any, name: str, what: Command) -> CommandParser:
    added: CommandParser = commands.add_parser(
        name, help=what.line, description=_described(what), examples=what.examples
    )
    _fill(added, what)
    return added


def _fill(command: CommandParser, what: Command) -> None:
    """Add the arguments of a command."""
    if what.json:
        command.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    what.add(command)
