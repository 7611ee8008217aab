"""The live node over real DDS, three processes, beside a node that passes the same messages without mathematics.

A publisher sends six Imu topics, the node answers, a subscriber takes six predicted topics at full rate; the node and
the baseline take turns before the same publisher and subscriber. CPU is the node's process alone, start-up left out.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.processes import ENDING_S, answered, cpu_s, resident_mb, running, stop
from bench.table import Row, render
from biodyn_core.synthesis import NATIVE_RATE_HZ
from biodyn_ros.environment import settle

ROUNDS = 4
SETTLE_S = 3.0  # rest, first predictions, discovery
MEASURE_S = 10.0
TAIL_S = 2.0  # measurements wait a second for the slowest sensor: the last ones are not owed yet
MARGIN_S = 1.0  # between the last message and the end of who receives it

PROTOTYPE_RATIO = 15.0 / 10.6
"""The mark over what the prototype without exposure took on the machine the mark was set on."""

NODE = ("-m", "biodyn_ros.cli", "live", "--ros-args", "-p", "state_file:=none", "--log-level", "warn")
MEASURED = ("-p", "publish_measured:=true")
BASELINE = "without mathematics"


@dataclass(frozen=True)
class Run:
    """One node before publisher and subscriber: what it cost, lost and how late it answered; times beyond the delay."""

    cpu_percent: float
    resident_mb: float
    growth_mb: float
    owed: int
    lost: int
    counted_lost: int
    p50_ms: float
    p99_ms: float
    late_p99_ms: float


def rows() -> list[Row]:
    """Measure; about five minutes."""
    domain = settle(os.environ)  # already held where the environment wrapper started us
    try:
        turns = [(_run(NODE), _run(_minimal())) for _ in range(ROUNDS)]
        measured = _run((*NODE, *MEASURED), "measured"), _run(_minimal("measured"), "measured")
        fast = _run(NODE, rate_hz=4.0 * NATIVE_RATE_HZ), _run(_minimal(), rate_hz=4.0 * NATIVE_RATE_HZ)
    finally:
        if domain:
            domain.release()
    ours, baseline = (_middle(runs) for runs in zip(*turns, strict=True))
    return [*_main_rows(ours, baseline), *_side_rows("12 topics", *measured, 30.0), *_side_rows("4 x the rate", *fast)]


def _main_rows(ours: Run, baseline: Run) -> list[Row]:
    cpu, limit = ours.cpu_percent, PROTOTYPE_RATIO * baseline.cpu_percent
    return [
        Row("live: CPU of one core", cpu, "%", None, "", "<= 15", cpu <= 15.0),
        Row("live: CPU of one core", cpu, "%", baseline.cpu_percent, BASELINE, "<= 1.42 x", cpu <= limit),
        _lost_row("live", ours, baseline),
        Row("live: lost, as the node counts", ours.counted_lost, "messages", None, "", "0", ours.counted_lost == 0),
        Row("live: answer after sample, p50", ours.p50_ms, "ms", baseline.p50_ms, BASELINE, "-", None),
        Row("live: answer after sample, p99", ours.p99_ms, "ms", baseline.p99_ms, BASELINE, "<= 1", ours.p99_ms <= 1.0),
        Row("live: resident, warm cache", ours.resident_mb, "MB", None, "", "<= 300", ours.resident_mb <= 300.0),
        Row("live: its growth in 10 s", ours.growth_mb, "MB", None, "", "-", None),
        Row("live: publisher's own lateness, p99", ours.late_p99_ms, "ms", baseline.late_p99_ms, BASELINE, "-", None),
    ]


def _side_rows(name: str, ours: Run, baseline: Run, cpu_mark: float | None = None) -> list[Row]:
    cpu = ours.cpu_percent
    mark, met = ("-", None) if cpu_mark is None else (f"<= {cpu_mark:g}", cpu <= cpu_mark)
    return [
        Row(f"live, {name}: CPU of one core", cpu, "%", baseline.cpu_percent, BASELINE, mark, met),
        _lost_row(f"live, {name}", ours, baseline),
        Row(f"live, {name}: answer after sample, p99", ours.p99_ms, "ms", baseline.p99_ms, BASELINE, "-", None),
    ]


def _lost_row(name: str, ours: Run, baseline: Run) -> Row:
    what = f"{name}: lost of {ours.owed:,} answers"
    return Row(what, ours.lost, "messages", baseline.lost, BASELINE, "0", ours.lost == 0)


def _middle(runs: tuple[Run, ...]) -> Run:
    """Medians, but every loss of every round."""
    lost = {"owed", "lost", "counted_lost"}
    return Run(
        **{
            name: (sum if name in lost else statistics.median)([getattr(run, name) for run in runs])
            for name in Run.__dataclass_fields__
        }
    )


# --- one run ---------------------------------------------------------------------------------------------------------


def _minimal(kind: str = "predicted") -> tuple[str, ...]:
    return "-m", "bench.graph", "minimal", kind


def _run(node: tuple[str, ...], kind: str = "predicted", rate_hz: float = NATIVE_RATE_HZ) -> Run:
    """Start the three processes, measure the node while messages flow, and compare what was sent with what came."""
    seconds = SETTLE_S + MEASURE_S + TAIL_S
    with TemporaryDirectory() as directory, ExitStack() as started:
        sent, got = Path(directory, "sent.npz"), Path(directory, "got.npz")
        pid = started.enter_context(running(*node)).pid
        subscriber = started.enter_context(running("-m", "bench.graph", "subscriber", kind, str(got)))
        publisher = started.enter_context(
            running("-m", "bench.graph", "publisher", str(rate_hz), str(seconds), str(sent))
        )
        if publisher.stdout is None or not publisher.stdout.readline():
            raise RuntimeError("the publisher found nobody to listen")
        time.sleep(SETTLE_S)
        before_s, begin_s, before_mb = cpu_s(pid), time.monotonic(), resident_mb(pid)
        time.sleep(MEASURE_S)
        cpu_percent = 100.0 * (cpu_s(pid) - before_s) / (time.monotonic() - begin_s)
        growth_mb = resident_mb(pid) - before_mb
        publisher.wait(TAIL_S + ENDING_S)
        time.sleep(MARGIN_S)
        stop(subscriber)
        found = answered(dict(np.load(sent)), dict(np.load(got)), SETTLE_S, SETTLE_S + MEASURE_S)
    run = Run(cpu_percent, before_mb + growth_mb, growth_mb, **asdict(found))
    told = ", ".join(f"{name} {value:.4g}" for name, value in asdict(run).items())
    print(f"  {node[-1]}, {rate_hz:.0f} Hz: {told}", file=sys.stderr, flush=True)
    return run


if __name__ == "__main__":
    print(render(rows()))
