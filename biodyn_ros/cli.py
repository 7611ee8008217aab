"""The `biodyn` command: a shell over functions. A known error is one line and exit code 2; results can be JSON."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from biodyn_core.errors import InputError
from biodyn_ros.commands.arguments import ADDERS, parser, settings_of
from biodyn_ros.commands.parsing import EXIT_INPUT
from biodyn_ros.environment import ONE_THREAD
from biodyn_ros.nearby import did_you_mean
from biodyn_ros.progress import Progress

if TYPE_CHECKING:
    from biodyn_ros.fit.fitting import FitOptions
    from biodyn_ros.reading.recordings import RecordingOptions
    from biodyn_ros.trace.tracing import TraceOptions

Handler = Callable[[argparse.Namespace], int]

EXIT_INTERRUPTED: Final = 130
TOP_LEVEL: Final = ("-h", "--help", "--version")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code."""
    os.environ.update(ONE_THREAD)  # before numpy loads
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["help"]:
        given = [*given[1:2], "-h"]
    if given[:1] == ["live"] and given[1:2] not in (["-h"], ["--help"], ["--help-all"]):
        return _live(given[1:])
    command = given[0] if given else ""
    try:
        options = _parsed(given)  # imports too, for some seconds in which one may change one's mind
        return HANDLERS[options.command](options)
    except InputError as error:
        print(f"biodyn {command}: {error}", file=sys.stderr)
        return EXIT_INPUT
    except KeyboardInterrupt:
        print(f"biodyn {command}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return 0
    except OSError as error:  # a name that no file can have, a disk that is full: what the machine refuses is told too
        told = ": ".join(str(part) for part in (error.filename, error.strerror) if part)
        print(f"biodyn {command}: {InputError(told)}", file=sys.stderr)
        return EXIT_INPUT


def _parsed(given: list[str]) -> argparse.Namespace:
    """What was asked for; only the subcommand that was named is built, because its settings cost imports."""
    name = given[0] if given else ""
    asked = parser([name] if name in ADDERS else [])
    if not name:
        asked.error("what to do is missing")
    if name not in ADDERS and name not in TOP_LEVEL:
        kind = "option" if name.startswith("-") else "command"
        near = did_you_mean(name, ADDERS)
        asked.error(f"there is no {kind} {name}{';' if near else ''}{near}")
    return asked.parse_args(given)


def _live(arguments: list[str]) -> int:
    """The live node, whose arguments ROS reads; what ROS would pass over without a word is refused."""
    if arguments[:1] not in ([], ["--ros-args"]):
        parser(["live"]).parse_args(["live", *arguments])
    from biodyn_ros.live import main as live

    return live(arguments)


def _completion(options: argparse.Namespace) -> int:
    from biodyn_ros.commands.completion import script

    print(script(options.shell))
    return 0


def _demo(options: argparse.Namespace) -> int:
    from biodyn_ros.demo import demo

    return demo(Path(options.out), options.subject)


def _page(options: argparse.Namespace) -> int:
    from biodyn_ros.dashboard.settings import ServingSettings, check_page

    check_page()
    from biodyn_ros.dashboard.site import serve  # an extra of its own

    def told(link: str) -> None:
        print(f"the page of {options.node}: {link}", flush=True)

    serve(options.node, settings_of(options, ServingSettings), told, options.until_input_ends)
    return 0


def _simulate(options: argparse.Namespace) -> int:
    from biodyn_core.subject import load_subject
    from biodyn_core.synthesis import CASE_S, SensorSettings
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.reading.seat_motion import read_seat_motion
    from biodyn_ros.resources import subject_file
    from biodyn_ros.simulate import motion_of_cases, simulate_bag

    subject = load_subject(subject_file(options.subject))
    if options.seat:
        mapping = parse_map(options.map)
        motion = read_seat_motion(options.seat, options.seat_rate, mapping, options.time).first(options.seconds)
    else:
        seconds = CASE_S if options.seconds is None else options.seconds
        motion = motion_of_cases(options.case.split(","), seconds, options.seed)
    sensors = settings_of(options, SensorSettings)
    with Progress("writing") as progress:
        result = simulate_bag(
            Path(options.output), subject, motion, options.seed, sensors, options.compression, progress
        )
    _print(
        options,
        dataclasses.asdict(result),
        f"{result.bag}: {result.messages} messages, {result.seconds:.1f} s, six IMUs",
    )
    return 0


def _import_blue_trident(options: argparse.Namespace) -> int:
    from biodyn_core.dual_range import DualRangeSettings
    from biodyn_ros.blue_trident import ImportOptions, import_blue_trident, text_of
    from biodyn_ros.blue_trident.found import parse_serials
    from biodyn_ros.blue_trident.starting import parse_start

    how = ImportOptions(
        mapping=parse_serials(options.map, options.map_file),
        take=options.take,
        start_ns=parse_start(options.start) if options.start else None,
        high_g=not options.no_high_g,
        settings=settings_of(options, DualRangeSettings),
        compression=options.compression,
    )
    with Progress("importing") as progress:
        document = import_blue_trident(Path(options.exports), Path(options.output), how, progress)
    _print(options, document, text_of(document))
    return 0


def _play(options: argparse.Namespace) -> int:
    from biodyn_ros.playback import PlayerSettings
    from biodyn_ros.player import play

    try:
        with Progress("playing") as progress:
            played = play(Path(options.bag), settings_of(options, PlayerSettings), progress)
    except KeyboardInterrupt:
        return 0
    count, topics = sum(played.messages.values()), len(played.messages)
    text = f"{options.bag}: {count} messages on {topics} topics in {played.seconds:.1f} s"
    _print(options, dataclasses.asdict(played), text)
    return 0


def _info(options: argparse.Namespace) -> int:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_ros.info import info, text_of
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.reading.sensors import ReadingOptions

    how = ReadingOptions(parse_map(options.map), options.time, settings_of(options, ConditioningSettings))
    with Progress("reading") as progress:
        document = info(options.bag, how, progress)
    _print(options, document, text_of(document))
    return 0


def _replay(options: argparse.Namespace) -> int:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.limits import EU_LIMITS, load_limits
    from biodyn_core.pipeline_settings import PipelineSettings
    from biodyn_core.subject import load_subject
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.replay.replaying import ReplayOptions, replay_to_directory
    from biodyn_ros.resources import subject_file

    how = ReplayOptions(
        mapping=parse_map(options.map),
        time=options.time,
        conditioning=settings_of(options, ConditioningSettings),
        pipeline=settings_of(options, PipelineSettings),
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
    from biodyn_ros.replay.text import summary

    _print(options, replayed.document, summary(replayed.document))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from biodyn_core.identification.compare import compare
    from biodyn_core.subject import load_subject
    from biodyn_ros.fit.comparison import comparison_document, text_of
    from biodyn_ros.resources import subject_file

    a, b = (load_subject(subject_file(name)) for name in (options.first, options.second))
    document = comparison_document(compare(a, b, options.threshold))
    _print(options, document, text_of(document))
    return 0


def _validate(options: argparse.Namespace) -> int:
    from biodyn_core.response import SpectrumSettings
    from biodyn_core.subject import load_subject
    from biodyn_ros.resources import subject_file
    from biodyn_ros.validate.findings import ValidationSettings
    from biodyn_ros.validate.text import text_of
    from biodyn_ros.validate.validating import ValidateOptions, validate, validate_to_directory

    how = ValidateOptions(
        case=options.case,
        reading=_reading(options),
        spectra=settings_of(options, SpectrumSettings),
        limits=settings_of(options, ValidationSettings),
        seat_force=options.seat_force,
        as_printed=options.as_printed,
    )
    subject = load_subject(subject_file(options.subject))
    with Progress("validating") as progress:
        if options.output:
            validated = validate_to_directory(
                options.bag, subject, Path(options.output), how, progress, report=not options.no_report
            )
        else:
            validated = validate(options.bag, subject, how, progress)
    _print(options, validated.document, text_of(validated.document))
    return 0


def _fit(options: argparse.Namespace) -> int:
    if options.campaign:
        return _fit_campaign(options)
    from biodyn_core.parameters import UNFITTED
    from biodyn_core.subject import load_subject
    from biodyn_ros.fit.fitting import check_output, fit_bags, write_fit_page, write_fitted
    from biodyn_ros.fit.text import text_of
    from biodyn_ros.resources import subject_file
    from biodyn_ros.work.executors import executor_of
    from biodyn_ros.work.tasks import Work

    if not (options.bag and options.subject):
        raise InputError("BAG... and --subject are needed, or --campaign; biodyn fit -h shows how")
    output = Path(options.output)
    check_output(output)
    _check_reports(options)
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
    if not options.no_report:
        write_fit_page(fitted, output)
    return 0


def _fit_campaign(options: argparse.Namespace) -> int:
    from biodyn_ros.fit.campaign import check_failed, fit_campaign, text_of, write_campaign_page
    from biodyn_ros.fit.campaign_file import load_campaign
    from biodyn_ros.work.executors import executor_of

    if options.bag or options.subject or options.hold_out or options.case:
        raise InputError("BAG, --subject, --hold-out and --case are each subject's own: give them in the campaign file")
    campaign, directory = load_campaign(options.campaign), Path(options.output)
    _check_reports(options)
    with executor_of(options.executor) as executor, Progress("fitting") as progress:
        document = fit_campaign(
            campaign, directory, _fit_options(options), executor, options.resume, progress, not options.no_report
        )
    _print(options, document, text_of(document))
    if not options.no_report:
        write_campaign_page(document, directory)
    check_failed(document, directory)
    return 0


def _fit_options(options: argparse.Namespace) -> FitOptions:
    from biodyn_core.identification.objectives import SurrogateSettings
    from biodyn_core.identification.phase1 import SwarmSettings
    from biodyn_core.identification.problem import CaseSettings
    from biodyn_core.identification.settings import PAPER, FitSettings
    from biodyn_core.identification.uncertainty import UncertaintySettings
    from biodyn_core.response import SpectrumSettings
    from biodyn_ros.fit.fitting import FitOptions, parse_cases

    base = PAPER if options.paper else FitSettings()
    settings = dataclasses.replace(
        settings_of(options, FitSettings, base),
        swarm=settings_of(options, SwarmSettings, base.swarm),
        surrogate=settings_of(options, SurrogateSettings, base.surrogate),
    )
    return FitOptions(
        seed=options.seed,
        held_out=tuple(options.hold_out),
        cases=parse_cases(options.case),
        profiles=tuple(options.profile),
        reading=_reading(options),
        spectra=settings_of(options, SpectrumSettings),
        preparing=settings_of(options, CaseSettings),
        settings=settings,
        uncertainty=settings_of(options, UncertaintySettings),
    )


def _trace(options: argparse.Namespace) -> int:
    from biodyn_core.parameters import UNFITTED
    from biodyn_core.subject import load_subject
    from biodyn_ros.files import check_directory
    from biodyn_ros.resources import subject_file
    from biodyn_ros.trace.text import text_of
    from biodyn_ros.trace.tracing import trace_bags, write_traced
    from biodyn_ros.work.kept import Kept

    directory, how = Path(options.output), _trace_options(options)
    check_directory(directory)
    _check_reports(options)
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
    from biodyn_ros.fit.fitting import parse_cases
    from biodyn_ros.trace.tracing import TraceOptions

    settings = dataclasses.replace(
        settings_of(options, TraceSettings),
        floor=settings_of(options, FloorSettings),
        background=dataclasses.replace(
            settings_of(options, BackgroundSettings),
            weights=settings_of(options, WeightSettings),
            usual=settings_of(options, UsualSettings),
        ),
    )
    return TraceOptions(
        seed=options.seed,
        held_out=tuple(options.hold_out),
        cases=parse_cases(options.case),
        reading=_reading(options),
        spectra=settings_of(options, SpectrumSettings),
        preparing=settings_of(options, CaseSettings),
        settings=settings,
    )


def _check_reports(options: argparse.Namespace) -> None:
    """Say what a page would lack before the long work."""
    if not options.no_report:
        from biodyn_ros.reports.pages import check_reports  # an extra of its own

        check_reports()


def _reading(options: argparse.Namespace) -> RecordingOptions:
    from biodyn_core.conditioning import ConditioningSettings
    from biodyn_core.recording import RecordingSettings
    from biodyn_ros.reading.mapping import parse_map
    from biodyn_ros.reading.recordings import RecordingOptions

    return RecordingOptions(
        mapping=parse_map(options.map),
        time=options.time,
        vertical=options.vertical,
        conditioning=settings_of(options, ConditioningSettings),
        recording=settings_of(options, RecordingSettings),
    )


def _print(options: argparse.Namespace, document: dict[str, Any], text: str) -> None:
    print(json.dumps(document, indent=2, allow_nan=False) if options.json else text)


HANDLERS: Final[dict[str, Handler]] = {
    "completion": _completion,
    "demo": _demo,
    "page": _page,
    "simulate": _simulate,
    "import-blue-trident": _import_blue_trident,
    "play": _play,
    "info": _info,
    "replay": _replay,
    "compare": _compare,
    "validate": _validate,
    "fit": _fit,
    "trace": _trace,
}


if __name__ == "__main__":
    sys.exit(main())
