"""Campaign files: many subjects, each with bags of its own.

A campaign file is YAML; paths are relative to it, `name`, `hold_out` and `cases` may be missing:

    subjects:
      - subject: anna.yaml            # or a bundled name
        name: anna                    # of the result; the subject's own where it is not given
        bags: [anna/road_1.mcap, anna/pothole.mcap, anna/session.mcap@60..90, anna/session.events.yaml]
        hold_out: [anna/rail.mcap]
        cases: {anna/road_1.mcap: gravel}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean_file
from biodyn_core.base.yaml_files import mapping_of, read_yaml, text_of
from biodyn_core.body.parameters import UNFITTED
from biodyn_core.body.subject import Subject, load_subject
from biodyn_ros.base.files import check_file_name, exists
from biodyn_ros.base.resources import subject_file
from biodyn_ros.reading.events_file import is_events_file
from biodyn_ros.reading.given import bags_of
from biodyn_ros.reading.parts import Bag, part_of


@dataclass(frozen=True)
class Entry:
    """One subject of a campaign: the name of its result, the subject, and the absolute paths of its bags."""

    name: str
    subject: Subject
    bags: tuple[Bag, ...]
    held_out: tuple[Bag, ...]
    cases: Mapping[str, str]


@dataclass(frozen=True)
class Campaign:
    """The subjects of a campaign file, and its input files, which results must not overwrite."""

    path: Path
    entries: tuple[Entry, ...]
    inputs: tuple[Path, ...]


def load_campaign(path: str | Path) -> Campaign:
    """Read a campaign file; raises InputError, one line, naming the file and the key, before anything is fitted."""
    data = read_yaml(path)
    try:
        return _campaign(data, Path(path))
    except (InputError, RecursionError) as error:
        raise InputError(f"{path}: {error}") from error


def _campaign(data: object, path: Path) -> Campaign:
    rows = mapping_of(data, "the file", ("subjects",))["subjects"]
    if not isinstance(rows, list) or not rows:
        raise InputError("subjects: expected a list of at least one subject")
    files, entries = [], []
    for index, row in enumerate(rows):
        file, entry = _entry(row, f"subjects[{index}]", path.absolute().parent)
        files.append(file)
        entries.append(entry)
    _check_names(entries)
    bags = [part_of(bag).path for entry in entries for bag in (*entry.bags, *entry.held_out)]
    return Campaign(path, tuple(entries), (path, *files, *bags))


def _entry(row: object, where: str, base: Path) -> tuple[Path, Entry]:
    given = mapping_of(row, where, ("subject", "bags"), ("name", "hold_out", "cases"))
    file, subject = subject_of(given["subject"], f"{where}.subject", base)
    name = text_of(given.get("name", subject.name), f"{where}.name")
    check_file_name(name, f"{where}.name")
    bags = _bags(given["bags"], f"{where}.bags", base)
    held_out = _bags(given.get("hold_out", []), f"{where}.hold_out", base)
    if not bags:
        raise InputError(f"{where}.bags: {name} has no bag, give at least one")
    fitted, spare = (tuple(bag for each in found.values() for bag in each) for found in (bags, held_out))
    _check_once([*fitted, *spare], where)
    return file, Entry(
        name, subject, fitted, spare, _cases(given.get("cases", {}), f"{where}.cases", bags | held_out)
    )  # fmt: skip


def subject_of(value: object, where: str, base: Path) -> tuple[Path, Subject]:
    """The file and the subject that a campaign names, by a path from its folder or as a bundled one."""
    text = text_of(value, where)
    try:
        file = path if exists(path := base / text) and path.is_file() else subject_file(text)
        return file, load_subject(file, UNFITTED)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _bags(value: object, where: str, base: Path) -> dict[str, list[Bag]]:
    """The bags of each text in the file, with absolute paths: one bag or part, or all events of an events file."""
    if not isinstance(value, list):
        raise InputError(f"{where}: expected a list of bags")
    found = {}
    for index, item in enumerate(value):
        text = text_of(item, f"{where}[{index}]")
        if text in found:
            raise InputError(f"{where}[{index}]: {text} is given twice")
        given = str(_from(base, text, f"{where}[{index}]"))
        path = Path(given) if is_events_file(given) else part_of(given).path
        if not exists(path):
            near = did_you_mean_file(path)
            raise InputError(f"{where}[{index}]: there is no {path}: paths are relative to the campaign file{near}")
        found[text] = bags_of([given])
    return found


def _from(base: Path, text: str, where: str) -> Path:
    try:
        return base / Path(text).expanduser()
    except RuntimeError:
        raise InputError(f"{where}: {text}: there is no home directory of this name") from None


def _check_once(bags: Sequence[Bag], where: str) -> None:
    parts = [part_of(bag) for bag in bags]
    for number, part in enumerate(parts):
        if any(part.shares(other) for other in parts[:number]):
            raise InputError(f"{where}: {part} is given twice; either fit to a bag or hold it out")


def _cases(value: object, where: str, bags: Mapping[str, Sequence[Bag]]) -> dict[str, str]:
    cases = {}
    single = tuple(text for text, found in bags.items() if not is_events_file(text))
    for bag, case in mapping_of(value, where, (), single, "bag").items():
        cases[str(bags[bag][0])] = text_of(case, f"{where}: {bag}")
    return cases


def _check_names(entries: Sequence[Entry]) -> None:
    """Raise InputError for two results of one name, ignoring case, and for two different persons of one name."""
    results: dict[str, int] = {}
    persons: dict[str, tuple[int, Subject]] = {}
    for index, entry in enumerate(entries):
        before = results.setdefault(entry.name.casefold(), index)
        if before != index:
            raise InputError(
                f"subjects[{index}].name: {entry.name} is the result of subjects[{before}] too; set a name"
            )
        first, person = persons.setdefault(entry.subject.name, (index, entry.subject))
        for key in ("body_mass_kg", "stature_m", "mass_matrix"):
            one, other = getattr(person, key), getattr(entry.subject, key)
            if one != other:
                raise InputError(
                    f"subjects[{index}].subject: {person.name} has {key} {other}, but {one} in subjects[{first}]; "
                    "one person has one"
                )
