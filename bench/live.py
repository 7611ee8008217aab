"""The live node over real DDS, three processes, beside a node that passes the same messages without mathematics.

A publisher sends six Imu topics, the node answers, a subscriber takes six predicted topics at full rate; the node and
the baseline take turns before the same publisher and subscriber. CPU is the node's process alone, start-up left out.
"""

from __future__ import annotations

import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from bench.table import Row, render
from biodyn_core.synthesis import NATIVE_RATE_HZ
from biodyn_ros.environment import settle

ROUNDS = 4
SETTLE_S = 3.0  # rest, first predictions, discovery
MEASURE_S = 10.0
TAIL_S = 2.0  # measurements wait a second for the slowest sensor: the last ones are not owed yet
MARGIN_S = 1.0  # between the last message and the end of who receives it
ENDING_S = 30.0
EXACT_NS = 1000  # diagnostics give the filter delay in whole microseconds

PROTOTYPE_RATIO = 15.0 / 10.6
"""The mark over what the prototype without exposure took on the machine the mark was set on."""

NODE = ("-m", "biodyn_ros.cli", "live", "--ros-args", "-p", "state_file:=none", "--log-level", "warn")
MEASURED = ("-p", "publish_measured:=true")
BASELINE = "without mathematics"

Arrays = dict[str, NDArray[np.int64]]


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
        pid = started.enter_context(_process(*node)).pid
        subscriber = started.enter_context(_process("-m", "bench.graph", "subscriber", kind, str(got)))
        publisher = started.enter_context(
            _process("-m", "bench.graph", "publisher", str(rate_hz), str(seconds), str(sent))
        )
        if publisher.stdout is None or not publisher.stdout.readline():
            raise RuntimeError("the publisher found nobody to listen")
        time.sleep(SETTLE_S)
        cpu_s, begin_s, resident_mb = _cpu_s(pid), time.monotonic(), _resident_mb(pid)
        time.sleep(MEASURE_S)
        cpu_percent = 100.0 * (_cpu_s(pid) - cpu_s) / (time.monotonic() - begin_s)
        growth_mb = _resident_mb(pid) - resident_mb
        publisher.wait(TAIL_S + ENDING_S)
        time.sleep(MARGIN_S)
        _end(subscriber)
        answered = _answered(dict(np.load(sent)), dict(np.load(got)))
    run = Run(cpu_percent, resident_mb + growth_mb, growth_mb, *answered)
    told = ", ".join(f"{name} {value:.4g}" for name, value in asdict(run).items())
    print(f"  {node[-1]}, {rate_hz:.0f} Hz: {told}", file=sys.stderr, flush=True)
    return run


def _answered(sent: Arrays, got: Arrays) -> tuple[int, int, int, float, float, float]:
    """Owed, lost, lost as counted, latency p50 and p99, the publisher's lateness p99, for the measured seconds."""
    diagnostics = json.loads(str(got.pop("diagnostics")))
    delay_ns = round(1e6 * float(diagnostics.get("biodyn: seat", {}).get("filter_delay_ms") or 0.0))
    stamps_ns = sent["stamps_ns"]
    owed = (stamps_ns > stamps_ns[0] + SETTLE_S * 1e9) & (stamps_ns < stamps_ns[0] + (SETTLE_S + MEASURE_S) * 1e9)
    names = [name.removesuffix("/stamps_ns") for name in got if name.endswith("/stamps_ns")]
    lost, latencies = 0, []
    for name in names:
        which, latency_ms = _latencies(sent, got[f"{name}/stamps_ns"] + delay_ns, got[f"{name}/arrived_ns"])
        lost += int(owed.sum()) - np.unique(which[owed[which]]).size
        if name.startswith("predicted"):  # measurements wait for the slowest sensor, so theirs is no mark
            latencies.append(latency_ms[owed[which]])
    counted = sum(int(values.get("lost", 0)) for values in diagnostics.values())
    p50, p99 = np.percentile(np.concatenate(latencies), [50, 99]).tolist()
    return int(owed.sum()) * len(names), lost, counted, p50, p99, 1e-6 * float(np.percentile(sent["late_ns"], 99))


def _latencies(
    sent: Arrays, answered_ns: NDArray[np.int64], arrived_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which sample each answer belongs to, and ms from that sample's leaving to the answer's arrival.

    An answer that belongs to no sample is an interpolated one, for which nothing was sent: it is left out.
    """
    stamps_ns = sent["stamps_ns"]
    which = np.minimum(np.searchsorted(stamps_ns, answered_ns - EXACT_NS), stamps_ns.size - 1)
    known = np.abs(stamps_ns[which] - answered_ns) <= EXACT_NS
    return which[known], 1e-6 * (arrived_ns - sent["sent_ns"][which])[known]


@contextmanager
def _process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    """As Ctrl-C would: a process killed at once leaves its shared memory to slow down the others."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _cpu_s(pid: int) -> float:
    """User and system time of all threads of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("VmRSS"))) / 1024.0


if __name__ == "__main__":
    print(render(rows()))
