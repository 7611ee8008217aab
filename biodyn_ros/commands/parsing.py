"""The parsers of `biodyn`: help that fits a screen, every setting on request, errors of one line with a hint.

-h shows the options of `command.add_argument`; only --help-all shows those of `command.tuning(title).add_argument`.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NoReturn

from biodyn_core.base.suggestions import did_you_mean
from biodyn_core.base.wording import counted

EXIT_INPUT: Final = 2
_MIN_WIDTH, _MAX_WIDTH = 40, 100
"""Columns of help texts; longer lines are hard to read."""


class Parser(argparse.ArgumentParser):
    """The common parser of the command and its subcommands: no abbreviations, and errors of one line.

    An abbreviation in a script would become ambiguous with a new setting.
    """

    def __init__(self, **words: Any) -> None:
        super().__init__(allow_abbrev=False, add_help=False, formatter_class=_Formatter, **words)
        self.register("type", int, _typed(int, "a whole number"))
        self.register("type", float, _typed(float, "a number"))

    def error(self, message: str) -> NoReturn:
        """Print one line with a hint, and exit with code 2."""
        end = "" if message.endswith("?") else ";"
        self.exit(EXIT_INPUT, f"{self.prog}: {message}{end} {self.prog} -h shows how\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            near = did_you_mean(value, known)
            raise argparse.ArgumentError(action, f"{value!r} is not one of {', '.join(known)}{near}")


class CommandParser(Parser):
    """A subcommand: -h shows its everyday options and examples, --help-all every setting with its range."""

    def __init__(self, examples: Sequence[str] = (), **words: Any) -> None:
        super().__init__(**words)
        self._lines = examples
        self._tuning: list[Any] = []
        self._positionals.title = "arguments"
        self.add_argument("-h", "--help", action="help", help="show everyday options and examples")
        self.add_argument("--help-all", action=_HelpAll, help="show every setting with its range and default")

    def tuning(self, title: str) -> Any:
        """A new group of options that only --help-all shows."""
        self._tuning.append(self.add_argument_group(title))
        return self._tuning[-1]

    @property
    def arguments(self) -> list[Any]:
        """All actions of argparse."""
        return list(self._actions)

    @property
    def tuned(self) -> list[Any]:
        """The actions that only --help-all shows."""
        return [action for group in self._tuning for action in group._group_actions]

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in argparse, but an unknown option is reported before missing arguments."""
        given = list(sys.argv[1:] if args is None else args)
        self._check_options(given[: given.index("--")] if "--" in given else given)
        parsed, more = super().parse_known_args(given, namespace)
        if more:
            self.error(f"unexpected: {' '.join(more)}")
        return parsed, more

    def _check_options(self, given: Sequence[str]) -> None:
        for name in (word.partition("=")[0] for word in given if word.startswith("--")):
            if name not in self._option_string_actions:
                self.error(f"there is no option {name}{did_you_mean(name, self._option_string_actions)}")

    def format_help(self) -> str:
        """Everyday options and examples."""
        return self._helped([group for group in self._action_groups if group not in self._tuning], self._ends())

    def format_all(self) -> str:
        """All options and examples."""
        return self._helped(self._action_groups, self._examples())

    def _helped(self, groups: Sequence[Any], end: str) -> str:
        formatter = self._get_formatter()
        for group in groups:
            formatter.start_section(group.title)
            formatter.add_arguments(sorted(group._group_actions, key=_rank))
            formatter.end_section()
        return f"{self._usage()}\n\n{self.description}\n\n{formatter.format_help()}\n{end}"

    def _usage(self) -> str:
        """The required arguments in order, unless `usage` is given."""
        if self.usage:
            return f"usage: {self.usage}"
        return "\n".join(_folded(["usage:", *self.prog.split(), *self._needed(), "[option ...]"], " " * 9))

    def _needed(self) -> Iterator[str]:
        for action in self._get_positional_actions():
            name = action.metavar or f"{{{','.join(action.choices or [action.dest])}}}"
            yield f"[{name} ...]" if action.nargs == "*" else str(name)
        yield from (_shown(action) for action in self._get_optional_actions() if action.required)
        for group in self._mutually_exclusive_groups:
            if group.required:
                yield f"({' | '.join(_shown(action) for action in group._group_actions)})"

    def _ends(self) -> str:
        count = len(self.tuned)
        more = f"{counted(count, 'more setting')}, with ranges: {self.prog} --help-all\n\n" if count else ""
        return f"{more}{self._examples()}"

    def _examples(self) -> str:
        lines = ["examples:"]
        for example in self._lines:
            *first, last = _folded(_pairs(example), " " * 6, _width() - 4)
            lines += [*(f"  {line} \\" for line in first), f"  {last}"]
        return "\n".join([*lines, ""])


class _HelpAll(argparse.Action):
    """Prints all options and exits."""

    def __init__(self, **words: Any) -> None:
        super().__init__(nargs=0, default=argparse.SUPPRESS, **{**words, "dest": argparse.SUPPRESS})

    def __call__(self, parser: Any, *_: Any) -> None:
        sys.stdout.write(parser.format_all())
        parser.exit()


class _Formatter(argparse.RawDescriptionHelpFormatter):
    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=26, width=_width())


def _width() -> int:
    return max(_MIN_WIDTH, min(shutil.get_terminal_size().columns - 2, _MAX_WIDTH))


def _rank(action: argparse.Action) -> int:
    """Sort key: required options first, help last, otherwise in the order of addition."""
    return 2 if isinstance(action, (argparse._HelpAction, _HelpAll)) else int(not action.required)


def _shown(action: argparse.Action) -> str:
    return f"{action.option_strings[0]} {action.metavar or action.dest.upper()}"


def _pairs(example: str) -> list[str]:
    """The words of a line; an option and its value are one word."""
    words: list[str] = []
    for word in example.split():
        if words and words[-1].startswith("-") and " " not in words[-1] and not word.startswith("-"):
            words[-1] += f" {word}"
        else:
            words.append(word)
    return words


def _folded(words: Sequence[str], indent: str, width: int | None = None) -> list[str]:
    """Wrap words to lines without breaking a word that contains spaces."""
    text = " ".join(word.replace(" ", "\0") for word in words)
    lines = textwrap.wrap(
        text, width or _width(), subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )
    return [line.replace("\0", " ") for line in lines]


def _typed(kind: type, name: str) -> Callable[[str], Any]:
    """A function that reads a value of that type, with its name in the error."""

    def read(text: str) -> Any:
        try:
            return kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not {name}") from None

    return read
