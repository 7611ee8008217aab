"""Shared by the benchmarks of the live node: its three processes, cost of the node, and lost samples."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SEAT
from biodyn_ros.base import topics

NODE = ("-m", "biodyn_ros.commands.cli", "live", "--ros-args", "-p", "state_file:=none", "--log-level", "warn")

SETTLE_S = 3.0  # rest, first predictions, discovery
TAIL_S = 2.0  # measurements wait a second for the slowest sensor: the last ones are not expected yet
MARGIN_S = 1.0  # between the last message and the end of the subscriber
ENDING_S = 30.0
EXACT_NS = 1000  # diagnostics give the filter delay in whole microseconds

Arrays = dict[str, NDArray[np.int64]]


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A Python process with these arguments, stopped at the end."""
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        stop(process)


def stop(process: subprocess.Popen[str]) -> None:
    """Stop as Ctrl-C would: a killed process leaves its shared memory, which slows down the others."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def cpu_s(pid: int) -> float:
    """User and system time of all threads of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    """Resident memory of a process."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    return int(next(line.split()[1] for line in lines if line.startswith("VmRSS"))) / 1024.0


@dataclass(frozen=True)
class Answered:
    """Expected and lost responses in a window, losses counted by the node since its start, latency and sending delay.

    Latencies are without the filter's delay; NaN without a subscriber to predictions.
    """

    owed: int
    lost: int
    counted_lost: int
    p50_ms: float
    p99_ms: float
    late_p99_ms: float


def answered(sent: Arrays, got: Arrays, begin_s: float, end_s: float) -> Answered:
    """The responses to the samples sent in a time window."""
    diagnostics = json.loads(str(got["diagnostics"]))
    delay_ns = round(1e6 * float(diagnostics.get(topics.status_name(SEAT), {}).get("filter_delay_ms") or 0.0))
    stamps_ns = sent["stamps_ns"]
    owed = (stamps_ns > stamps_ns[0] + begin_s * 1e9) & (stamps_ns < stamps_ns[0] + end_s * 1e9)
    names = [name.removesuffix("/stamps_ns") for name in got if name.endswith("/stamps_ns")]
    lost, latencies = 0, []
    for name in names:
        which, latency_ms = _latencies(sent, got[f"{name}/stamps_ns"] + delay_ns, got[f"{name}/arrived_ns"])
        lost += int(owed.sum()) - np.unique(which[owed[which]]).size
        if name.startswith("predicted"):  # measurements wait for the slowest sensor, so they have no target
            latencies.append(latency_ms[owed[which]])
    counted = sum(int(values.get("lost", 0)) for values in diagnostics.values())
    p50, p99 = np.percentile(np.concatenate(latencies), [50, 99]).tolist() if latencies else (np.nan, np.nan)
    late_p99_ms = 1e-6 * float(np.percentile(sent["late_ns"][owed], 99))
    return Answered(int(owed.sum()) * len(names), lost, counted, p50, p99, late_p99_ms)


def _latencies(
    sent: Arrays, answered_ns: NDArray[np.int64], arrived_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The sample of each response, and the ms from sending the sample to receiving the response.

    A response without a sample is interpolated, and excluded.
    """
    stamps_ns = sent["stamps_ns"]
    which = np.minimum(np.searchsorted(stamps_ns, answered_ns - EXACT_NS), stamps_ns.size - 1)
    known = np.abs(stamps_ns[which] - answered_ns) <= EXACT_NS
    return which[known], 1e-6 * (arrived_ns - sent["sent_ns"][which])[known]


@dataclass(frozen=True)
class Window:
    """A window of a run, in seconds since its start: CPU and memory of the node, and its responses."""

    begin_s: float
    end_s: float
    cpu_percent: float
    resident_mb: float
    growth_mb: float
    found: Answered


class FellBehind(RuntimeError):
    """The publisher could not send at the requested rate."""


def streamed(node: Sequence[str], kind: str, rate_hz: float, seconds: Sequence[float]) -> list[Window]:
    """Stream from a publisher to a node and from it to a subscriber; consecutive windows of these lengths."""
    edges = np.cumsum([SETTLE_S, *seconds]).tolist()
    with TemporaryDirectory() as directory, ExitStack() as started:
        sent, got = Path(directory, "sent.npz"), Path(directory, "got.npz")
        pid = started.enter_context(running(*node)).pid
        subscriber = started.enter_context(running("-m", "bench.graph", "subscriber", kind, str(got)))
        words = (kind, str(rate_hz), str(edges[-1] + TAIL_S), str(sent))
        publisher = started.enter_context(running("-m", "bench.graph", "publisher", *words))
        if publisher.stdout is None or not publisher.stdout.readline():
            raise RuntimeError("the publisher found no subscriber")
        begin_s, costs = time.monotonic(), []
        for edge in edges:
            time.sleep(max(0.0, begin_s + edge - time.monotonic()))
            costs.append((time.monotonic(), cpu_s(pid), resident_mb(pid)))
        try:
            publisher.wait(TAIL_S + ENDING_S)
        except subprocess.TimeoutExpired:
            late = f"the publisher is {ENDING_S:g} s late at {rate_hz:.0f} Hz"
            raise FellBehind(f"{late}: the machine cannot send at this rate beside the node") from None
        time.sleep(MARGIN_S)
        stop(subscriber)
        arrays = dict(np.load(sent)), dict(np.load(got))
    windows = []
    for begin, end, before, after in zip(edges, edges[1:], costs, costs[1:], strict=False):
        cpu_percent, grown_mb = 100.0 * (after[1] - before[1]) / (after[0] - before[0]), after[2] - before[2]
        windows.append(Window(begin, end, cpu_percent, after[2], grown_mb, answered(*arrays, begin, end)))
    return windows
