"""`python -m bench [NAME ...]`: benchmarks with targets and baselines; all, or those of `NAMES`."""

from __future__ import annotations

import datetime as dt
import importlib
import os
import platform
import sys

import numba
import numpy as np

from bench.machine import machine
from bench.table import render

NAMES = ("start", "ode", "effects", "bag", "replay", "sessions", "live", "fit", "trace")


def main(arguments: list[str]) -> int:
    """Run the given benchmarks, or all, and print one table."""
    unknown = [name for name in arguments if name not in NAMES]
    if unknown:
        print(f"bench: unknown: {', '.join(unknown)}; allowed: {', '.join(NAMES)}", file=sys.stderr)
        return 2
    rows = []
    for name in [name for name in NAMES if name in arguments or not arguments]:
        print(f"bench: measuring {name}", file=sys.stderr, flush=True)
        rows += importlib.import_module(f"bench.{name}").rows()
    print(render(rows))
    print(setting())
    return 0


def setting() -> str:
    """Machine, versions and time of the measurement."""
    versions = f"Python {platform.python_version()}, numba {numba.__version__}, numpy {np.__version__}"
    load = f"load {os.getloadavg()[0]:.1f}"
    return f"{machine()}, {load}; {versions}; {dt.datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
