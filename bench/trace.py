"""Traces of records of the blind study on two processes, compared with one process, and with everything stored.

The time of two processes contains their start, as that of the command does.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, MutableMapping
from typing import Any, Final

import numpy as np

from bench.table import Row
from biodyn_core.tracing.settings import TraceSettings
from biodyn_core.tracing.trace import trace
from biodyn_ros.work.executor_map import parallel_map
from biodyn_ros.work.executors import executor_of
from blind.tracing.records import Record, record, sittings
from blind.tracing.rows import DRAWINGS, LONG_S, MEDIAN_S

RECORDS: Final = {"nothing": (0,), "background": (0, 1), "strong": (0, 1), "two": (0,)}
"""Numbers of the records by rows of the study."""

SEED: Final = 1
KEPT_S: Final = 40.0
"""The longest median of a trace whose parts are all stored."""

ONE, TWO = "none", "processes:2"


def rows() -> list[Row]:
    """Measure; about half an hour."""
    one, two, kept = [], [], []
    _seconds(next(_records()), ONE, {})  # compiles most kernels, so it is not counted
    for known in _records():
        stored: dict[str, Any] = {}
        one.append(_seconds(known, ONE, {}))
        two.append(_seconds(known, TWO, stored))
        kept.append(_seconds(known, TWO, stored))
        print(f"bench: traced in {one[-1]:.0f}, {two[-1]:.0f} and {kept[-1]:.0f} s", file=sys.stderr, flush=True)
    return [
        _row(f"trace, {len(two)} records: median", np.median(two), np.median(one), "one process", MEDIAN_S),
        _row("trace: longest", max(two), max(one), "one process", LONG_S),
        _row("trace, everything stored: median", np.median(kept), np.median(two), "nothing stored", KEPT_S),
    ]


def _row(what: str, ours: float, baseline: float, name: str, mark: float) -> Row:
    return Row(what, float(ours), "s", float(baseline), name, f"<= {mark:g}", bool(ours <= mark))


def _records() -> Iterator[Record]:
    """The records, of forms that the study does not score."""
    for drawing in DRAWINGS:
        if numbers := RECORDS.get(drawing.name):
            for one in sittings(drawing, numbers, SEED, "development"):
                yield record(one, drawing.coloured)


def _seconds(known: Record, where: str, stored: MutableMapping[str, Any]) -> float:
    begin = time.perf_counter()
    with executor_of(where) as executor, parallel_map(executor) as parallel:
        trace(known.train, known.held_out, known.subject, TraceSettings(), checkpoint=stored, parallel=parallel)
    return time.perf_counter() - begin
