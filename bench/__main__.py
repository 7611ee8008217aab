"""`python -m bench [start] [ode] [effects] [bag] [replay] [live] [fit]`: the marks beside their baselines."""

from __future__ import annotations

import datetime as dt
import importlib
import os
import platform
import sys
from pathlib import Path

import numba
import numpy as np

from bench.table import render

NAMES = ("start", "ode", "effects", "bag", "replay", "live", "fit")


def main(asked: list[str]) -> int:
    """Run the benchmarks asked for, all without a name, and print one table."""
    unknown = [name for name in asked if name not in NAMES]
    if unknown:
        print(f"bench: {', '.join(unknown)} is unknown, known are {', '.join(NAMES)}", file=sys.stderr)
        return 2
    rows = []
    for name in [name for name in NAMES if name in asked or not asked]:
        print(f"bench: measuring {name}", file=sys.stderr, flush=True)
        rows += importlib.import_module(f"bench.{name}").rows()
    print(render(rows))
    print(setting())
    return 0


def setting() -> str:
    """Where and when this was measured; ratios travel, absolute times do not."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "unknown CPU")
    versions = f"Python {platform.python_version()}, numba {numba.__version__}, numpy {np.__version__}"
    machine = f"{os.cpu_count()} cores, {model}, load {os.getloadavg()[0]:.1f}"
    return f"{machine}; {versions}; {dt.datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
