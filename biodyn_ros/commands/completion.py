"""`biodyn completion SHELL`: a script that completes commands, options, choices, bundled subjects and files.

The script is static: it contains the names known when it was printed, and starts no Python at a Tab.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Sequence
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_ros.base.resources import subject_names
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser

SHELLS: Final = ("bash", "zsh", "fish")
SUBJECT: Final = ("S", "A", "B")
"""Metavars of a subject: a bundled name or a file."""

_BAGS: Final = ("mcap", "db3")
"""Suffixes of bags, which are folders too."""


def _add(command: CommandParser) -> None:
    command.add_argument("shell", choices=SHELLS, help="the shell that runs the script")


def _run(options: argparse.Namespace) -> None:
    print(script(options.shell))


def script(shell: str) -> str:
    """The script for a shell; raises InputError if shtab is missing."""
    if importlib.util.find_spec("shtab") is None:
        raise InputError("completion needs shtab: pip install 'biodyn_ros[completion]'")
    import shtab

    from biodyn_ros.commands.table import NESTED, add_nested, parser

    whole = parser()
    inner = [add_nested(whole, name) for name in NESTED]
    for action in (action for command in (*whole.commands.values(), *inner) for action in command.arguments):
        if (how := _complete(str(action.metavar))) is not None:
            action.complete = how
    for name in NESTED:
        # shtab offers the second word in place of an argument only in the script for fish.
        outer, word = name.split()
        sessions = next(action for action in whole.commands[outer].arguments if action.metavar == "SESSION")
        sessions.complete = _words_or_files(f"{outer}_session", [word], *_BAGS)
    return shtab.complete(whole, shell)


def _complete(metavar: str) -> Any:
    """The completion for a metavar; None: none, or by the choices of the option."""
    import shtab

    from biodyn_core.body.synthesis_settings import CASES

    if metavar in SUBJECT:
        return _words_or_files("subject", subject_names(), "yaml")
    if metavar == "CASES":
        return _words_or_files("case", list(CASES))
    if metavar == "DIR":
        return shtab.DIRECTORY
    if metavar in ("BAG", "BAG=CASE", "SESSION"):
        return shtab.glob(*(f"*.{suffix}" for suffix in _BAGS))
    return shtab.FILE if metavar in ("FILE", "OUT.yaml") else None


def _words_or_files(what: str, words: Sequence[str], *suffixes: str) -> dict[str, Any]:
    """Completion by words, and by files of some suffixes and directories."""
    listed, name = " ".join(words), f"_biodyn_{what}_files" if suffixes else f"_biodyn_{what}"
    bash = [f"compgen -W '{listed}' -- \"$1\""]
    fish = [f"printf '%s\\n' {listed}"]
    zsh = [f"'{what}s:{what}:({listed})'"]
    if suffixes:
        bash += [*(f"compgen -f -X '!*.{suffix}' -- \"$1\"" for suffix in suffixes), 'compgen -d -- "$1"']
        fish += [f"__fish_complete_suffix .{suffix}" for suffix in suffixes]
        zsh += [f"'files:file:_files -g \"*.({'|'.join(suffixes)})\"'"]
    return {
        "bash": name,
        "zsh": name,
        "fish": f"({name})",
        "preamble": {
            "bash": f"{name}() {{\n  " + "\n  ".join(bash) + "\n}",
            "zsh": f"{name}() {{\n  _alternative {' '.join(zsh)}\n}}",
            "fish": f"function {name}\n  " + "\n  ".join(fish) + "\nend",
        },
    }


COMMAND = Command(
    line="prints a script that completes on your Tab key",
    examples=(
        "biodyn completion bash > ~/.local/share/bash-completion/completions/biodyn",
        "biodyn completion zsh > ~/.zfunc/_biodyn",
    ),
    add=_add,
    run=_run,
    json=False,  # the result is a shell script
)
