"""`biodyn fit`: fits a subject, or a campaign of many, to recorded events."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biodyn_core.base.errors import InputError
from biodyn_ros.base.progress import Progress
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
    from biodyn_ros.fit.fitting import FitOptions


def _kinds() -> dict[str, type[Any]]:
    from biodyn_core.identification.settings import (
        CaseSettings,
        FitSettings,
        SurrogateSettings,
        SwarmSettings,
        UncertaintySettings,
    )
    from biodyn_core.signals.spectrum_settings import SpectrumSettings

    return {
        "fitting": FitSettings,
        "phase 1": SwarmSettings,
        "surrogate": SurrogateSettings,
        "spectra": SpectrumSettings,
        "cases": CaseSettings,
        "uncertainty": UncertaintySettings,
    }


def _add(command: CommandParser) -> None:
    command.add_argument("bag", nargs="*", metavar="BAG", help="one or more of each loading condition")
    command.add_argument(
        "--subject", metavar="S", help="subject file, with or without parameters, or the name of a bundled one"
    )
    command.add_argument("--campaign", metavar="FILE", help="many subjects, from a file; -o is then a directory")
    add_held_out(command, "bags that are only predicted")
    command.add_argument(
        "--profile", action="append", default=[], metavar="NAME",
        help="profile the likelihood of a parameter, such as natural_frequency_hz[head], or of all",
    )  # fmt: skip
    command.add_argument("--paper", action="store_true", help="settings of the paper; other options override them")
    command.add_argument("--no-report", action="store_true", help="do not write OUT.fit.html or campaign.html")
    add_seed(command, "seed of random numbers")
    command.add_argument("--resume", action="store_true", help="continue an interrupted fit")
    add_executor(command)
    add_reading(command)
    add_all_settings(command, _kinds())
    command.add_argument(
        "-o", "--output", required=True, metavar="OUT.yaml", help="the subject; OUT.fit.json and OUT.fit.html beside it"
    )


def _run(options: argparse.Namespace) -> None:
    if options.campaign:
        _campaign(options)
    else:
        _subject(options)


def _subject(options: argparse.Namespace) -> None:
    from biodyn_core.body.parameters import UNFITTED
    from biodyn_core.body.subject import load_subject
    from biodyn_ros.base.files import check_keeps_inputs, remove
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.fit.document import fit_document
    from biodyn_ros.fit.fitting import check_output, fit_bags, page_beside, write_fitted
    from biodyn_ros.fit.text import text_of
    from biodyn_ros.reading.events_file import is_events_file
    from biodyn_ros.reading.given import bags_of
    from biodyn_ros.work.executors import executor_of
    from biodyn_ros.work.tasks import Work

    if not (options.bag and options.subject):
        raise InputError("BAG... and --subject are needed, or --campaign; biodyn fit -h shows how")
    output = Path(options.output)
    check_output(output)
    check_reports(options)
    how, given = how_of(options), subject_file(options.subject)
    events = [Path(text) for text in (*options.bag, *options.hold_out) if is_events_file(text)]
    check_keeps_inputs(output, [given, *events])
    subject = load_subject(given, UNFITTED)
    checkpoint = output.with_name(f"{output.stem}.checkpoint.json")
    try:
        with executor_of(options.executor) as executor:
            work = Work(executor, checkpoint, options.resume)
            report = fit_bags(bags_of(options.bag), subject, how, work)
    except KeyboardInterrupt:
        if checkpoint.exists():
            print(f"biodyn fit: {checkpoint} stores the finished part; --resume continues from it", file=sys.stderr)
        raise
    write_fitted(report, output)
    work.finish()
    show(options, fit_document(report), text_of(report))
    if not options.no_report:
        from biodyn_ros.fit.page import write_fit_page  # needs the extra `reports`

        write_fit_page(report, output)
    else:
        remove(page_beside(output))


def _campaign(options: argparse.Namespace) -> None:
    from biodyn_ros.base.files import remove
    from biodyn_ros.fit.campaign import fit_campaign
    from biodyn_ros.fit.campaign_file import load_campaign
    from biodyn_ros.fit.campaign_results import campaign_document, page_of
    from biodyn_ros.fit.campaign_text import check_failed, text_of
    from biodyn_ros.work.executors import executor_of

    if options.bag or options.subject or options.hold_out or options.case:
        raise InputError(
            "BAG, --subject, --hold-out and --case belong to each subject: give them in the campaign file, bags by name"
        )
    campaign, directory = load_campaign(options.campaign), Path(options.output)
    check_reports(options)
    with executor_of(options.executor) as executor, Progress("fitting") as progress:
        report = fit_campaign(
            campaign, directory, how_of(options), executor, options.resume, progress, not options.no_report
        )
    show(options, campaign_document(report), text_of(report))
    if not options.no_report:
        from biodyn_ros.fit.campaign_page import write_campaign_page  # needs the extra `reports`

        write_campaign_page(report, directory)
    else:
        remove(page_of(directory))
    check_failed(report, directory)


def how_of(options: argparse.Namespace) -> FitOptions:
    """The options for reading, preparing and fitting bags."""
    from biodyn_core.identification.settings import PAPER, FitSettings
    from biodyn_ros.fit.fitting import FitOptions, parse_cases

    held_out, auto_held_out = held_out_of(options)
    base = PAPER if options.paper else FitSettings()
    given = all_settings(options, _kinds(), {"fitting": base, "phase 1": base.swarm, "surrogate": base.surrogate})
    return FitOptions(
        seed=options.seed,
        held_out=held_out,
        auto_held_out=auto_held_out,
        cases=parse_cases(options.case),
        profiles=tuple(options.profile),
        reading=reading_of(options),
        spectra=given["spectra"],
        preparing=given["cases"],
        settings=dataclasses.replace(given["fitting"], swarm=given["phase 1"], surrogate=given["surrogate"]),
        uncertainty=given["uncertainty"],
    )


COMMAND = Command(
    line="fits a subject to recorded events",
    examples=(
        "biodyn fit road.mcap pothole.mcap rail.mcap --subject anna.yaml -o fitted.yaml --hold-out road_2.mcap",
        "biodyn fit road.mcap --subject anna.yaml -o fitted.yaml --case road.mcap=road --resume",
        "biodyn fit --campaign subjects.yaml -o fitted",
    ),
    add=_add,
    run=_run,
)
