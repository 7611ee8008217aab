"""`biodyn trace`: finds the effect that is missing in a subject's model."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biodyn_core.base.errors import InputError
from biodyn_ros.commands.arguments import (
    add_all_settings,
    add_executor,
    add_held_out,
    add_reading,
    add_seed,
    all_settings,
    check_reports,
    held_out_of,
    reading_of,
    show,
)
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser

if TYPE_CHECKING:
    from biodyn_ros.trace.tracing import TraceOptions


def _kinds() -> dict[str, type[Any]]:
    from biodyn_core.identification.settings import CaseSettings
    from biodyn_core.signals.spectrum_settings import SpectrumSettings
    from biodyn_core.tracing.settings import (
        FloorSettings,
        NuisanceSettings,
        TraceSettings,
        TypicalSettings,
        WeightSettings,
    )

    return {
        "tracing": TraceSettings,
        "least data": FloorSettings,
        "nuisance model": NuisanceSettings,
        "weights": WeightSettings,
        "typical deviations": TypicalSettings,
        "spectra": SpectrumSettings,
        "cases": CaseSettings,
    }


def _add(command: CommandParser) -> None:
    command.add_argument("bag", nargs="*", metavar="BAG", help="several of each loading condition")
    command.add_argument(
        "--subject", required=True, metavar="S", help="subject file, fitted or not, or the name of a bundled one"
    )
    add_held_out(command, "bags that theta and sizes are not fitted to (default: every second one of each condition)")
    add_seed(command, "seed of random numbers")
    command.add_argument(
        "--fresh", action="store_true", help="recompute the results that DIR.kept.json stores of an earlier trace"
    )
    command.add_argument("--no-report", action="store_true", help="do not write trace.html")
    add_executor(command)
    add_reading(command)
    add_all_settings(command, _kinds())
    command.add_argument("-o", "--output", required=True, metavar="DIR", help="directory for the results")


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.body.parameters import UNFITTED
    from biodyn_core.body.subject import load_subject
    from biodyn_ros.base.files import check_directory, check_keeps_inputs
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.reading.given import bags_of
    from biodyn_ros.trace.document import trace_document
    from biodyn_ros.trace.text import text_of
    from biodyn_ros.trace.tracing import SUBJECT, trace_bags, write_traced
    from biodyn_ros.work.executor_map import parallel_map
    from biodyn_ros.work.executors import executor_of
    from biodyn_ros.work.part_store import PartStore

    directory, how = Path(options.output), how_of(options)
    check_directory(directory)
    check_reports(options)
    given = subject_file(options.subject)
    check_keeps_inputs(directory / SUBJECT, [given])
    subject, given_yaml = load_subject(given, UNFITTED), given.read_text(encoding="utf-8")
    kept = PartStore(_kept_beside(directory), options.fresh)
    try:
        with executor_of(options.executor) as executor, parallel_map(executor) as parallel:
            traced = trace_bags(
                bags_of(options.bag), subject, how, kept, lambda line: print(line, file=sys.stderr), parallel
            )
    except KeyboardInterrupt:
        if kept:
            print(
                f"biodyn trace: {kept.path} stores the finished part; repeat the command to continue", file=sys.stderr
            )
        raise
    write_traced(traced, directory, not options.no_report, given_yaml)
    show(options, trace_document(traced), text_of(traced))


def _kept_beside(directory: Path) -> Path:
    """DIR.kept.json beside DIR, also where DIR is `.` or `..`; raises InputError for the root, which has no name."""
    named = directory if directory.name not in ("", "..") else directory.resolve()
    if not named.name:
        raise InputError(f"{directory}: has no name, which DIR.kept.json needs: give another directory")
    return named.with_name(f"{named.name}.kept.json")


def how_of(options: argparse.Namespace) -> TraceOptions:
    """The options for reading, preparing and tracing bags."""
    from biodyn_ros.fit.fitting import parse_cases
    from biodyn_ros.trace.tracing import TraceOptions

    held_out, auto_held_out = held_out_of(options)
    given = all_settings(options, _kinds())
    nuisance = dataclasses.replace(
        given["nuisance model"], weights=given["weights"], typical=given["typical deviations"]
    )
    return TraceOptions(
        seed=options.seed,
        held_out=held_out,
        auto_held_out=auto_held_out,
        cases=parse_cases(options.case),
        reading=reading_of(options),
        spectra=given["spectra"],
        preparing=given["cases"],
        settings=dataclasses.replace(given["tracing"], floor=given["least data"], nuisance=nuisance),
    )


COMMAND = Command(
    line="finds the effect missing in a subject's model",
    examples=(
        "biodyn trace road.mcap road_2.mcap rail.mcap rail_2.mcap --subject anna_fitted.yaml -o traced",
        "biodyn trace road.mcap rail.mcap --subject anna_fitted.yaml -o traced --hold-out road_2.mcap rail_2.mcap",
    ),
    add=_add,
    run=_run,
)
