"""Publishes a run: its row in the table of all runs, and the page of the latest full one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from blind.tracing.marks import Mark
from blind.tracing.outcome import Outcome
from blind.tracing.page import rendered
from blind.tracing.sections import pictures
from conformance.table import cells

RUNS: Final = Path("docs/tracing_runs.md")
PAGE: Final = Path("docs/tracing_study.md")
PICTURES: Final = Path("docs/pictures")

HEAD: Final = """\
# Runs of the blind study of tracing

## All runs

Each run of all rows appends a row, also a bad one; do not edit the rows. A cross marks a missed requirement. A short
run has a few records of each row (in brackets), fewer than the others require.

"""


@dataclass(frozen=True)
class About:
    """A run: day, commit, seed, hash of the decision, hash of the sealed answers, number of these, and machine.

    of_each: records of each row in a short run. measured: number of further records, of measured streams.
    """

    date: str
    commit: str
    seed: int
    decision: str
    sealed: str
    records: int
    machine: str = "an unknown machine"
    of_each: int | None = None
    measured: int = 0

    @property
    def text(self) -> str:
        """The run as text."""
        return (
            f"Run of {self.date}, commit {self.commit}, seed {self.seed}, {self.records} records, whose answers are"
            f" sealed as {self.sealed[:12]}, and {self.measured} of measured streams; decision {self.decision[:12]}, on"
            f" {self.machine}."
        )


def publish(root: Path, about: About, outcomes: Sequence[Outcome], found: Sequence[Mark]) -> None:
    """Append the run to the table, and write its page with its pictures; nothing is written if one cannot be made."""
    page, drawn = rendered(outcomes, found, about.text), pictures(outcomes)
    append(root / RUNS, about, found)
    (root / PAGE).write_text(page, encoding="utf-8")
    for name, svg in drawn.items():
        (root / PICTURES).mkdir(exist_ok=True)
        (root / PICTURES / name).write_text(svg, encoding="utf-8")


def append(path: Path, about: About, found: Sequence[Mark]) -> None:
    """Append one row to the table, which is created if missing; earlier rows do not change."""
    head = ("date", "commit", "seed", "decision", "answers", "records", "met", "marks")
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(HEAD + f"{cells(*head)}\n{cells(*['---'] * len(head))}\n", encoding="utf-8")
    met = sum(mark.met for mark in found)
    row = cells(
        about.date, about.commit, str(about.seed), about.decision[:12], about.sealed[:12],
        str(about.records) + ("" if about.of_each is None else f" ({about.of_each})"),
        f"{met} of {len(found)}", "<br>".join(_short(mark) for mark in found),
    )  # fmt: skip
    with path.open("a", encoding="utf-8") as file:
        file.write(f"{row}\n")


def _short(mark: Mark) -> str:
    return f"{'' if mark.met else '✗ '}{mark.row}: {mark.what} {mark.text}, {mark.required}"
