"""The demo as somebody runs it: what the live node says is what the replay says, though the machine holds it up."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from ros import STARTUP_S

HELD_UP_S = 0.5
"""Seven times as long as the shared memory of best-effort subscriptions lasts."""


def live_child(of: subprocess.Popen[str]) -> int:
    """The process id of the live node that a demo has started."""
    children = Path(f"/proc/{of.pid}/task/{of.pid}/children").read_text().split()
    return next(int(pid) for pid in children if b"live" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"))


def test_live_equals_the_replay_though_the_node_is_held_up(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "biodyn_ros.cli", "demo", "--out", str(tmp_path / "out")]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert demo.stdout is not None
    try:
        end = time.monotonic() + STARTUP_S
        while not re.match(r" +\d+\.\d{3} +\d", demo.stdout.readline()):  # a line of figures: it runs
            assert time.monotonic() < end and demo.poll() is None
        live = live_child(demo)
        os.kill(live, signal.SIGSTOP)
        time.sleep(HELD_UP_S)
        os.kill(live, signal.SIGCONT)
        said, _ = demo.communicate(timeout=120.0)
    finally:
        if demo.poll() is None:
            demo.send_signal(signal.SIGINT)
            demo.wait(30.0)
    assert demo.returncode == 0
    found = re.search(r"seat VDV live (\S+), offline (\S+) m/s", said)
    assert found is not None, said
    assert found[1] == found[2]
