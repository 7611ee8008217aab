"""The `biodyn` command: a shell over functions. A known error is one line and exit code 2; results can be JSON."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from biodyn_core.errors import InputError
from biodyn_core.settings import Range, described
from biodyn_ros.environment import ONE_THREAD
from biodyn_ros.progress import Progress

if TYPE_CHECKING:
    from biodyn_ros.fit import FitOptions
    from biodyn_ros.recordings import RecordingOptions
    from biodyn_ros.trace import TraceOptions

T = TypeVar("T")
Handler = Callable[[argparse.Namespace], int]

EXIT_INPUT, EXIT_INTERRUPTED = 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code."""
    os.environ.update(ONE_THREAD)  # before numpy loads
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
    with Progress("reading") as progress:
        document = info(options.bag, how, progress)
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
    with Progress("replaying") as progress:
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
    from biodyn_core.response import SpectrumSettings
    from biodyn_core.subject import load_subject
    from biodyn_ros.resources import subject_file
    from biodyn_ros.validate import ValidateOptions, validate, validate_to_directory
    from biodyn_ros.validation_findings import ValidationSettings
    from biodyn_ros.validation_text import text_of

    how = ValidateOptions(
        case=options.case,
        reading=_reading(options),
        spectra=_settings(options, SpectrumSettings),
        limits=_settings(options, ValidationSettings),
        seat_force=options.seat_force,
        as_printed=options.as_printed,
    )
    subject = load_subject(subject_file(options.subject))
    with Progress("validating") as progress:
        if options.output:
            validated = validate_to_directory(options.bag, subject, Path(options.output), how, progress)
        else:
            validated = validate(options.bag, subject, how, progress)
    _print(options, validated.document, text_of(validated.document))
    return 0


def _fit(options: argparse.Namespace) -> int:
    if options.campaign:
        return _fit_campaign(options)
    from biodyn_core.parameters import UNFITTED
    from biodyn_core.subject import load_subject
    from biodyn_ros.executors import executor_of
    from biodyn_ros.fit import check_output, fit_bags, write_fitted
    from biodyn_ros.fit_text import text_of
    from biodyn_ros.resources import subject_file
    from biodyn_ros.work import Work

    if not (options.bag and options.subject):
        raise InputError("BAG... and --subject are needed, or --campaign")
    output = Path(options.output)
    check_output(output)
    how = _fit_options(options)
    subject = load_subject(subject_file(options.subject), UNFITTED)
    checkpoint = output.with_name(f"{output.stem}.checkpoint.json")
    try:
        with executor_of(options.executor) as executor:
            work = Work(executor, checkpoint, options.resume)
            fitted = fit_bags(options.bag, subject, how, work)
    except KeyboardInterrupt:
        if checkpoint.exists():
            print(f"biodyn fit: {checkpoint} keeps what is done; --resume takes it up", file=sys.stderr)
        raise
    write_fitted(fitted, output)
    work.finish()
    _print(options, fitted.document, text_of(fitted.document))
    return 0


def _fit_campaign(options: argparse.Namespace) -> int:
    from biodyn_ros.campaign import check_failed, fit_campaign, text_of
    from biodyn_ros.campaign_file import load_campaign
    from biodyn_ros.executors import executor_of

    if options.bag or options.subject or options.hold_out or options.case:
        raise InputError("BAG, --subject, --hold-out and --case are each subject's own: give them in the campaign file")
    campaign, directory = load_campaign(options.campaign), Path(options.output)
    with executor_of(options.executor) as executor, Progress("fitting") as progress:
        document = fit_campaign(campaign, directory, _fit_options(options), executor, options.resume, progress)
    _print(options, document, text_of(document))
    check_failed(document, directory)
    return 0


def _fit_options(options: argparse.Namespace) -> FitOptions:
    from biodyn_core.identification.objectives import SurrogateSettings
    from biodyn_core.identification.phase1 import SwarmSettings
    from biodyn_core.identification.problem import CaseSettings
    from biodyn_core.identification.settings import PAPER, FitSettings
    from biodyn_core.identification.uncertainty import UncertaintySettings
    from biodyn_core.response import SpectrumSettings
    from biodyn_ros.fit import FitOptions, parse_cases

    base = PAPER if options.paper else FitSettings()
    settings = dataclasses.replace(
        _settings(options, FitSettings, base),
        swarm=_settings(options, SwarmSettings, base.swarm),
        surrogate=_settings(options, SurrogateSettings, base.surrogate),
    )
    return FitOptions(
        seed=options.seed,
        held_out=tuple(options.hold_out),
        cases=parse_cases(options.case),
        profiles=tuple(options.profile),
        reading=_reading(options),
        spectra=_settings(options, SpectrumSettings),
        preparing=_settings(options, CaseSettings),
        settings=settings,
        uncertainty=_settings(options, UncertaintySettings),
    )


def _trace(options: argparse.Namespace) -> int:
    from biodyn_core.parameters import UNFITTED
    from biodyn_core.subject import load_subject
    from biodyn_ros.kept import Kept
    from biodyn_ros.resources import subject_file
    from biodyn_ros.trace import check_directory, trace_bags, write_traced
    from biodyn_ros.trace_text import text_of

    directory, how = Path(options.output), _trace_options(options)
    check_directory(directory)
    if not options.no_report:
        from biodyn_ros.report import check_reports  # an extra of its own

        check_reports()
    subject = load_subject(subject_file(options.subject), UNFITTED)
    file = directory.with_name(f"{directory.name}.kept.json")
    kept = Kept(file, options.fresh)
    try:
        traced = trace_bags(options.bag, subject, how, kept=kept)
    except InputError:
        if not kept:
            file.unlink(missing_ok=True)
        raise
    except KeyboardInterrupt:
        print(f"biodyn trace: {file} keeps what is done; the same command goes on from there", file=sys.stderr)
        raise
    write_traced(traced, directory, report=not options.no_report)
    _print(options, traced.document, text_of(traced.document))
    return 0


def _trace_options(options: argparse.Namespace) -> TraceOptions:
    from biodyn_core.identification.problem import CaseSettings
    from biodyn_core.response import SpectrumSettings
    from biodyn_core.tracing.background import BackgroundSettings
    from biodyn_core.tracing.departures import UsualSettings
    from biodyn_core.tracing.gate import FloorSettings
    from biodyn_core.tracing.rows import WeightSettings
    from biodyn_core.tracing.settings import TraceSettings
    from biodyn_ros.fit import parse_cases
    from biodyn_ros.trace import TraceOptions

    settings = dataclasses.replace(
        _settings(options, TraceSettings),
        floor=_settings(options, FloorSettings),
        background=dataclasses.replace(
            _settings(options, BackgroundSettings),
            weights=_settings(options, WeightSettings),
            usual=_settings(options, UsualSettings),
        ),
    )
    return TraceOptions(
        seed=options.seed,
        held_out=tuple(options.hold_out),
        cases=parse_cases(options.case),
        reading=_reading(options),
        spectra=_settings(options, SpectrumSettings),
        preparing=_settings(options, CaseSettings),
        settings=settings,
    )


def _reading(options: argparse.Namespace) -> RecordingOptions:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_ros.mapping import parse_map
    from biodyn_ros.recordings import RecordingOptions

    return RecordingOptions(
        mapping=parse_map(options.map),
        time=options.time,
        vertical=options.vertical,
        conditioning=_settings(options, ConditioningSettings),
        recording=_settings(options, RecordingSettings),
    )


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
    _add_fit(commands)
    _add_compare(commands)
    _add_validate(commands)
    _add_trace(commands)
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


def _add_fit(commands: Any) -> None:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.identification.objectives import SurrogateSettings
    from biodyn_core.identification.phase1 import SwarmSettings
    from biodyn_core.identification.problem import CaseSettings
    from biodyn_core.identification.settings import FitSettings
    from biodyn_core.identification.uncertainty import UncertaintySettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_core.response import SpectrumSettings

    command = _command(commands, "fit", _fit, "recorded events to a subject, with how sure every number is")
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
    command.add_argument("--seed", type=int, default=0, metavar="N", help="of the swarms (default 0)")
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
    command.add_argument("-o", "--output", required=True, metavar="OUT.yaml", help="the subject; fit.json beside it")


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
    command.add_argument("-o", "--output", metavar="DIR", help="directory for validate.json")


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

    command = _command(commands, "trace", _trace, "recorded events to the effect that a subject's model lacks")
    command.add_argument("bag", nargs="*", metavar="BAG", help="several of each loading condition")
    command.add_argument(
        "--subject", required=True, metavar="S", help="who it is: a subject file, fitted or not, or a bundled name"
    )
    _add_held_out(command, "bags that have no say in the effect (default: every second one of each condition)")
    command.add_argument("--seed", type=int, default=0, metavar="N", help="of everything drawn (default 0)")
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


def _add_held_out(command: argparse.ArgumentParser, text: str) -> None:
    command.add_argument("--hold-out", nargs="+", action="extend", default=[], metavar="BAG", help=text)
    command.add_argument(
        "--case", action="append", default=[], metavar="BAG=CASE", help="a bag's loading condition (default: its name)"
    )


def _add_vertical(command: argparse.ArgumentParser) -> None:
    command.add_argument("--vertical", default="", metavar="TEXT", help="where sensors' axes see up if not by gravity")


def _add_settings(command: argparse.ArgumentParser, title: str, kind: type[Any]) -> None:
    """One option per field of a settings dataclass, described as the field describes itself; absent unless given."""
    group = command.add_argument_group(title)
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
        group.add_argument("--" + item.name.replace("_", "-"), default=argparse.SUPPRESS, **how)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _settings(options: argparse.Namespace, kind: type[T], base: T | None = None) -> T:
    """The settings that were given, over the base's or the defaults."""
    given = {item.name: getattr(options, item.name) for item in described(kind) if hasattr(options, item.name)}
    return kind(**given) if base is None else dataclasses.replace(base, **given)  # type: ignore[type-var]


def _print(options: argparse.Namespace, document: dict[str, Any], text: str) -> None:
    print(json.dumps(document, indent=2, allow_nan=False) if options.json else text)


if __name__ == "__main__":
    sys.exit(main())
