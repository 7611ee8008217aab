"""The directory of a campaign's results: state of each subject, written as it changes, and resumption."""

from __future__ import annotations

import dataclasses
import hashlib
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.errors import InputError, one_line
from biodyn_ros import __version__
from biodyn_ros.base.files import exists, write_text
from biodyn_ros.base.json_files import keys_of, read_json, write_json
from biodyn_ros.fit.campaign_file import Campaign, Entry
from biodyn_ros.fit.fitting import FitOptions, json_beside, page_beside
from biodyn_ros.reading.parts import BagPart, part_of
from biodyn_ros.reading.provenance import bag_sha256, source_of
from biodyn_ros.reading.recordings import case_of
from biodyn_ros.work.executors import result_of

Document = dict[str, Any]

SCHEMA: Final = 1


@dataclass(frozen=True)
class SubjectFit:
    """The results of one subject: the fingerprint of its fit, fit.json, the subject's file, and its row's numbers.

    page: fit.html, None if not requested or not drawn; page_fault is the reason in the latter case.
    """

    fingerprint: str
    document: Document
    subject: str
    seconds: float
    mean_error_percent: float | None
    page: str | None = None
    page_fault: str | None = None


@dataclass(frozen=True)
class Row:
    """One subject in campaign.json; `waiting` means not begun or not finished.

    fingerprint: of the fit that wrote its results, or began to; None before.
    """

    name: str
    subject: str
    bags: list[str]
    held_out: list[str]
    state: str = "waiting"
    error: str | None = None
    seconds: float | None = None
    mean_error_percent: float | None = None
    result: str | None = None
    fingerprint: str | None = None
    page: str | None = None


@dataclass(frozen=True)
class CampaignReport:
    """The path of a campaign's file, and its subjects."""

    campaign: str
    rows: tuple[Row, ...]

    def named(self, state: str) -> list[str]:
        """The names of the subjects in a state."""
        return [row.name for row in self.rows if row.state == state]


def campaign_document(report: CampaignReport) -> Document:
    """The mapping of campaign.json."""
    rows = [dataclasses.asdict(row) for row in report.rows]
    return {"schema": SCHEMA, "campaign": report.campaign, "version": __version__, "subjects": rows}


class Results:
    """The directory of a campaign's results, with its current content."""

    def __init__(self, campaign: Campaign, directory: Path) -> None:
        self.path = directory / "campaign.json"
        self._campaign, self._directory = campaign, directory
        self._rows = {
            e.name: Row(e.name, e.subject.name, [*map(str, e.bags)], [*map(str, e.held_out)]) for e in campaign.entries
        }
        inputs = {path.resolve() for path in campaign.inputs}
        for entry in campaign.entries:
            output = self._output(entry)
            for path in (output, json_beside(output), page_beside(output), self.path, page_of(directory)):
                if path.resolve() in inputs:
                    raise InputError(f"{path}: the campaign reads this file; name another directory for its results")

    @property
    def waiting(self) -> list[Entry]:
        """The entries without a result."""
        return [entry for entry in self._campaign.entries if self._rows[entry.name].state == "waiting"]

    @property
    def progress(self) -> tuple[int, int]:
        """Bags of finished subjects, and bags in all."""
        bags = {row.name: len(row.bags) for row in self._rows.values()}
        return sum(bags.values()) - sum(bags[entry.name] for entry in self.waiting), sum(bags.values())

    @property
    def report(self) -> CampaignReport:
        """The campaign with the current state of its subjects."""
        return CampaignReport(str(self._campaign.path), tuple(self._rows.values()))

    def write(self) -> None:
        """Write campaign.json."""
        write_json(self.path, campaign_document(self.report))

    def load(self, options: FitOptions) -> None:
        """Load the finished subjects of campaign.json, if there is one; raises InputError for a result of another fit.

        A result that this campaign did not finish to write is computed again.
        """
        known = self._known()
        for entry in self._campaign.entries:
            output, row = self._output(entry), known.get(entry.name)
            if not exists(output):
                continue
            if row is None or row.fingerprint is None:
                raise InputError(
                    f"{output}: exists, but campaign.json does not list it as a result; remove it to fit again, or "
                    "give another directory"
                )
            if row.fingerprint != fingerprint(entry, options):
                raise InputError(
                    f"{output}: is of another fit: other subject, bags, events, cases, options or version; remove "
                    "it to fit again, or give another directory"
                )
            if row.state == "done" and json_beside(output).is_file():
                self._rows[entry.name] = row
            else:
                self._begin(entry, row.fingerprint)

    def _known(self) -> dict[str, Row]:
        """The rows of campaign.json by name, none without this file."""
        if not exists(self.path):
            return {}
        try:
            document = keys_of(read_json(self.path), "the file", ("schema", "campaign", "version", "subjects"))
            if document["schema"] != SCHEMA or not isinstance(document["subjects"], list):
                raise InputError(f"expected schema {SCHEMA} and a list of subjects")
            return {row.name: row for row in map(_row, document["subjects"])}
        except InputError as error:
            raise InputError(f"{self.path}: {error}; remove it to start anew") from None

    def _begin(self, entry: Entry, fingerprint: str) -> None:
        """Note that the results of an entry are of this campaign, before all of them are written."""
        self._rows[entry.name] = dataclasses.replace(self._rows[entry.name], fingerprint=fingerprint)

    def add(self, entry: Entry, future: Future[SubjectFit]) -> None:
        """Write a subject's results, or the reason for their absence."""
        try:
            row = self._written(entry, result_of(future, entry.name))
        except Exception as error:  # noqa: BLE001 - a fault in one fit must not stop the others
            row = dataclasses.replace(self._rows[entry.name], state="failed", error=one_line(error))
        self._rows[entry.name] = row
        self.write()

    def _written(self, entry: Entry, fit: SubjectFit) -> Row:
        """Write the files of a subject; its row."""
        output = self._output(entry)
        # After an interruption between these files, --resume sees that it may overwrite them.
        self._begin(entry, fit.fingerprint)
        self.write()
        write_json(json_beside(output), fit.document)
        write_text(output, fit.subject)
        page = self._page(output, fit)
        return dataclasses.replace(
            self._rows[entry.name], state="done", seconds=fit.seconds, mean_error_percent=fit.mean_error_percent,
            result=output.name, error=fit.page_fault, page=page,
        )  # fmt: skip

    def _page(self, output: Path, fit: SubjectFit) -> str | None:
        """Write a subject's page; without one, remove that of an earlier fit."""
        path = page_beside(output)
        if fit.page is None:
            path.unlink(missing_ok=True)
            return None
        write_text(path, fit.page, errors="backslashreplace")
        return path.name

    def _output(self, entry: Entry) -> Path:
        return self._directory / f"{entry.name}.yaml"


def fingerprint(entry: Entry, options: FitOptions) -> str:
    """A hash of a fit: subject, bags by content with role, case, rest and clocks, options, and version."""
    bags = [
        (role, source_of(bag), entry.cases.get(str(bag)) or case_of(bag), _corrections(part_of(bag)))
        for role, paths in (("fitted", entry.bags), ("held out", entry.held_out))
        for bag in paths
    ]
    shared = dataclasses.replace(options, held_out=(), cases={})
    return hashlib.sha256(repr((entry.subject.to_dict(), bags, shared, __version__)).encode()).hexdigest()


def _corrections(part: BagPart) -> object:
    """What an events file says of a part beside its time, with the content of the bag of its rest."""
    return part.rest_bag and bag_sha256(part.rest_bag), part.corrections


def page_of(directory: Path) -> Path:
    """The path of a campaign's page."""
    return directory / "campaign.html"


def _row(value: object) -> Row:
    """A row of campaign.json; raises InputError for a malformed one."""
    row = Row(**keys_of(value, "subjects", tuple(item.name for item in dataclasses.fields(Row))))
    texts = (row.name, row.subject, row.state, row.error, row.result, row.fingerprint, row.page)
    numbers = (row.seconds, row.mean_error_percent)
    lists = (row.bags, row.held_out)
    if not (
        all(isinstance(text, (str, type(None))) for text in texts)
        and all(isinstance(value, (int, float, type(None))) for value in numbers)
        and all(isinstance(bags, list) and all(isinstance(bag, str) for bag in bags) for bags in lists)
    ):
        raise InputError(f"subjects: {str(row.name)[:40]!r} is not a row of campaign.json")
    return row
