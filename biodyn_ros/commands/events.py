"""`biodyn events`: finds the events of recorded sessions."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import (
    add_cases,
    add_map,
    add_settings,
    add_time,
    add_vertical,
    check_reports,
    settings_of,
    show,
)
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser


def _add(command: CommandParser) -> None:
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_core.sessions.settings import SessionSettings

    command.add_argument("bag", nargs="+", metavar="SESSION", help="bags of one person")
    add_map(command)
    add_time(command)
    add_vertical(command)
    add_cases(command)
    add_settings(command, "events", SessionSettings, ("shock_g", "steady_least_s"))
    add_settings(command, "conditioning", ConditioningSettings)
    command.add_argument("--no-report", action="store_true", help="do not write OUT.html")
    command.add_argument(
        "-o", "--output", required=True, metavar="OUT.yaml", help="the events file; OUT.html beside it"
    )


def _run(options: argparse.Namespace) -> None:
    from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
    from biodyn_core.sessions.settings import SessionSettings
    from biodyn_ros.base.files import check_directory, exists, keep_copy, make_directory, remove
    from biodyn_ros.events.finding import SessionOptions, find_sessions
    from biodyn_ros.events.refusals import parse_allowed
    from biodyn_ros.events.text import text_of
    from biodyn_ros.reading.events_file import events_document, events_text, is_events_file, write_events
    from biodyn_ros.reading.mapping import parse_map

    output = Path(options.output)
    if not is_events_file(output):
        raise InputError(f"{output}: an events file ends in .yaml")
    check_directory(output.parent)
    check_reports(options)
    how = SessionOptions(
        mapping=parse_map(options.map),
        time=options.time,
        conditioning=settings_of(options, ConditioningSettings),
        vertical=options.vertical,
        session=settings_of(options, SessionSettings),
        cases=options.cases,
        allowed=parse_allowed(options.allow),
    )
    with Progress("reading") as progress:
        sessions = find_sessions(options.bag, how, progress)
    make_directory(output.parent)
    if exists(output) and output.read_text(encoding="utf-8", errors="replace") != events_text(sessions, output.parent):
        print(f"biodyn events: the earlier {output.name} is kept as {keep_copy(output).name}", file=sys.stderr)
    write_events(sessions, output)
    page = output.with_suffix(".html")
    if options.no_report:
        remove(page)
    else:
        from biodyn_ros.events.page import events_page  # needs the extra `reports`
        from biodyn_ros.reports.pages import write_drawn

        write_drawn(page, lambda: events_page(sessions))
    show(options, events_document(sessions, output.parent), text_of(sessions))


COMMAND = Command(
    line="finds the events of recorded sessions",
    examples=(
        "biodyn events session.mcap session_2.mcap -o anna.events.yaml",
        "biodyn events session.mcap -o session.events.yaml --cases conditions.csv",
    ),
    add=_add,
    run=_run,
)
