"""The printed tables of test/data, the paper's subjects, and people inside its Table 1."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject, load_subject
from biodyn_ros.base.resources import subject_file

SHARES = st.lists(st.floats(0.0, 1.0), min_size=15, max_size=15).map(np.array)
THETAS = SHARES.map(lambda shares: np.clip(LOWER + shares * (UPPER - LOWER), LOWER, UPPER))


def printed(table: str, **wanted: str) -> list[dict[str, str]]:
    """The rows of a printed table that have these values; lines that begin with # say where it is from."""
    lines = (Path(__file__).parent / "data" / table).read_text(encoding="utf-8").splitlines()
    found = csv.DictReader(line for line in lines if not line.startswith("#"))
    return [row for row in found if all(row[key] == value for key, value in wanted.items())]


def shipped(name: str, **changes: float) -> Subject:
    """A subject of the paper, some parameters changed."""
    subject = load_subject(subject_file(name))
    return dataclasses.replace(subject, parameters=dataclasses.replace(subject.parameters, **changes))


def person(theta: NDArray[np.float64], **changes: object) -> Subject:
    """A subject with this theta."""
    return dataclasses.replace(Subject("somebody", 70.0, 1.75, "segment", Parameters.from_vector(theta)), **changes)
