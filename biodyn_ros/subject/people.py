"""People: a campaign over many persons, each with sessions of their own; one person is one task on an executor.

The file is YAML; paths are relative to it, `name` and `cases` may be missing:

    people:
      - subject: anna.yaml                # or a bundled name
        name: anna                        # of the directory; the subject's own where it is not given
        sessions: [anna/monday.mcap, anna/tuesday]
        cases: marks                      # as --cases; a table for one session only
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError, one_line
from biodyn_core.base.parallel import serial_map
from biodyn_core.base.suggestions import did_you_mean_file
from biodyn_core.base.yaml_files import mapping_of, read_yaml, text_of
from biodyn_core.body.subject import Subject
from biodyn_ros import __version__
from biodyn_ros.base.files import exists, make_directory
from biodyn_ros.base.json_files import write_json
from biodyn_ros.base.progress import OnProgress, silent
from biodyn_ros.events.finding import BY_MARKS, BY_SEAT
from biodyn_ros.fit.campaign_file import subject_of
from biodyn_ros.subject.making import Helpers, SubjectOptions, make_subject
from biodyn_ros.subject.page import write_page
from biodyn_ros.subject.text import document_of
from biodyn_ros.work.executors import LOST, as_done, result_of

SUMMARY: Final = "people.json"

Document = dict[str, Any]


@dataclass(frozen=True)
class Person:
    """One person of a campaign: the name of the directory, the subject and its file, the sessions, and `--cases`."""

    name: str
    file: Path
    subject: Subject
    sessions: tuple[str, ...]
    cases: str


@dataclass(frozen=True)
class PersonRow:
    """The result of one person: as `document_of`, and the reason why there is no result or no fit."""

    name: str
    state: str
    error: str = ""
    document: Document = dataclasses.field(default_factory=dict)


def load_people(path: str | Path) -> list[Person]:
    """Read a file of people; raises InputError, one line, naming the file and the key, before any work."""
    path = Path(path)
    rows = mapping_of(read_yaml(path), str(path), ("people",))["people"]
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: people: expected a list of at least one person")
    found = [_person(row, f"{path}: people[{index}]", path.absolute().parent) for index, row in enumerate(rows)]
    names = [person.name.casefold() for person in found]
    if twice := next((person.name for person in found if names.count(person.name.casefold()) > 1), None):
        raise InputError(f"{path}: two people have the name {twice}: set a name")
    owners: dict[Path, str] = {}
    for person in found:
        for session in person.sessions:
            owner = owners.setdefault(Path(session).resolve(), person.name)
            if owner != person.name:
                raise InputError(f"{path}: {session} is a session of {owner} and of {person.name}: remove it from one")
    return found


def make_people(
    people: Sequence[Person],
    directory: Path,
    options: SubjectOptions,
    executor: Executor | None,
    progress: OnProgress,
) -> list[PersonRow]:
    """Make the subjects of all people, each in a directory of its name; people.json is rewritten after each.

    A person that fails, or has no fit, has the reason, and the others go on. A person whose worker is lost is tried
    once more. Finished steps of an earlier run are used again.
    """
    make_directory(directory)
    rows = {person.name: PersonRow(person.name, "waiting") for person in people}
    waiting = list(people)
    for _ in range(2):
        calls = [(make_person, (person, directory / person.name, options)) for person in waiting]
        for number, future in as_done(executor, calls):
            name = waiting[number].name
            try:
                rows[name] = _row(name, result_of(future, name))
            except Exception as error:  # noqa: BLE001 - a fault with one person must not stop the others
                rows[name] = PersonRow(name, "failed", one_line(error))
            write_json(directory / SUMMARY, people_document(list(rows.values())))
            progress(sum(row.state != "waiting" for row in rows.values()), len(rows))
        waiting = [person for person in waiting if rows[person.name].error.endswith(LOST)]
        if not waiting:
            break
    return list(rows.values())


def make_person(person: Person, directory: Path, options: SubjectOptions) -> Document:
    """Make one subject on a worker, with its page; raises InputError as `make_subject`."""
    own = dataclasses.replace(options, session=dataclasses.replace(options.session, cases=person.cases))
    helpers = Helpers(None, serial_map, silent, lambda line: None)
    made = make_subject(person.sessions, dataclasses.replace(person.subject, name=person.name), directory, own, helpers)
    write_page(made, options.report)
    return document_of(made)


def people_document(rows: Sequence[PersonRow]) -> Document:
    """The mapping of people.json."""
    return {"version": __version__, "people": [dataclasses.asdict(row) for row in rows]}


def _row(name: str, document: Document) -> PersonRow:
    """The row of a person whose steps were run; without a fit there is no subject, so the person has failed."""
    for step in document["steps"]:
        if step["name"] == "fit" and step["state"] != "done":
            return PersonRow(name, "failed", f"fit: {step['result'].rstrip('.')}", document)
    return PersonRow(name, "done", document=document)


def check_failed(rows: Sequence[PersonRow], directory: Path) -> None:
    """Raise InputError naming the people that failed, for exit code 2; all other results are written."""
    if failed := [row.name for row in rows if row.state != "done"]:
        raise InputError(
            f"{len(failed)} of {len(rows)} people failed: {', '.join(failed)}; see {directory / SUMMARY}, the same"
            " command tries them again"
        )


def _person(row: object, where: str, base: Path) -> Person:
    given = mapping_of(row, where, ("subject", "sessions"), ("name", "cases"))
    file, subject = subject_of(given["subject"], f"{where}.subject", base)
    name = text_of(given.get("name", subject.name), f"{where}.name")
    if Path(name).name != name or name.startswith("."):
        raise InputError(f"{where}.name: {name!r} cannot be the name of a directory")
    sessions = given["sessions"]
    if not isinstance(sessions, list) or not sessions:
        raise InputError(f"{where}.sessions: expected a list of at least one session")
    cases = text_of(given.get("cases", BY_SEAT), f"{where}.cases")
    if cases not in (BY_SEAT, BY_MARKS):
        cases = _there(cases, f"{where}.cases", base)
    paths = [_there(text_of(each, f"{where}.sessions"), f"{where}.sessions", base) for each in sessions]
    return Person(name, file, subject, tuple(paths), cases)


def _there(text: str, where: str, base: Path) -> str:
    path = base / text
    if not exists(path):
        raise InputError(f"{where}: there is no {path}: paths are relative to the file{did_you_mean_file(path)}")
    return str(path)
