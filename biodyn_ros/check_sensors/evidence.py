"""How often an answer of the procedure was right: counts of docs/tracing_runs.md, "Faults in measured streams"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from biodyn_core.tracing.findings import NAMING, Verdict

RECORDS: Final = 300
"""Measured records of one stretch each, into 210 of which a program inserted a fault."""


@dataclass(frozen=True)
class NamedEvidence:
    """Records in which a fault was named: all, with the inserted one among the named, of these alone.

    intervals: right names with an interval; covered: those whose interval contained the inserted size.
    """

    records: int
    right: int
    right_alone: int
    intervals: int
    covered: int


@dataclass(frozen=True)
class UnnamedEvidence:
    """Records with a verdict that names no fault: all, without a fault, and by the fault's ratio to the background."""

    records: int
    without_fault: int
    ratio_below_0_4: int
    ratio_0_4_to_0_8: int
    ratio_above_0_8: int


NAMED: Final = NamedEvidence(90, 88, 79, 58, 54)
UNNAMED: Final[Mapping[Verdict, UnnamedEvidence]] = {
    "none": UnnamedEvidence(94, 39, 48, 7, 0),
    "unexplained": UnnamedEvidence(36, 20, 12, 2, 2),
    "not_decidable": UnnamedEvidence(80, 30, 34, 6, 10),
}


def evidence_of(verdict: Verdict) -> NamedEvidence | UnnamedEvidence:
    """The counts for an answer."""
    return NAMED if verdict in NAMING else UNNAMED[verdict]


def sentence_of(verdict: Verdict) -> str:
    """The counts in words."""
    found = evidence_of(verdict)
    if isinstance(found, NamedEvidence):
        return (
            f"of {RECORDS} measured records, {found.records} had a named fault; the inserted one was among those named"
            f" in {found.right}, alone in {found.right_alone};"
            f" {found.covered} of {found.intervals} intervals contained its size"
        )
    return (
        f"of {RECORDS} measured records, {found.records} had this result: {found.without_fault} without a fault,"
        f" {found.ratio_below_0_4} with a fault below 0.4 of the background, {found.ratio_0_4_to_0_8} of 0.4 to 0.8,"
        f" {found.ratio_above_0_8} above"
    )
