"""Shared by several subcommands of `biodyn`: options, options from settings dataclasses, and output of results."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from biodyn_core.base.errors import InputError
from biodyn_core.base.settings import Range, described
from biodyn_core.base.wording import counted
from biodyn_ros.commands.parsing import CommandParser

if TYPE_CHECKING:
    from biodyn_ros.reading.parts import Bag
    from biodyn_ros.reading.recordings import RecordingOptions

T = TypeVar("T")

AUTO: Final = "auto"
"""In the place of held-out bags: they are drawn."""


def add_bag(command: CommandParser) -> None:
    """Add the bag to read."""
    command.add_argument("bag", metavar="BAG", help="a .mcap or .db3 file, or the directory of a recording")


def each_with_directory(given: str, output: Path | None) -> list[tuple[Bag, Path | None]]:
    """The bag and its directory of results; of an events file every event, each with a directory of its name."""
    from biodyn_ros.reading.given import bags_of
    from biodyn_ros.reading.parts import part_of

    bags = bags_of([given])
    names = [part_of(bag).name or f"event_{number:02d}" for number, bag in enumerate(bags, 1)]
    if not is_events(given):
        return [(bag, output) for bag in bags]
    return [(bag, output and output / name) for bag, name in zip(bags, names, strict=True)]


def is_events(given: str) -> bool:
    """Whether a bag on the command line is an events file."""
    from biodyn_ros.reading.events_file import is_events_file

    return is_events_file(given)


Result = tuple[dict[str, Any], str]
"""The result of a command as JSON and as text."""


def run_each(options: argparse.Namespace, output: Path | None, run: Callable[[Bag, Path | None], Result]) -> None:
    """Run a command on a bag, or on every event of a file, and print its results.

    An event that cannot be used is reported, and the others go on; raises InputError for a bag, or for no usable event.
    """
    given = each_with_directory(options.bag, output)
    if not is_events(options.bag):
        show(options, *run(*given[0]))
        return
    found, refused = [], []
    for bag, directory in given:
        try:
            found.append(run(bag, directory))
        except InputError as error:
            refused.append(f"{bag}: {str(error).removeprefix(f'{bag}: ')}")
            print(f"left out: {refused[-1]}", file=sys.stderr)
    if not found:
        raise InputError(f"none of {counted(len(given), 'event')} can be used; the first: {refused[0]}")
    show(options, {"events": [document for document, _ in found]}, "\n\n".join(text for _, text in found))


def add_subject(command: CommandParser) -> None:
    """Add the option for the subject."""
    command.add_argument("--subject", required=True, metavar="S", help="subject file, or the name of a bundled one")


def add_map(command: CommandParser) -> None:
    """Add the option that maps topics to sensors."""
    command.add_argument("--map", action="append", default=[], metavar="SENSOR=TOPIC", help="the topic of a sensor")


def add_time(command: CommandParser) -> None:
    """Add the option for the time of samples."""
    text = "header stamps or log times; log also if header stamps are zero (default header)"
    command.add_argument("--time", choices=("header", "log"), default="header", help=text)


def add_cases(command: CommandParser) -> None:
    """Add the options for loading conditions, and for sessions that are refused otherwise."""
    command.add_argument(
        "--cases",
        default="seat",
        metavar="HOW",
        help="loading conditions: by the seat's motion (seat), by the bag's marks (marks), or for one session by a file"
        " with the columns start,end,case (default seat)",
    )
    text = "accept sessions that are refused otherwise: no-rest, one-condition, late-sensor, separated by commas"
    command.add_argument("--allow", default="", metavar="REASON", help=text)


def add_seed(command: CommandParser, text: str) -> None:
    """Add the option for the seed of random numbers."""
    command.add_argument("--seed", type=_seed, default=0, metavar="N", help=f"{text} (default 0)")


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number >= 0")
    return int(text)


def add_executor(command: CommandParser) -> None:
    """Add the option for the executor of independent tasks."""
    command.add_argument(
        "--executor", default="processes", metavar="WHERE",
        help="none, processes[:N], threads[:N] or a Dask scheduler's tcp://HOST:PORT, on trusted networks only"
        " (default processes)",
    )  # fmt: skip


def add_held_out(command: CommandParser, text: str) -> None:
    """Add the options for held-out bags and for loading conditions."""
    command.add_argument(
        "--hold-out", nargs="+", action="extend", default=[], metavar="BAG",
        help=f"{text}; auto: draw them by condition, level and time",
    )  # fmt: skip
    command.add_argument(
        "--case", action="append", default=[], metavar="BAG=CASE", help="a bag's loading condition (default: its name)"
    )


def held_out_of(options: argparse.Namespace) -> tuple[tuple[Bag, ...], bool]:
    """The held-out bags, and whether they are to be drawn; raises InputError for both."""
    from biodyn_ros.reading.given import bags_of

    if AUTO not in options.hold_out:
        return tuple(bags_of(options.hold_out)), False
    if options.hold_out != [AUTO]:
        raise InputError("--hold-out auto: draws from the bags that are given: name no further ones")
    return (), True


def add_reading(command: CommandParser) -> None:
    """Add the options for reading recordings; `reading_of` evaluates them."""
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_core.recording.recording_settings import RecordingSettings

    add_map(command)
    add_time(command)
    add_vertical(command)
    add_settings(command, "conditioning", ConditioningSettings)
    add_settings(command, "recording", RecordingSettings)


def add_vertical(command: CommandParser) -> None:
    """Add the option for the verticals of sensors."""
    command.add_argument(
        "--vertical",
        default="",
        metavar="TEXT",
        help="vertical in sensors' axes, such as 'seat=0,0,1' (default: from gravity)",
    )


def add_settings(command: CommandParser, title: str, kind: type[Any], everyday: Iterable[str] = ()) -> None:
    """Add an option for each field of a settings dataclass, with the field's description; absent unless given.

    everyday: the fields whose options -h shows.
    """
    everyday, group = set(everyday), None
    for item in described(kind):
        allowed: Range = item.metadata["range"]
        default = item.default
        how: dict[str, Any]
        if isinstance(default, bool):
            if default:
                how = {"action": argparse.BooleanOptionalAction, "help": f"{allowed.meaning} (default yes)"}
            else:
                how = {"action": "store_true", "help": allowed.meaning}
        elif allowed.choices:
            how = {"choices": allowed.choices, "help": f"{allowed.meaning} (default {default})"}
        elif isinstance(default, str):
            how = {"metavar": "TEXT", "help": f"{allowed.meaning} (default {default or 'none'})"}
        else:
            unit, shown = f" {allowed.unit}" if allowed.unit else "", "none" if default is None else f"{default:g}"
            text = f"{allowed.meaning} ({allowed.lower:g} to {allowed.upper:g}{unit}, default {shown})"
            kind_of = float if default is None else type(default)
            how = {"type": kind_of, "metavar": "N", "help": text.replace("%", "%%")}
        if item.name not in everyday and group is None:
            group = command.tuning(title)
        place = command if item.name in everyday else group
        place.add_argument("--" + item.name.replace("_", "-"), default=argparse.SUPPRESS, **how)


def settings_of(options: argparse.Namespace, kind: type[T], base: T | None = None) -> T:
    """The given settings, over the base's or the defaults."""
    given = {item.name: getattr(options, item.name) for item in described(kind) if hasattr(options, item.name)}
    return kind(**given) if base is None else dataclasses.replace(base, **given)  # type: ignore[type-var]


def add_all_settings(command: CommandParser, kinds: Mapping[str, type[Any]]) -> None:
    """Add the options of several settings dataclasses, each under its title."""
    for title, kind in kinds.items():
        add_settings(command, title, kind)


def all_settings(
    options: argparse.Namespace, kinds: Mapping[str, type[Any]], bases: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The given settings by title, over that title's base or the defaults."""
    return {title: settings_of(options, kind, (bases or {}).get(title)) for title, kind in kinds.items()}


def reading_of(options: argparse.Namespace) -> RecordingOptions:
    """The options of `add_reading`."""
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_core.recording.recording_settings import RecordingSettings
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.reading.recordings import RecordingOptions

    return RecordingOptions(
        mapping=parse_map(options.map),
        time=options.time,
        vertical=options.vertical,
        conditioning=settings_of(options, ConditioningSettings),
        recording=settings_of(options, RecordingSettings),
    )


def check_reports(options: argparse.Namespace) -> None:
    """Raise InputError for a missing package of the report before the work starts."""
    if not options.no_report:
        from biodyn_ros.reports.pages import check_reports  # needs the extra `reports`

        check_reports()


def show(options: argparse.Namespace, document: dict[str, Any], text: str) -> None:
    """Print the result, as JSON with --json, else as text."""
    print(json.dumps(document, indent=2, allow_nan=False) if options.json else text)
