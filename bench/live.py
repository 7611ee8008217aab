"""The live node over real DDS, three processes, compared with a node that passes the same messages without computing.

A publisher sends six Imu topics, the node responds, a subscriber receives six predicted topics at full rate; the node
and the baseline alternate with the same publisher and subscriber. CPU is that of the node's process, without start-up.
"""

from __future__ import annotations

import os
import statistics
import sys
from collections.abc import Sequence

from bench.processes import NODE, Answered, Window, streamed
from bench.table import Row, render
from biodyn_core.body.synthesis_settings import NATIVE_RATE_HZ
from biodyn_ros.base.environment import prepare

ROUNDS = 4
MEASURE_S = 10.0

PROTOTYPE_RATIO = 15.0 / 10.6
"""The target over the CPU of the prototype without exposure, on the machine of the target."""

MEASURED = ("-p", "publish_measured:=true")
BASELINE = "without mathematics"


def rows() -> list[Row]:
    """Measure; about five minutes."""
    domain = prepare(os.environ)  # None if the environment wrapper has reserved one
    try:
        turns = [(_run(NODE), _run(_minimal())) for _ in range(ROUNDS)]
        measured = _run((*NODE, *MEASURED), "measured"), _run(_minimal("measured"), "measured")
        fast = _run(NODE, rate_hz=4.0 * NATIVE_RATE_HZ), _run(_minimal(), rate_hz=4.0 * NATIVE_RATE_HZ)
    finally:
        if domain:
            domain.release()
    ours, baseline = (_middle(runs) for runs in zip(*turns, strict=True))
    return [*_main_rows(ours, baseline), *_side_rows("12 topics", *measured, 30.0), *_side_rows("4 x the rate", *fast)]


def _main_rows(ours: Window, baseline: Window) -> list[Row]:
    cpu, limit, one, other = ours.cpu_percent, PROTOTYPE_RATIO * baseline.cpu_percent, ours.found, baseline.found
    return [
        Row("live: CPU of one core", cpu, "%", None, "", "<= 15", cpu <= 15.0),
        Row("live: CPU of one core", cpu, "%", baseline.cpu_percent, BASELINE, "<= 1.42 x", cpu <= limit),
        _lost_row("live", one, other),
        Row("live: lost, as the node counts", one.counted_lost, "messages", None, "", "0", one.counted_lost == 0),
        Row("live: answer after sample, p50", one.p50_ms, "ms", other.p50_ms, BASELINE, "-", None),
        Row("live: answer after sample, p99", one.p99_ms, "ms", other.p99_ms, BASELINE, "<= 1", one.p99_ms <= 1.0),
        Row("live: resident, warm cache", ours.resident_mb, "MB", None, "", "<= 300", ours.resident_mb <= 300.0),
        Row("live: its growth in 10 s", ours.growth_mb, "MB", None, "", "-", None),
        Row("live: publisher's own lateness, p99", one.late_p99_ms, "ms", other.late_p99_ms, BASELINE, "-", None),
    ]


def _side_rows(name: str, ours: Window, baseline: Window, cpu_mark: float | None = None) -> list[Row]:
    cpu, one, other = ours.cpu_percent, ours.found, baseline.found
    mark, met = ("-", None) if cpu_mark is None else (f"<= {cpu_mark:g}", cpu <= cpu_mark)
    return [
        Row(f"live, {name}: CPU of one core", cpu, "%", baseline.cpu_percent, BASELINE, mark, met),
        _lost_row(f"live, {name}", one, other),
        Row(f"live, {name}: answer after sample, p99", one.p99_ms, "ms", other.p99_ms, BASELINE, "-", None),
    ]


def _lost_row(name: str, ours: Answered, baseline: Answered) -> Row:
    what = f"{name}: lost of {ours.owed:,} answers"
    return Row(what, ours.lost, "messages", baseline.lost, BASELINE, "0", ours.lost == 0)


def _middle(runs: Sequence[Window]) -> Window:
    """Medians of the rounds, and sums of the losses."""
    found = {
        name: (sum if name in ("owed", "lost", "counted_lost") else statistics.median)(
            [getattr(run.found, name) for run in runs]
        )
        for name in Answered.__dataclass_fields__
    }
    cost = {
        name: statistics.median([getattr(run, name) for run in runs])
        for name in Window.__dataclass_fields__
        if name != "found"
    }
    return Window(**cost, found=Answered(**found))


# --- one run ---------------------------------------------------------------------------------------------------------


def _minimal(kind: str = "predicted") -> tuple[str, ...]:
    return "-m", "bench.graph", "minimal", kind


def _run(node: tuple[str, ...], kind: str = "predicted", rate_hz: float = NATIVE_RATE_HZ) -> Window:
    """Measure a node while messages flow."""
    (window,) = streamed(node, kind, rate_hz, [MEASURE_S])
    figures = {**vars(window), **vars(window.found)}
    values = ", ".join(f"{name} {value:.4g}" for name, value in figures.items() if name != "found")
    print(f"  {node[-1]}, {rate_hz:.0f} Hz: {values}", file=sys.stderr, flush=True)
    return window


if __name__ == "__main__":
    print(render(rows()))
