"""Publication of a run: its row in the table of all full runs, the page of the latest, and its lines in the README."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from blind.tracing.marks import Mark
from blind.tracing.outcome import Outcome
from blind.tracing.page import marks_table, rendered
from conformance.table import cells

RUNS: Final = Path("docs/tracing_runs.md")
PAGE: Final = Path("docs/tracing.md")
README: Final = Path("README.md")
BEGIN: Final = "<!-- tracing: the latest full run, written by make blind -->"
END: Final = "<!-- tracing: end -->"

HEAD: Final = """\
# All full runs of the blind study of tracing

A row each, appended by `make blind`, bad ones too. Do not edit. A mark that is missed has a cross.

"""


@dataclass(frozen=True)
class About:
    """A run: day, commit, seed, hash of the thresholds, hash of the sealed answers, and number of records."""

    date: str
    commit: str
    seed: int
    thresholds: str
    sealed: str
    records: int

    @property
    def text(self) -> str:
        """The run as text."""
        return (
            f"Run of {self.date}, commit {self.commit}, seed {self.seed}, {self.records} records, thresholds"
            f" {self.thresholds[:12]}, answers sealed as {self.sealed[:12]}."
        )


def publish(root: Path, about: About, outcomes: Sequence[Outcome], found: Sequence[Mark]) -> None:
    """Append the run to the table, and write its results into page and README."""
    append(root / RUNS, about, found)
    (root / PAGE).write_text(rendered(outcomes, found, about.text), encoding="utf-8")
    readme = root / README
    if readme.exists():
        readme.write_text(
            with_latest(readme.read_text(encoding="utf-8"), [about.text, "", *marks_table(found)]), encoding="utf-8"
        )


def append(path: Path, about: About, found: Sequence[Mark]) -> None:
    """Append one row to the table, which is created if missing; earlier rows do not change."""
    head = ("date", "commit", "seed", "thresholds", "answers", "records", "met", "marks")
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(HEAD + f"{cells(*head)}\n{cells(*['---'] * len(head))}\n", encoding="utf-8")
    met = sum(mark.met for mark in found)
    row = cells(
        about.date, about.commit, str(about.seed), about.thresholds[:12], about.sealed[:12], str(about.records),
        f"{met} of {len(found)}", "<br>".join(_short(mark) for mark in found),
    )  # fmt: skip
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{row}\n")


def with_latest(readme: str, lines: Sequence[str]) -> str:
    """A README with these lines between its two marks; unchanged without marks."""
    before, begin, rest = readme.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        return readme
    return "\n".join([before + begin, *lines, end + after])


def _short(mark: Mark) -> str:
    return f"{'' if mark.met else '✗ '}{mark.row}: {mark.what} {mark.text}, {mark.asked}"
