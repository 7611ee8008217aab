"""The `biodyn` command: a shell over functions. A known error is one line and exit code 2; results can be JSON."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from biodyn_core.errors import InputError
from biodyn_core.settings import Range

T = TypeVar("T")
Handler = Callable[[argparse.Namespace], int]

EXIT_INPUT, EXIT_INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["live"] and given[1:] not in (["-h"], ["--help"]):
        from biodyn_ros.live import main as live  # ROS reads its own arguments

        return live(given[1:])
    options = _parser().parse_args(given)
    try:
        handler: Handler = options.handler
        return handler(options)
    except InputError as error:
        print(f"biodyn {options.command}: {error}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print(f"biodyn {options.command}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return 0


# --- commands --------------------------------------------------------------------------------------------------------


def _demo(options: argparse.Namespace) -> int:
    from biodyn_ros.demo import demo

    return demo(Path(options.out), options.subject)


def _simulate(options: argparse.Namespace) -> int:
    from biodyn_core.subject import load_subject
    from biodyn_core.synthesis import SensorSettings
    from biodyn_ros.mapping import parse_map
    from biodyn_ros.resources import subject_file
    from biodyn_ros.seat_motion import read_seat_motion
    from biodyn_ros.simulate import motion_of_cases, simulate_bag

    subject = load_subject(subject_file(options.subject))
    if options.seat:
        mapping = parse_map(options.map)
        motion = read_seat_motion(options.seat, options.seat_rate, mapping, options.time).first(options.seconds)
    else:
        motion = motion_of_cases(options.case.split(","), options.seconds or 10.0, options.seed)
    result = simulate_bag(
        Path(options.output), subject, motion, options.seed, _settings(options, SensorSettings), options.compression
    )
    _print(
        options,
        dataclasses.asdict(result),
        f"{result.bag}: {result.messages} messages, {result.seconds:.1f} s, six IMUs",
    )
    return 0


def _play(options: argparse.Namespace) -> int:
    from biodyn_ros.playback import PlayerSettings
    from biodyn_ros.player import play

    try:
        played = play(Path(options.bag), _settings(options, PlayerSettings))
    except KeyboardInterrupt:
        return 0
    count, topics = sum(played.messages.values()), len(played.messages)
    text = f"{options.bag}: {count} messages on {topics} topics in {played.seconds:.1f} s"
    _print(options, dataclasses.asdict(played), text)
    return 0


def _info(options: argparse.Namespace) -> int:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_ros.info import InfoOptions, info, text_of
    from biodyn_ros.mapping import parse_map

    how = InfoOptions(parse_map(options.map), options.time, _settings(options, ConditioningSettings))
    document = info(options.bag, how, _progress("reading"))
    _print(options, document, text_of(document))
    return 0


def _replay(options: argparse.Namespace) -> int:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.limits import EU_LIMITS, load_limits
    from biodyn_core.pipeline import PipelineSettings
    from biodyn_core.subject import load_subject
    from biodyn_ros.mapping import parse_map
    from biodyn_ros.replay import ReplayOptions, replay_to_directory
    from biodyn_ros.resources import subject_file

    how = ReplayOptions(
        mapping=parse_map(options.map),
        time=options.time,
        conditioning=_settings(options, ConditioningSettings),
        pipeline=_settings(options, PipelineSettings),
        limits=load_limits(options.limits) if options.limits else EU_LIMITS,
        mode="zero_phase" if options.zero_phase else "causal",
        project=options.project,
    )
    subject = load_subject(subject_file(options.subject))
    progress = _progress("replaying")
    replayed = replay_to_directory(
        options.bag, subject, Path(options.output), how, progress=progress, report=not options.no_report,
        predicted=not options.no_predicted,
    )  # fmt: skip
    from biodyn_ros.summary import summary

    _print(options, replayed.document, summary(replayed.document))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from biodyn_core.identification.compare import compare
    from biodyn_core.subject import load_subject
    from biodyn_ros.comparison_text import comparison_document, text_of
    from biodyn_ros.resources import subject_file

    a, b = (load_subject(subject_file(name)) for name in (options.first, options.second))
    document = comparison_document(compare(a, b, options.threshold))
    _print(options, document, text_of(document))
    return 0


def _validate(options: argparse.Namespace) -> int:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_core.response import SpectrumSettings
    from biodyn_core.subject import load_subject
    from biodyn_ros.mapping import parse_map
    from biodyn_ros.recordings import RecordingOptions
    from biodyn_ros.resources import subject_file
    from biodyn_ros.validate import ValidateOptions, validate, validate_to_directory
    from biodyn_ros.validation_findings import ValidationSettings
    from biodyn_ros.validation_text import text_of

    how = ValidateOptions(
        case=options.case,
        reading=RecordingOptions(
            mapping=parse_map(options.map),
            time=options.time,
            vertical=options.vertical,
            conditioning=_settings(options, ConditioningSettings),
            recording=_settings(options, RecordingSettings),
        ),
        spectra=_settings(options, SpectrumSettings),
        limits=_settings(options, ValidationSettings),
        seat_force=options.seat_force,
        as_printed=options.as_printed,
    )
    subject, progress = load_subject(subject_file(options.subject)), _progress("validating")
    if options.output:
        validated = validate_to_directory(options.bag, subject, Path(options.output), how, progress)
    else:
        validated = validate(options.bag, subject, how, progress)
    _print(options, validated.document, text_of(validated.document))
    return 0


# --- parser ----------------------------------------------------------------------------------------------------------


def _parser() -> argparse.ArgumentParser:
    from biodyn_ros import __version__

    parser = argparse.ArgumentParser(prog="biodyn", description="Six IMUs on a seated person: model, exposure, replay.")
    parser.add_argument("--version", action="version", version=f"biodyn {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = _command(commands, "demo", _demo, "the main job on the bundled bag")
    demo.add_argument("--out", default="out", help="directory of report and predicted bag (default: out)")
    demo.add_argument("--subject", default="subject_1", help="subject file or bundled name")

    commands.add_parser("live", help="the live node; takes --ros-args", add_help=True)

    _add_simulate(commands)
    _add_info(commands)
    _add_play(commands)
    _add_replay(commands)
    _add_compare(commands)
    _add_validate(commands)
    return parser


def _add_simulate(commands: Any) -> None:
    from biodyn_core.synthesis import CASES, SensorSettings

    command = _command(commands, "simulate", _simulate, "a six-IMU bag from a subject and a seat motion")
    _add_subject(command)
    source = command.add_mutually_exclusive_group(required=True)
    source.add_argument("--seat", metavar="FILE", help="measured seat motion: CSV, or a bag")
    source.add_argument("--case", metavar="CASES", help=f"drawn load cases, in a row: {','.join(CASES)}")
    command.add_argument("--seat-rate", type=float, metavar="HZ", help="rate of a CSV without a time column")
    command.add_argument(
        "--seconds", type=float, metavar="N", help="length of each case (default 10), or of the file used"
    )
    command.add_argument("--seed", type=int, default=0, metavar="N", help="of everything drawn (default 0)")
    command.add_argument("--compression", choices=("none", "lz4", "zstd"), default="zstd", help="of the bag's chunks")
    _add_map(command)
    _add_time(command)
    _add_settings(command, "sensors", SensorSettings)
    command.add_argument("-o", "--output", required=True, metavar="BAG", help="FILE.mcap, or a directory")


def _add_info(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings

    command = _command(commands, "info", _info, "topics, rates, clocks, gaps, clipping, gravity; what replay would say")
    command.add_argument("bag", metavar="BAG")
    _add_map(command)
    _add_time(command)
    _add_settings(command, "conditioning", ConditioningSettings)


def _add_play(commands: Any) -> None:
    from biodyn_ros.playback import PlayerSettings

    command = _command(commands, "play", _play, "publishes a bag, stamps rebased to now")
    command.add_argument("bag", metavar="BAG")
    _add_settings(command, "playing", PlayerSettings)


def _add_replay(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.pipeline import PipelineSettings

    command = _command(commands, "replay", _replay, "the pipeline over a bag, as fast as it goes")
    command.add_argument("bag", metavar="BAG")
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
    _add_settings(command, "pipeline", PipelineSettings)
    command.add_argument("-o", "--output", required=True, metavar="DIR", help="directory of the results")


def _add_compare(commands: Any) -> None:
    from biodyn_core.identification.compare import THRESHOLD_PERCENT

    command = _command(commands, "compare", _compare, "which parameters two subjects share, and which are their own")
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
    from biodyn_ros.validation_findings import ValidationSettings

    command = _command(commands, "validate", _validate, "forward prediction of an event that was not fitted to")
    command.add_argument("bag", metavar="BAG")
    _add_subject(command)
    _add_map(command)
    _add_time(command)
    command.add_argument("--case", metavar="CASE", help="loading condition (default: by the bag's name)")
    command.add_argument("--vertical", default="", metavar="TEXT", help="where sensors' axes see up if not by gravity")
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
    command.add_argument("-o", "--output", metavar="DIR", help="directory for validate.json")


def _command(commands: Any, name: str, handler: Handler, text: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    command.set_defaults(handler=handler)
    command.add_argument("--json", action="store_true", help="print the result as JSON on stdout")
    return command


def _add_subject(command: argparse.ArgumentParser) -> None:
    command.add_argument("--subject", required=True, metavar="S", help="subject file, or the name of a bundled one")


def _add_map(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--map", action="append", default=[], metavar="SENSOR=TOPIC", help="which topic is which sensor"
    )


def _add_time(command: argparse.ArgumentParser) -> None:
    text = "whose stamps count; log also where the header's are zero (default header)"
    command.add_argument("--time", choices=("header", "log"), default="header", help=text)


def _add_settings(command: argparse.ArgumentParser, title: str, kind: type[Any]) -> None:
    """One option per field of a settings dataclass, described as the field describes itself."""
    group = command.add_argument_group(title)
    for item in dataclasses.fields(kind):
        allowed: Range = item.metadata["range"]
        flag = "--" + item.name.replace("_", "-")
        if isinstance(item.default, bool):
            group.add_argument(flag, action="store_true", default=item.default, help=allowed.meaning)
            continue
        if isinstance(item.default, str):
            group.add_argument(flag, default=item.default, metavar="TEXT", help=allowed.meaning)
            continue
        cast = float if item.default is None else type(item.default)
        default = "none" if item.default is None else f"{item.default:g}"
        unit = f" {allowed.unit}" if allowed.unit else ""
        text = f"{allowed.meaning} ({allowed.lower:g} to {allowed.upper:g}{unit}, default {default})"
        group.add_argument(flag, type=cast, default=item.default, metavar="N", help=text)


def _settings(options: argparse.Namespace, kind: type[T]) -> T:
    names = [item.name for item in dataclasses.fields(kind)]  # type: ignore[arg-type]
    return kind(**{name: getattr(options, name) for name in names})


def _print(options: argparse.Namespace, document: dict[str, Any], text: str) -> None:
    print(json.dumps(document, indent=2, allow_nan=False) if options.json else text)


def _progress(what: str) -> Callable[[int, int], None]:
    """A line on stderr, redrawn at every hundredth; silent where nobody watches."""
    if not sys.stderr.isatty():
        return lambda done, total: None
    shown = -1

    def progress(done: int, total: int) -> None:
        nonlocal shown
        percent = 100 * done // max(total, 1)
        if percent != shown:
            shown = percent
            print(f"\r{what}: {percent:3d} %", end="\n" if percent >= 100 else "", file=sys.stderr, flush=True)

    return progress


if __name__ == "__main__":
    sys.exit(main())
