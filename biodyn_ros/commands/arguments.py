"""What `biodyn` may be told: subcommands with their options, those of settings as their fields describe themselves."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, Final, TypeVar

from biodyn_core.settings import Range, described
from biodyn_ros.commands.help_texts import HELP
from biodyn_ros.commands.parsing import CommandParser, Parser, WholeParser

T = TypeVar("T")

SHELLS: Final = ("bash", "zsh", "fish")


def parser(names: Iterable[str] | None = None) -> Parser:
    """These subcommands, or all; which one was given is `command` of what it parses.

    Each costs what its settings import, so whoever knows which one is asked for names it.
    """
    from biodyn_ros import __version__

    whole = WholeParser()
    whole.add_argument("--version", action="version", version=f"biodyn {__version__}", help="show the version")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=CommandParser)
    for name in ADDERS if names is None else names:
        ADDERS[name](commands)
    return whole


def _add_demo(commands: Any) -> None:
    # Without --json: it is for looking at while it runs; `biodyn replay --json` has its figures.
    command = _command(commands, "demo", json=False)
    command.add_argument("--out", default="out", metavar="DIR", help="directory of report and bag (default out)")
    command.add_argument("--subject", default="subject_1", metavar="S", help="subject file or bundled name")


def _add_live(commands: Any) -> None:
    # Everything behind its name belongs to ROS, and is not parsed here.
    command = _command(commands, "live", json=False)
    command.usage = "biodyn live [--ros-args ...]"
    command.description += "\nIts parameters with ranges: python -m biodyn_ros.parameters_yaml > live.yaml"


def _add_page(commands: Any) -> None:
    from biodyn_ros.dashboard.settings import ServingSettings

    # Without --json: it serves, and has no result.
    command = _command(commands, "page", json=False)
    command.add_argument("--node", default="/biodyn", metavar="NAME", help="full name of the node (default /biodyn)")
    command.add_argument("--until-input-ends", action="store_true", help="stop when standard input ends, too")
    _add_settings(command, "serving", ServingSettings, ("page_host", "page_port"))


def _add_completion(commands: Any) -> None:
    # Without --json: a script for a shell is text by its nature.
    command = _command(commands, "completion", json=False)
    command.add_argument("shell", choices=SHELLS, help="the shell that is to run the script")


def _add_simulate(commands: Any) -> None:
    from biodyn_core.synthesis import CASE_S, CASES, SensorSettings

    command = _command(commands, "simulate")
    _add_subject(command)
    source = command.add_mutually_exclusive_group(required=True)
    source.add_argument("--seat", metavar="FILE", help="measured seat motion: CSV, or a bag")
    source.add_argument("--case", metavar="CASES", help=f"drawn load cases, in a row: {','.join(CASES)}")
    command.add_argument("--seat-rate", type=float, metavar="HZ", help="rate of a CSV without a time column")
    command.add_argument(
        "--seconds", type=float, metavar="N", help=f"length of each case (default {CASE_S:g}), or of the file used"
    )
    _add_seed(command, "of everything drawn")
    command.add_argument("--compression", choices=("none", "lz4", "zstd"), default="zstd", help="of the bag's chunks")
    _add_map(command)
    _add_time(command)
    _add_settings(command, "sensors", SensorSettings)
    command.add_argument("-o", "--output", required=True, metavar="BAG", help="FILE.mcap, or a directory")


def _add_import(commands: Any) -> None:
    from biodyn_core.dual_range import DualRangeSettings

    command = _command(commands, "import-blue-trident")
    command.add_argument("exports", metavar="DIR", help="directory of one recording's CSV files, or one file")
    command.add_argument(
        "--map", action="append", default=[], metavar="SENSOR=SERIAL", help="which sensor it is, such as seat=TS-02374"
    )
    command.add_argument(
        "--map-file", metavar="FILE.yaml", help="the same from a file of lines such as 'seat: TS-02374'"
    )
    command.add_argument("--take", metavar="TAKE", help="which one of several: date (Capture.U) or file name (Nexus)")
    command.add_argument(
        "--start",
        metavar="TIME",
        help="of the first row of Nexus: ISO 8601 with its zone, or Unix seconds (default: none)",
    )
    command.add_argument("--no-high-g", action="store_true", help="leave clipped samples clipped")
    command.add_argument("--compression", choices=("none", "lz4", "zstd"), default="zstd", help="of the bag's chunks")
    _add_settings(command, "two ranges", DualRangeSettings)
    command.add_argument("-o", "--output", required=True, metavar="BAG", help="FILE.mcap, or a directory")


def _add_info(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings

    command = _command(commands, "info")
    _add_bag(command)
    _add_map(command)
    _add_time(command)
    _add_settings(command, "conditioning", ConditioningSettings)


def _add_play(commands: Any) -> None:
    from biodyn_ros.playback import PlayerSettings

    command = _command(commands, "play")
    _add_bag(command)
    _add_settings(command, "playing", PlayerSettings, ("rate", "loop", "clock", "keep_stamps", "wait_s"))


def _add_replay(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.pipeline_settings import PipelineSettings

    command = _command(commands, "replay")
    _add_bag(command)
    _add_subject(command)
    _add_map(command)
    _add_time(command)
    command.add_argument("--limits", metavar="FILE", help="limits file (default: 2002/44/EC)")
    command.add_argument(
        "--zero-phase", action="store_true", help="filter forward and backward, as identification does; labelled so"
    )
    command.add_argument("--project", action="store_true", help="project exposure to 8 h from less than 20 minutes too")
    command.add_argument("--no-predicted", action="store_true", help="leave out predicted.mcap")
    command.add_argument("--no-report", action="store_true", help="leave out report.html")
    _add_settings(command, "conditioning", ConditioningSettings)
    _add_settings(command, "pipeline", PipelineSettings, ("yaw_deg", "vertical", "also_weighted", "window_s"))
    command.add_argument("-o", "--output", required=True, metavar="DIR", help="directory of the results")


def _add_fit(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.identification.objectives import SurrogateSettings
    from biodyn_core.identification.phase1 import SwarmSettings
    from biodyn_core.identification.problem import CaseSettings
    from biodyn_core.identification.settings import FitSettings
    from biodyn_core.identification.uncertainty import UncertaintySettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_core.response import SpectrumSettings

    command = _command(commands, "fit")
    command.add_argument("bag", nargs="*", metavar="BAG", help="one or more of each loading condition")
    command.add_argument(
        "--subject", metavar="S", help="who it is: a subject file, whose parameters may be missing, or a bundled name"
    )
    command.add_argument("--campaign", metavar="FILE", help="many subjects, from a file; -o is then a directory")
    _add_held_out(command, "bags that are only predicted")
    command.add_argument(
        "--profile", action="append", default=[], metavar="NAME",
        help="profile the likelihood of a parameter, such as natural_frequency_hz[head], or of all",
    )  # fmt: skip
    command.add_argument("--paper", action="store_true", help="the paper's way; single options still change it")
    command.add_argument(
        "--no-report", action="store_true", help="leave out OUT.fit.html and, of a campaign, campaign.html"
    )
    _add_seed(command, "of the swarms")
    command.add_argument("--resume", action="store_true", help="take up what an interrupted fit left")
    command.add_argument(
        "--executor", default="processes", metavar="WHERE",
        help="none, processes[:N], threads[:N] or a Dask scheduler's tcp://HOST:PORT, on trusted networks only"
        " (default processes)",
    )  # fmt: skip
    _add_map(command)
    _add_time(command)
    _add_vertical(command)
    for title, kind in (
        ("fitting", FitSettings),
        ("phase 1", SwarmSettings),
        ("surrogate", SurrogateSettings),
        ("spectra", SpectrumSettings),
        ("cases", CaseSettings),
        ("uncertainty", UncertaintySettings),
        ("conditioning", ConditioningSettings),
        ("recording", RecordingSettings),
    ):
        _add_settings(command, title, kind)
    command.add_argument(
        "-o", "--output", required=True, metavar="OUT.yaml", help="the subject; OUT.fit.json and OUT.fit.html beside it"
    )


def _add_compare(commands: Any) -> None:
    from biodyn_core.identification.compare import THRESHOLD_PERCENT

    command = _command(commands, "compare")
    command.add_argument("first", metavar="A", help="subject file or bundled name; deviations are from it")
    command.add_argument("second", metavar="B", help="the other subject")
    command.add_argument(
        "--threshold", type=float, default=THRESHOLD_PERCENT, metavar="PERCENT",
        help=f"deviation from which a parameter diverges (default {THRESHOLD_PERCENT:g} %%)",
    )  # fmt: skip


def _add_validate(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_core.response import SpectrumSettings
    from biodyn_ros.validate.findings import ValidationSettings

    command = _command(commands, "validate")
    _add_bag(command)
    _add_subject(command)
    _add_map(command)
    _add_time(command)
    command.add_argument("--case", metavar="CASE", help="loading condition (default: by the bag's name)")
    _add_vertical(command)
    command.add_argument(
        "--seat-force", choices=("inertia", "joint", "paper"), default="inertia", help="form of the force at the seat"
    )
    command.add_argument("--as-printed", action="store_true", help="forces under cascade masses too, labelled")
    for title, kind in (
        ("conditioning", ConditioningSettings),
        ("recording", RecordingSettings),
        ("spectra", SpectrumSettings),
        ("judging", ValidationSettings),
    ):
        _add_settings(command, title, kind)
    command.add_argument("--no-report", action="store_true", help="leave out validate.html")
    command.add_argument("-o", "--output", metavar="DIR", help="directory for validate.json and validate.html")


def _add_trace(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.identification.problem import CaseSettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_core.response import SpectrumSettings
    from biodyn_core.tracing.background import BackgroundSettings
    from biodyn_core.tracing.departures import UsualSettings
    from biodyn_core.tracing.gate import FloorSettings
    from biodyn_core.tracing.rows import WeightSettings
    from biodyn_core.tracing.settings import TraceSettings

    command = _command(commands, "trace")
    command.add_argument("bag", nargs="*", metavar="BAG", help="several of each loading condition")
    command.add_argument(
        "--subject", required=True, metavar="S", help="who it is: a subject file, fitted or not, or a bundled name"
    )
    _add_held_out(command, "bags that have no say in the effect (default: every second one of each condition)")
    _add_seed(command, "of everything drawn")
    command.add_argument(
        "--fresh", action="store_true", help="compute anew what DIR.kept.json holds of an interrupted or earlier trace"
    )
    command.add_argument("--no-report", action="store_true", help="leave out trace.html")
    _add_map(command)
    _add_time(command)
    _add_vertical(command)
    for title, kind in (
        ("tracing", TraceSettings),
        ("least data", FloorSettings),
        ("background", BackgroundSettings),
        ("weights", WeightSettings),
        ("usual departures", UsualSettings),
        ("spectra", SpectrumSettings),
        ("cases", CaseSettings),
        ("conditioning", ConditioningSettings),
        ("recording", RecordingSettings),
    ):
        _add_settings(command, title, kind)
    command.add_argument("-o", "--output", required=True, metavar="DIR", help="directory of the results")


def _command(commands: Any, name: str, json: bool = True) -> CommandParser:
    line = HELP[name].line
    command: CommandParser = commands.add_parser(name, help=line, description=line[0].upper() + line[1:] + ".")
    if json:
        command.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    return command


def _add_bag(command: CommandParser) -> None:
    command.add_argument("bag", metavar="BAG", help="a .mcap or .db3 file, or the directory of a recording")


def _add_subject(command: CommandParser) -> None:
    command.add_argument("--subject", required=True, metavar="S", help="subject file, or the name of a bundled one")


def _add_map(command: CommandParser) -> None:
    command.add_argument(
        "--map", action="append", default=[], metavar="SENSOR=TOPIC", help="which topic is which sensor"
    )


def _add_time(command: CommandParser) -> None:
    text = "whose stamps count; log also where the header's are zero (default header)"
    command.add_argument("--time", choices=("header", "log"), default="header", help=text)


def _add_seed(command: CommandParser, text: str) -> None:
    command.add_argument("--seed", type=_seed, default=0, metavar="N", help=f"{text} (default 0)")


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from 0 on")
    return int(text)


def _add_held_out(command: CommandParser, text: str) -> None:
    command.add_argument("--hold-out", nargs="+", action="extend", default=[], metavar="BAG", help=text)
    command.add_argument(
        "--case", action="append", default=[], metavar="BAG=CASE", help="a bag's loading condition (default: its name)"
    )


def _add_vertical(command: CommandParser) -> None:
    command.add_argument(
        "--vertical",
        default="",
        metavar="TEXT",
        help="which way is up along sensors' axes, where gravity shall not tell, such as 'seat=0,0,1'",
    )


def _add_settings(command: CommandParser, title: str, kind: type[Any], everyday: Iterable[str] = ()) -> None:
    """One option per field of a settings dataclass, described as the field describes itself; absent unless given.

    everyday: the fields whose options stand among those that -h shows.
    """
    often, group = set(everyday), None
    for item in described(kind):
        allowed: Range = item.metadata["range"]
        default = "none" if item.default is None else f"{item.default:g}" if _is_number(item.default) else item.default
        how: dict[str, Any] = {"metavar": "TEXT", "help": f"{allowed.meaning} (default {default or 'none'})"}
        if isinstance(item.default, bool):
            action = argparse.BooleanOptionalAction if item.default else "store_true"
            how = {"action": action, "help": allowed.meaning}
        elif allowed.choices:
            how = {"choices": allowed.choices, "help": f"{allowed.meaning} (default {default})"}
        elif not isinstance(item.default, str):
            unit = f" {allowed.unit}" if allowed.unit else ""
            text = f"{allowed.meaning} ({allowed.lower:g} to {allowed.upper:g}{unit}, default {default})".replace(
                "%", "%%"
            )
            how = {"type": float if item.default is None else type(item.default), "metavar": "N", "help": text}
        if item.name not in often and group is None:
            group = command.tuning(title)
        place = command if item.name in often else group
        place.add_argument("--" + item.name.replace("_", "-"), default=argparse.SUPPRESS, **how)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def settings_of(options: argparse.Namespace, kind: type[T], base: T | None = None) -> T:
    """The settings that were given, over the base's or the defaults."""
    given = {item.name: getattr(options, item.name) for item in described(kind) if hasattr(options, item.name)}
    return kind(**given) if base is None else dataclasses.replace(base, **given)  # type: ignore[type-var]


ADDERS: Final[dict[str, Callable[[Any], None]]] = {
    "import-blue-trident": _add_import,
    "info": _add_info,
    "simulate": _add_simulate,
    "demo": _add_demo,
    "live": _add_live,
    "page": _add_page,
    "play": _add_play,
    "replay": _add_replay,
    "fit": _add_fit,
    "compare": _add_compare,
    "validate": _add_validate,
    "trace": _add_trace,
    "completion": _add_completion,
}
"""What adds each subcommand, with the imports that its settings cost."""
