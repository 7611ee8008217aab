"""Shutdown of processes: bounded in time, silent with exit code 0, not delayed by a backlog."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rclpy.task import Future
from ros import STARTUP_S, Graph, Sensors
from std_msgs.msg import Empty
from streams import noisy_streams
from test_exposure_store import newest

from biodyn_core.base.segments import SENSORS
from biodyn_ros.base.shutdown import Shutdown
from biodyn_ros.node.callbacks import spin

_ASKED = """
import atexit, ctypes, os, signal, threading, time
from biodyn_ros.base import shutdown as bounds
bounds.TIMEOUT_S, bounds.ALARM_S = 0.3, 1.5
with bounds.Shutdown("biodyn test") as shutdown:
    os.kill(os.getpid(), signal.SIGTERM)
    while not shutdown.requested:
        time.sleep(0.01)
    shutdown.run_stages([("the page", lambda: None), ("the node", lambda: NODE)])
BEHIND
"""

SLEEP = "time.sleep(600)"
HELD = "ctypes.PyDLL(None).sleep(600)"
"""A call into C that keeps the interpreter's lock: no thread of Python runs any more."""

NAMED = "biodyn test: {} has not ended 0.3 s after SIGTERM: the process is ended\n"


@pytest.mark.parametrize(
    ("node", "behind", "code", "expected"),
    [
        ("None", "", 0, ""),
        ("os.kill(os.getpid(), signal.SIGINT)", "", 0, ""),
        (SLEEP, "", 1, NAMED.format("the node")),
        (HELD, "", -signal.SIGALRM, 'File "<string>", line 9 in <lambda>'),
        ("None", f"threading.Thread(target=lambda: {SLEEP}).start()", 1, NAMED.format("the interpreter")),
        ("None", f"atexit.register(lambda: {HELD})", -signal.SIGALRM, 'File "<string>", line 10 in <lambda>'),
    ],
    ids=["nothing hangs", "a second signal", "a stage", "Python itself", "a thread", "the interpreter's end"],
)
def test_a_shutdown_is_bounded_and_names_the_stage_that_hangs(node: str, behind: str, code: int, expected: str) -> None:
    words = _ASKED.replace("NODE", node).replace("BEHIND", behind)
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == code, done.stderr
    assert expected in done.stderr
    assert bool(expected) == bool(done.stderr)


def test_without_a_signal_nothing_is_left_behind() -> None:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = [signal.getsignal(number) for number in numbers]
    with Shutdown("biodyn test", interrupts=True) as shutdown:
        assert not shutdown.requested
    assert [signal.getsignal(number) for number in numbers] == before
    assert signal.set_wakeup_fd(-1) == -1


def test_spinning_ends_though_messages_never_stop_waiting(graph: Graph) -> None:
    node, ended, calls = graph.node(), Future(), []
    output = node.create_publisher(Empty, "round", 100)

    def again(message: Empty) -> None:
        calls.append(message)
        if len(calls) == 100:
            ended.set_result(None)
        if len(calls) < 20_000:  # a spin that does not end by then never would
            output.publish(message)

    node.create_subscription(Empty, "round", again, 100)
    graph.wait(lambda: output.get_subscription_count() == 1, "it hears itself")
    for _ in range(20):
        output.publish(Empty())
    spin(graph.executor, ended)
    assert 100 <= len(calls) < 20_000


_HANGING_PAGE = """
import sys, time
from biodyn_ros.base import shutdown
from biodyn_ros.node import live
shutdown.TIMEOUT_S = 2.0
live.BiodynNode._end_page = lambda self: time.sleep(600)
sys.exit(live.main(sys.argv[1:]))
"""


@pytest.mark.timeout(240)
def test_a_live_node_whose_page_hangs_keeps_its_exposure_and_names_the_page(graph: Graph, tmp_path: Path) -> None:
    path, streams = tmp_path / "kept.json", noisy_streams()
    given = ("--ros-args", "--log-level", "error", "-p", f"state_file:={path}")
    environment = os.environ | {"ROS_DOMAIN_ID": str(graph.context.get_domain_id())}
    sensors = Sensors(graph, SENSORS)
    live = subprocess.Popen(
        [sys.executable, "-c", _HANGING_PAGE, *given], env=environment, stderr=subprocess.PIPE, text=True
    )
    try:
        graph.wait(sensors.matched, "six inputs matched", STARTUP_S)
        graph.spin(0.5)
        sensors.send()
        graph.wait(lambda: path.exists() and newest(path) > streams[0].stamps_ns[3000], "exposure is kept")
        path.unlink()
        live.send_signal(signal.SIGTERM)
        _, errors = live.communicate(timeout=60)
    finally:
        live.kill()
    assert live.returncode == 1
    assert errors == "biodyn live: the page has not ended 2 s after SIGTERM: the process is ended\n"
    assert newest(path) > streams[0].stamps_ns[3000]
