"""`biodyn validate`: compares the prediction of an event with its measurement."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from biodyn_core.base.errors import InputError
from biodyn_ros.base.progress import Progress
from biodyn_ros.commands.arguments import (
    Result,
    add_reading,
    add_settings,
    add_subject,
    check_reports,
    reading_of,
    run_each,
    settings_of,
    show,
)
from biodyn_ros.commands.command import Command
from biodyn_ros.commands.parsing import CommandParser

if TYPE_CHECKING:
    from biodyn_ros.reading.parts import Bag


def _add(command: CommandParser) -> None:
    from biodyn_core.signals.spectrum_settings import SpectrumSettings
    from biodyn_ros.validate.settings import ValidationSettings

    command.add_argument("bag", nargs="?", metavar="BAG", help="a .mcap or .db3 file, or the directory of a recording")
    command.add_argument(
        "--people", action="store_true", help="compare the subject with published groups of people, without a bag"
    )
    add_subject(command)
    add_reading(command)
    command.add_argument("--case", metavar="CASE", help="loading condition (default: by the bag's name)")
    command.add_argument(
        "--seat-force", choices=("inertia", "joint", "paper"), default="inertia",
        help="form of the force at the seat (default inertia)",
    )  # fmt: skip
    command.add_argument("--as-printed", action="store_true", help="also forces under cascade masses, labelled")
    add_settings(command, "spectra", SpectrumSettings)
    add_settings(command, "limits of agreement", ValidationSettings)
    command.add_argument("--no-report", action="store_true", help="do not write validate.html")
    command.add_argument("-o", "--output", metavar="DIR", help="directory for validate.json and validate.html")


def _run(options: argparse.Namespace) -> None:
    if options.people == bool(options.bag):
        raise InputError("either BAG or --people is needed; biodyn validate -h shows how")
    (_people if options.people else _events)(options)


_OF_PEOPLE: Final = {"command", "bag", "people", "subject", "as_printed", "no_report", "output", "json"}
_OF_EVENTS: Final = {"map": [], "time": "header", "vertical": "", "case": None, "seat_force": "inertia"}
"""Options of a bag that are there without being given, with their defaults; settings are there only if given."""


def _check_people(options: argparse.Namespace) -> None:
    """Raise InputError for options of a bag."""
    given = {name: value for name, value in vars(options).items() if name not in _OF_PEOPLE}
    without = [name for name, value in given.items() if name not in _OF_EVENTS or value != _OF_EVENTS[name]]
    if without:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in without)
        raise InputError(f"--people compares without a bag: omit {names}")


def _people(options: argparse.Namespace) -> None:
    from biodyn_core.body.subject import load_subject
    from biodyn_core.population.beside import beside_people
    from biodyn_ros.base.files import check_directory
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.validate.people_document import people_document
    from biodyn_ros.validate.people_text import text_of

    _check_people(options)
    subject = load_subject(subject_file(options.subject))
    if options.output:
        check_directory(Path(options.output))
        check_reports(options)
    found = beside_people(subject, options.as_printed)
    if options.output:
        from biodyn_ros.validate.people_page import write_people

        write_people(found, Path(options.output), not options.no_report)
    show(options, people_document(found), text_of(found))


def _events(options: argparse.Namespace) -> None:
    from biodyn_core.body.subject import load_subject
    from biodyn_core.signals.spectrum_settings import SpectrumSettings
    from biodyn_ros.base.files import check_directory
    from biodyn_ros.base.resources import subject_file
    from biodyn_ros.validate.document import validation_document
    from biodyn_ros.validate.settings import ValidationSettings
    from biodyn_ros.validate.text import text_of
    from biodyn_ros.validate.validating import ValidateOptions, validate, write_validated

    how = ValidateOptions(
        case=options.case,
        reading=reading_of(options),
        spectra=settings_of(options, SpectrumSettings),
        limits=settings_of(options, ValidationSettings),
        seat_force=options.seat_force,
        as_printed=options.as_printed,
    )
    subject = load_subject(subject_file(options.subject))
    directory = Path(options.output) if options.output else None
    if directory:
        check_directory(directory)
        check_reports(options)

    def run(bag: Bag, place: Path | None) -> Result:
        with Progress("validating") as progress:
            validated = validate(bag, subject, how, progress)
        if place:
            write_validated(validated, place, not options.no_report)
        return validation_document(validated), text_of(validated)

    run_each(options, directory, run)


COMMAND = Command(
    line="compares a prediction with a measured event",
    examples=(
        "biodyn validate rail.mcap --subject anna_fitted.yaml -o results",
        "biodyn validate --people --subject anna_fitted.yaml -o results",
    ),
    add=_add,
    run=_run,
)
