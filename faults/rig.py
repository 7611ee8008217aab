"""A test rig for faults over DDS: the live node in its own process, six sensors in real time, and its outputs."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

from biodyn_core.base.segments import SENSORS
from biodyn_ros.bag.cdr import encode_imu
from biodyn_ros.base import topics
from faults.ride import ride

START_WITHIN_S: Final = 120.0
"""Without a cache the node compiles every kernel first."""

SLOT_S: Final = 0.01
RELIABLE: Final = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=20_000, reliability=ReliabilityPolicy.RELIABLE)


@dataclass
class Received:
    """Messages of the node, with their times in seconds since the start of the ride."""

    statuses: list[tuple[float, Mapping[str, Any]]] = field(default_factory=list)
    predicted_s: list[float] = field(default_factory=list)
    vdv: list[tuple[float, float]] = field(default_factory=list)


class Rig:
    """The node under test, a test node, and the ride to send; made by `rig`."""

    def __init__(self, live: subprocess.Popen[str], node: Any, executor: Any) -> None:
        self.live, self.node, self._executor = live, node, executor
        self.outputs = {name: node.create_publisher(Imu, topics.INPUT[name], RELIABLE) for name in SENSORS}
        self.received, self._begun, self.frame_id = Received(), 0.0, "imu"
        node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, 50)
        predicted = topics.absolute(topics.PREDICTED["head"])
        node.create_subscription(AccelStamped, predicted, self._on_predicted, RELIABLE, raw=True)
        node.create_subscription(Float64, "/biodyn/exposure/seat/vdv", self._on_vdv, 10)

    def wait(self, condition: Any, what: str, within_s: float = START_WITHIN_S) -> None:
        """Spin until the condition holds; TimeoutError with `what` if it does not."""
        deadline = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"not within {within_s:g} s: {what}")
            if self.live.poll() is not None:
                raise TimeoutError(f"the live node ended with {self.live.returncode}: {what}")
            self._executor.spin_once(timeout_sec=0.02)

    def matched(self) -> bool:
        """Whether the node subscribes to all sensors."""
        return all(output.get_subscription_count() > 0 for output in self.outputs.values())

    @property
    def now_s(self) -> float:
        """Seconds since the start of the ride."""
        return time.monotonic() - self._begun

    def begin(self) -> None:
        """Start the ride and discard earlier messages."""
        self.received, self._begun = Received(), time.monotonic()

    def play(self, until_s: float, actions: Mapping[float, Any]) -> None:
        """Send the ride in real time; each action is called once at its second."""
        self.wait(self.matched, "the node subscribes")
        streams = {
            name: (one.arrival_s, encode_imu(one.stamps_ns, one.accel_mps2, np.zeros_like(one.accel_mps2), "imu"))
            for name, one in ride().items()
        }
        done, left = dict.fromkeys(SENSORS, 0), sorted(actions.items(), key=lambda item: item[0])
        self.begin()
        while (now_s := self.now_s) < until_s:
            while left and left[0][0] <= now_s:
                left.pop(0)[1](self)
            for name, (arrival_s, messages) in streams.items():
                end = int(np.searchsorted(arrival_s, now_s))
                for i in range(done[name], end):
                    self.outputs[name].publish(self._framed(name, i, messages))
                done[name] = end
            slot_end = time.monotonic() + SLOT_S
            while time.monotonic() < slot_end:
                self._executor.spin_once(timeout_sec=0.002)

    def _framed(self, name: str, i: int, messages: Any) -> bytes:
        if self.frame_id == "imu":
            return bytes(messages[i])
        one, part = ride()[name], slice(i, i + 1)
        return bytes(encode_imu(one.stamps_ns[part], one.accel_mps2[part], np.zeros((1, 3)), self.frame_id)[0])

    def _on_diagnostics(self, message: Any) -> None:
        if self._begun:
            self.received.statuses.append((self.now_s, {one.name: one for one in message.status}))

    def _on_predicted(self, message: bytes) -> None:
        self.received.predicted_s.append(self.now_s)

    def _on_vdv(self, message: Any) -> None:
        self.received.vdv.append((self.now_s, message.data))


@contextlib.contextmanager
def rig(*parameters: str) -> Iterator[Rig]:
    """A rig whose node has these parameters (`name:=value`); ends all processes that it started."""
    # Reliable, so that a busy machine loses no message and only the injected fault has an effect.
    whole = [f"qos_overrides./{topic}.subscription.reliability:=reliable" for topic in topics.INPUT.values()]
    given = [word for one in ("state_file:=none", *whole, *parameters) for word in ("-p", one)]
    live = subprocess.Popen(
        [sys.executable, "-m", "biodyn_ros.commands.cli", "live", "--ros-args", "--log-level", "fatal", *given],
        text=True, stderr=subprocess.PIPE,
    )  # fmt: skip
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(os.environ.get("ROS_DOMAIN_ID", "0")))
    node = rclpy.create_node("faults", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield Rig(live, node, executor)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
        ended(live)


def ended(process: subprocess.Popen[str]) -> str:
    """End a child process as Ctrl-C would; returns its standard error."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        process.kill()
        _, errors = process.communicate()
    return errors or ""


LIMITED: Final = """
import resource, runpy, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
limit = int(sys.argv.pop(1))
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.argv[0] = "biodyn"
runpy.run_module("biodyn_ros.commands.cli", run_name="__main__")
"""
"""Runs a command with a limit on the size of its files, as a substitute for a full disk."""


def command(*arguments: str, file_limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command of biodyn; file_limit: the maximum size of its files in bytes."""
    words = ["-m", "biodyn_ros.commands.cli"] if file_limit is None else ["-c", LIMITED, str(file_limit)]
    return subprocess.run(
        [sys.executable, *words, *arguments], text=True, capture_output=True, check=False, timeout=300
    )
