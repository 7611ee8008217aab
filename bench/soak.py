"""`python -m bench.soak [MINUTES]`: the live node for half an hour over real DDS, then at up to four times the rate.

Every window is a row: answers lost, CPU of the node's process, how late answers come, resident memory. Exits with 1
where anything was lost at the native rate or memory grew behind the warm-up.
"""

from __future__ import annotations

import os
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.__main__ import setting
from bench.live import MARGIN_S, NODE, SETTLE_S, TAIL_S
from bench.processes import ENDING_S, Answered, answered, cpu_s, resident_mb, running, stop
from biodyn_core.synthesis import NATIVE_RATE_HZ
from biodyn_ros.environment import settle

MINUTES = 30.0
WINDOWS = 10
RAMP = (1.5, 2.0, 3.0, 4.0)
RAMP_S = 30.0
WARM_SHARE = 0.1
MOST_GROWTH_MB = 3.0
"""Memory is flat where it grows by less behind the warm-up; an arena of the allocator is one."""


@dataclass(frozen=True)
class Window:
    """A stretch of the run, seconds since it began: what it cost and what became of its samples."""

    rate: float
    begin_s: float
    end_s: float
    cpu_percent: float
    resident_mb: float
    found: Answered

    @property
    def line(self) -> str:
        """A row of the table."""
        one = self.found
        return (
            f"{self.rate:4.1f} x {self.begin_s:8.0f} to {self.end_s:6.0f} s {one.owed:12,d} {one.lost:9,d}"
            f" {self.cpu_percent:8.1f} {one.p50_ms:8.3f} {one.p99_ms:8.3f} {one.late_p99_ms:8.3f}"
            f" {self.resident_mb:9.1f}"
        )


HEADER = " rate     from      to          answers     lost    CPU %   p50 ms   p99 ms  sent late     MB"


def soaked(rate: float, seconds: float, windows: int) -> list[Window]:
    """Run the node for so long at so many times the native rate, and look at it window by window."""
    edges = np.linspace(SETTLE_S, SETTLE_S + seconds, windows + 1).tolist()
    with TemporaryDirectory() as directory, ExitStack() as started:
        sent, got = Path(directory, "sent.npz"), Path(directory, "got.npz")
        pid = started.enter_context(running(*NODE)).pid
        subscriber = started.enter_context(running("-m", "bench.graph", "subscriber", "predicted", str(got)))
        words = (str(rate * NATIVE_RATE_HZ), str(edges[-1] + TAIL_S), str(sent))
        publisher = started.enter_context(running("-m", "bench.graph", "publisher", *words))
        if publisher.stdout is None or not publisher.stdout.readline():
            raise RuntimeError("the publisher found nobody to listen")
        begin_s, costs = time.monotonic(), []
        for edge in edges:
            time.sleep(max(0.0, begin_s + edge - time.monotonic()))
            costs.append((time.monotonic(), cpu_s(pid), resident_mb(pid)))
        publisher.wait(TAIL_S + ENDING_S)
        time.sleep(MARGIN_S)
        stop(subscriber)
        arrays = dict(np.load(sent)), dict(np.load(got))
    return [
        Window(rate, begin, end, 100.0 * (after[1] - before[1]) / (after[0] - before[0]), after[2],
               answered(*arrays, begin, end))
        for begin, end, before, after in zip(edges, edges[1:], costs, costs[1:], strict=False)
    ]  # fmt: skip


def main(arguments: list[str]) -> int:
    """Soak, ramp, print, judge."""
    minutes = float(arguments[0]) if arguments else MINUTES
    domain = settle(os.environ)
    try:
        print(HEADER, flush=True)
        native = soaked(1.0, 60.0 * minutes, WINDOWS)
        print(*(one.line for one in native), sep="\n", flush=True)
        for rate in RAMP:
            print(*(one.line for one in soaked(rate, min(RAMP_S, 60.0 * minutes), 1)), sep="\n", flush=True)
    finally:
        if domain:
            domain.release()
    warm = native[max(1, round(WARM_SHARE * len(native))) - 1]
    lost, grown_mb = sum(one.found.lost for one in native), native[-1].resident_mb - warm.resident_mb
    print(f"lost at the native rate: {lost}; counted by the node: {native[-1].found.counted_lost}")
    print(f"memory behind the first window: {grown_mb:+.1f} MB")
    print(setting())
    return 1 if lost or grown_mb > MOST_GROWTH_MB else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
