"""`biodyn subject`: from recorded sessions to a fitted, validated and traced subject."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from biodyn_core.base.errors import InputError
from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import (
    add_cases,
    add_executor,
    add_reading,
    add_seed,
    add_settings,
    check_reports,
    reading_of,
    settings_of,
    show,
)
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import EXIT_INPUT, CommandParser

if TYPE_CHECKING:
    from biodyn_ros.subject.making import SubjectOptions


def _add(command: CommandParser) -> None:
    from biodyn_core.identification.settings import FitSettings
    from biodyn_core.sessions.settings import SessionSettings
    from biodyn_core.tracing.settings import TraceSettings

    command.add_argument("bag", nargs="*", metavar="SESSION", help="bags of one person")
    command.add_argument("--subject", metavar="S", help="subject file, with or without parameters, or a bundled name")
    command.add_argument("--campaign", metavar="FILE", help="many people, from a file; each has a directory in DIR")
    add_cases(command)
    command.add_argument(
        "--per-case", type=int, default=12, metavar="N",
        help="most events of a loading condition that are used (3 to 200, default 12)",
    )  # fmt: skip
    add_seed(command, "seed of random numbers")
    add_executor(command)
    command.add_argument("--no-report", action="store_true", help="write no pages")
    add_reading(command)
    add_settings(command, "events", SessionSettings)
    add_settings(command, "fitting", FitSettings)
    add_settings(command, "tracing", TraceSettings)
    command.add_argument("-o", "--output", required=True, metavar="DIR", help="directory for the results of all steps")


def _run(options: argparse.Namespace) -> int:
    from biodyn_ros.base.files import check_directory

    if bool(options.campaign) == bool(options.bag and options.subject):
        raise InputError("SESSION... and --subject are needed, or --campaign alone; biodyn subject -h shows how")
    check_directory(Path(options.output))
    check_reports(options)
    return _people(options) if options.campaign else _one(options)


def _one(options: argparse.Namespace) -> int:
    from biodyn_core.body.parameters import UNFITTED
    from biodyn_core.body.subject import load_subject
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.subject.making import Helpers, check_given, make_subject
    from biodyn_ros.subject.page import write_page
    from biodyn_ros.subject.text import document_of, text_of
    from biodyn_ros.work.executor_map import parallel_map
    from biodyn_ros.work.executors import executor_of

    directory, how = Path(options.output), how_of(options)
    given = subject_file(options.subject)
    check_given(directory, given)
    subject = load_subject(given, UNFITTED)
    try:
        with executor_of(options.executor) as executor, parallel_map(executor) as parallel:
            helpers = Helpers(executor, parallel, Progress, lambda line: print(line, file=sys.stderr))
            made = make_subject(options.bag, subject, directory, how, helpers)
    except KeyboardInterrupt:
        _say_kept(directory)
        raise
    write_page(made, how.report)
    show(options, document_of(made), text_of(made))
    return 0 if made.steps["fit"].state == "done" else EXIT_INPUT


def _people(options: argparse.Namespace) -> int:
    from biodyn_ros.base.files import remove
    from biodyn_ros.subject.making import PAGE, check_given
    from biodyn_ros.subject.people import check_failed, load_people, make_people, people_document
    from biodyn_ros.subject.people_page import people_page, text_of
    from biodyn_ros.work.executors import executor_of

    if options.bag or options.subject or options.cases != "seat":
        raise InputError("SESSION, --subject and --cases belong to each person: give them in the campaign file")
    people, directory, how = load_people(options.campaign), Path(options.output), how_of(options)
    for person in people:
        for other in people:  # its file may lie in the directory of another one
            check_given(directory / other.name, person.file)
    try:
        with executor_of(options.executor) as executor, Progress("people") as progress:
            rows = make_people(people, directory, how, executor, progress)
    except KeyboardInterrupt:
        _say_kept(directory)
        raise
    if options.no_report:
        remove(directory / PAGE)
    else:
        from biodyn_ros.reports.pages import write_drawn  # needs the extra `reports`

        write_drawn(directory / PAGE, lambda: people_page(rows, directory))
    show(options, people_document(rows), text_of(rows))
    check_failed(rows, directory)
    return 0


def _say_kept(directory: Path) -> None:
    print(f"biodyn subject: {directory} keeps the finished steps; repeat the command to continue", file=sys.stderr)


def how_of(options: argparse.Namespace) -> SubjectOptions:
    """The options of all steps."""
    from biodyn_core.identification.settings import FitSettings
    from biodyn_core.sessions.settings import SessionSettings
    from biodyn_core.tracing.settings import TraceSettings
    from biodyn_ros.events.finding import SessionOptions
    from biodyn_ros.events.refusals import parse_allowed
    from biodyn_ros.fit.fitting import FitOptions
    from biodyn_ros.subject.making import SubjectOptions
    from biodyn_ros.trace.tracing import TraceOptions
    from biodyn_ros.validate.validating import ValidateOptions

    if not 3 <= options.per_case <= 200:
        raise InputError(f"--per-case {options.per_case}: allowed are 3 to 200")
    reading = reading_of(options)
    session = SessionOptions(
        reading.mapping, reading.time, reading.conditioning, reading.vertical, settings_of(options, SessionSettings),
        options.cases, parse_allowed(options.allow),
    )  # fmt: skip
    base = FitSettings()
    fitting = settings_of(options, FitSettings, base)
    return SubjectOptions(
        seed=options.seed,
        per_case=options.per_case,
        session=session,
        fit=FitOptions(reading=reading, settings=dataclasses.replace(fitting, swarm=base.swarm)),
        validate=ValidateOptions(reading=reading),
        trace=TraceOptions(reading=reading, settings=settings_of(options, TraceSettings)),
        report=not options.no_report,
    )


COMMAND = Command(
    line="makes a subject from sessions in one go",
    examples=(
        "biodyn subject session.mcap --subject anna.yaml -o anna",
        "biodyn subject new --mass 75 --stature 1.75 -o anna.yaml",
        "biodyn subject --campaign people.yaml -o people --executor processes:4",
    ),
    add=_add,
    run=_run,
)
