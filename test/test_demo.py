"""The demo as a user runs it: the live node and the replay give the same figures, also on a busy machine."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from ros import STARTUP_S
from streams import noisy_streams, write_bag

from biodyn_core.body.origin import origin_of
from biodyn_core.body.subject import load_subject
from biodyn_ros import demo
from biodyn_ros.commands.cli import main

HELD_UP_S = 0.5
"""Seven times as long as the shared memory of best-effort subscriptions lasts."""


def live_child(of: subprocess.Popen[str]) -> int:
    """The process id of the live node that a demo has started."""
    children = Path(f"/proc/{of.pid}/task/{of.pid}/children").read_text().split()
    return next(int(pid) for pid in children if b"live" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0"))


DEMO = """
import sys
from pathlib import Path

from biodyn_ros import demo
from biodyn_ros.commands.cli import main
from biodyn_ros.reports import drawing
from markupsafe import Markup

bag = Path(sys.argv.pop())
demo.bag_file = lambda name: bag.with_name(name)
drawing.drawn = lambda *given: Markup("<svg></svg>")
sys.exit(main())
"""
"""The demo with a shorter bag, and a report without drawings."""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of the first subject that has the name of the demo's own."""
    return write_bag(tmp_path_factory.mktemp("bags") / demo.BAG, noisy_streams(3.0))


@contextmanager
def running(out: Path, bag: Path) -> Iterator[subprocess.Popen[str]]:
    """A demo that has shown its first line of figures."""
    command = [sys.executable, "-c", DEMO, "demo", "--out", str(out), str(bag)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        end = time.monotonic() + STARTUP_S
        while not re.match(r" +\d+\.\d+ +\d", process.stdout.readline()):
            assert time.monotonic() < end and process.poll() is None
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(30.0)


def test_live_equals_the_replay_though_the_node_is_held_up(tmp_path: Path, bag: Path) -> None:
    with running(tmp_path / "out", bag) as running_demo:
        live = live_child(running_demo)
        os.kill(live, signal.SIGSTOP)
        time.sleep(HELD_UP_S)
        os.kill(live, signal.SIGCONT)
        output, _ = running_demo.communicate(timeout=120.0)
    assert running_demo.returncode == 0
    found = re.search(r"seat VDV live (\S+), offline (\S+) m/s", output)
    assert found is not None, output
    assert found[1] == found[2]
    assert origin_of(load_subject(tmp_path / "out" / "me.yaml")) == "group"
    rows = [line.split() for line in output.split("the same bag beside the paper's subjects", 1)[1].splitlines()]
    head = next(row for row in rows if row[:1] == ["head"])
    measured, _, lower, _, upper, maker, other = head[1:]
    assert float(lower) < float(upper) and float(maker) == pytest.approx(float(measured), rel=0.02) != float(other)


@pytest.mark.parametrize(
    ("which", "said"), [("live", "the live node ended"), ("play", "playing the bag failed")], ids=["node", "player"]
)
def test_a_demo_whose_process_exits_ends_the_other_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], which: str, said: str
) -> None:
    """Two processes that do nothing stand for node and player."""
    started: dict[str, subprocess.Popen[bytes]] = {}

    def child(command: str, *arguments: str) -> subprocess.Popen[bytes]:
        started[command] = subprocess.Popen(["sleep", "600"])
        if len(started) == 2:
            started[which].kill()
        return started[command]

    monkeypatch.setattr(demo, "_child", child)
    monkeypatch.setattr(demo, "_wait_for_subscription", lambda observer, live: None)
    try:
        assert main(["demo", "--out", str(tmp_path / "out")]) == 2
        assert f"biodyn demo: {said} (exit code -9)" in capsys.readouterr().err
        ended = {"live": -signal.SIGINT, "play": -signal.SIGINT} | {which: -signal.SIGKILL}
        assert {name: process.poll() for name, process in started.items()} == ended
    finally:
        for process in started.values():
            process.kill()
            process.wait()


def test_an_unwritable_output_is_refused_before_the_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    output, errors = capsys.readouterr()
    assert output == "" and "file: is a file; the results need a directory" in errors
