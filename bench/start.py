"""Start: time of commands that compute little, compared with that of the necessary imports."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time

from bench.processes import stop
from bench.table import Row, render
from biodyn_ros.base.resources import bag_file
from biodyn_ros.commands.table import NAMES

ROUNDS = 7
MAX_RATIO = 2.0
COMMAND = (sys.executable, "-m", "biodyn_ros.commands.cli")
IMPORTS = (sys.executable, "-c", "import numpy, scipy.signal")
NODE_IMPORTS = (sys.executable, "-c", "import rclpy, numpy, scipy.signal, numba, sensor_msgs.msg, trajectory_msgs.msg")
LIVE = (*COMMAND, "live", "--ros-args", "-p", "state_file:=none")
LISTENING = "listening to 6 sensors"
LIVE_ROUNDS = 3


def rows() -> list[Row]:
    """Measure; about a minute. Processes alternate, and medians are compared."""
    info = (*COMMAND, "info", str(bag_file("subject_1.mcap")))
    helps = {f"{name} -h": (*COMMAND, name, "-h") for name in NAMES}
    programs = {"version": (*COMMAND, "--version"), "imports": IMPORTS, "info": info, **helps}
    times: dict[str, list[float]] = {name: [] for name in (*programs, "info, nothing cached")}
    for _ in range(ROUNDS):
        for name, program in programs.items():
            times[name].append(_process_s(program))
        with tempfile.TemporaryDirectory() as folder:
            times["info, nothing cached"].append(_process_s(info, NUMBA_CACHE_DIR=folder))
    live = [(_process_s(NODE_IMPORTS), _listening_s(), _listening_s(fresh=True)) for _ in range(LIVE_ROUNDS)]
    node_imports_s, warm_s, fresh_s = (statistics.median(column) for column in zip(*live, strict=True))
    median = {name: statistics.median(each) for name, each in times.items()}
    slowest = max(helps, key=lambda name: median[name])
    return [
        _row(f"the slowest help, biodyn {slowest}", median[slowest], median["version"], "--version"),
        _row("info of the bundled bag", median["info"], median["imports"], "import numpy, scipy.signal"),
        _row("... nothing compiled before", median["info, nothing cached"], median["imports"], "the same imports"),
        _row("live: process start to listening", warm_s, node_imports_s, "imports alone"),
        Row("... nothing compiled before", fresh_s, "s", warm_s, "compiled before", "-", None),
    ]


def _row(what: str, ours_s: float, baseline_s: float, baseline: str) -> Row:
    return Row(what, ours_s, "s", baseline_s, baseline, f"<= {MAX_RATIO:g} times", ours_s <= MAX_RATIO * baseline_s)


def _listening_s(fresh: bool = False) -> float:
    """The time from the start of the live node until it listens to its sensors; fresh: nothing is compiled before."""
    with tempfile.TemporaryDirectory() as folder:
        changed = {"NUMBA_CACHE_DIR": folder} if fresh else {}
        start = time.perf_counter()
        node = subprocess.Popen(LIVE, env={**os.environ, **changed}, stderr=subprocess.PIPE, text=True)
        try:
            assert node.stderr is not None
            for line in node.stderr:
                if LISTENING in line:
                    return time.perf_counter() - start
            raise RuntimeError("the live node did not start")
        finally:
            stop(node)


def _process_s(program: tuple[str, ...], **environment: str) -> float:
    start = time.perf_counter()
    subprocess.run(program, env={**os.environ, **environment}, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


if __name__ == "__main__":
    print(render(rows()))
