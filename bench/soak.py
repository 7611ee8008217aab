"""`python -m bench.soak [MINUTES]`: runs the live node for 30 minutes over real DDS, then at up to four times the rate.

Predictions leave in blocks.

Each window is a row: lost responses, CPU of the node's process, latency, resident memory. Exit code 1 if a message is
lost at the native rate or memory grows after the warm-up.
"""

from __future__ import annotations

import os
import sys

from bench.__main__ import setting
from bench.processes import NODE, FellBehind, Window, streamed
from biodyn_core.body.synthesis_settings import NATIVE_RATE_HZ
from biodyn_ros.base.environment import prepare

MINUTES = 30.0
WINDOWS = 10
RAMP = (1.5, 2.0, 3.0, 4.0)
RAMP_S = 30.0
WARM_SHARE = 0.1
MAX_GROWTH_MB = 3.0
"""Allowed growth of memory after the warm-up; an arena of the allocator takes 1 MB."""


HEADER = " rate     from      to          answers     lost    CPU %   p50 ms   p99 ms  sent late     MB"


def soaked(rate: float, seconds: float, windows: int) -> list[Window]:
    """Run the node at a multiple of the native rate, and print each window."""
    found = streamed(NODE, "block", rate * NATIVE_RATE_HZ, [seconds / windows] * windows)
    for window in found:
        one = window.found
        print(
            f"{rate:4.1f} x {window.begin_s:8.0f} to {window.end_s:6.0f} s {one.owed:12,d} {one.lost:9,d}"
            f" {window.cpu_percent:8.1f} {one.p50_ms:8.3f} {one.p99_ms:8.3f} {one.late_p99_ms:8.3f}"
            f" {window.resident_mb:9.1f}",
            flush=True,
        )
    return found


def main(arguments: list[str]) -> int:
    """Run at the native rate, then at higher rates, and print the result."""
    minutes = float(arguments[0]) if arguments else MINUTES
    domain = prepare(os.environ)
    try:
        print(HEADER, flush=True)
        native = soaked(1.0, 60.0 * minutes, WINDOWS)
        for rate in RAMP:
            try:
                soaked(rate, min(RAMP_S, 60.0 * minutes), 1)
            except FellBehind as why:
                print(f"{rate:4.1f} x {why}", flush=True)
    finally:
        if domain:
            domain.release()
    warm = native[max(1, round(WARM_SHARE * len(native))) - 1]
    lost, grown_mb = sum(one.found.lost for one in native), native[-1].resident_mb - warm.resident_mb
    print(f"lost at the native rate: {lost}; counted by the node: {native[-1].found.counted_lost}")
    print(f"memory growth after the first window: {grown_mb:+.1f} MB")
    print(setting())
    return 1 if lost or grown_mb > MAX_GROWTH_MB else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
