"""A ROS graph of a test's own: an isolated context and domain, one executor, waiting on conditions with deadlines."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from expecting import until
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from streams import noisy_streams

from biodyn_core.body.synthesis import ImuStream
from biodyn_ros.bag.cdr import encode_imu
from biodyn_ros.base import topics
from biodyn_ros.base.environment import hold_domain
from biodyn_ros.node.callbacks import make_executor
from biodyn_ros.node.live import BiodynNode

DEADLINE_S = 30.0
STARTUP_S = 120.0  # a cold cache compiles every kernel first
DEEP = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=200_000, reliability=ReliabilityPolicy.RELIABLE)


class Graph:
    """Nodes of one test on an executor of their own."""

    def __init__(self, context: rclpy.Context, executor: Executor) -> None:
        self.context, self.executor = context, executor
        self.nodes: list[Node] = []

    def add(self, node: Node) -> Any:
        """Add a node; it is destroyed with the graph."""
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def node(self, name: str = "tester") -> Any:
        """A plain node."""
        return self.add(Node(name, context=self.context))

    def live(self, arguments: tuple[str, ...] = (), **parameters: Any) -> BiodynNode:
        """The live node with these parameters, not yet configured."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return self.add(
            BiodynNode(context=self.context, parameter_overrides=overrides, cli_args=["--ros-args", *arguments])
        )

    def active(self, arguments: tuple[str, ...] = (), **parameters: Any) -> BiodynNode:
        """The live node, configured and active."""
        node = self.live(arguments, **parameters)
        node.trigger_configure()
        assert node.failure is None, node.failure
        node.trigger_activate()
        assert node.failure is None, node.failure
        return node

    def wait(self, condition: Callable[[], Any], what: str, deadline_s: float = DEADLINE_S) -> None:
        """Spin until the condition holds; fails by name when the deadline passes."""
        until(condition, what, deadline_s, lambda: self.executor.spin_once(timeout_sec=0.02))

    def spin(self, seconds: float) -> None:
        """Spin for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)

    def collect(self, node: Node, kind: type, topic: str, *, raw: bool = False) -> list[Any]:
        """A list that every message of a topic is appended to."""
        got: list[Any] = []
        node.create_subscription(kind, topic, got.append, DEEP, raw=raw)
        return got


@contextmanager
def ros_graph() -> Iterator[Graph]:
    """A graph in its own domain, always shut down."""
    with hold_domain() as domain:
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain.domain_id)
        graph = Graph(context, make_executor(context))
        try:
            yield graph
        finally:
            for node in graph.nodes:
                graph.executor.remove_node(node)
                node.destroy_node()
            graph.executor.shutdown()
            rclpy.try_shutdown(context=context)


class Sensors:
    """Publishers of IMU streams, in stamp order, as fast as the subscriber takes them."""

    def __init__(self, graph: Graph, names: tuple[str, ...], streams: tuple[ImuStream, ...] | None = None) -> None:
        self.graph = graph
        self.node = graph.node("sensors")
        chosen = [stream for stream in streams or noisy_streams() if stream.sensor in names]
        self.outputs = {s.sensor: self.node.create_publisher(Imu, topics.INPUT[s.sensor], DEEP) for s in chosen}
        self._queue = sorted(
            (
                (int(stamp), stream.sensor, bytes(message))
                for stream in chosen
                for stamp, message in zip(
                    stream.stamps_ns,
                    encode_imu(stream.stamps_ns, stream.accel_mps2, stream.gyro_radps, "imu"),
                    strict=True,
                )
            ),
            key=lambda item: item[0],
        )

    def leave_out(self, count: int) -> None:
        """Skip the next messages: they are never sent."""
        self._queue = self._queue[count:]

    def matched(self) -> bool:
        """Whether every publisher has a subscriber."""
        return all(output.get_subscription_count() > 0 for output in self.outputs.values())

    def send(self, count: int | None = None, only: tuple[str, ...] | None = None, spinning: bool = True) -> int:
        """Publish the next messages (all of them without a count), spinning in between or not; returns how many."""
        batch, self._queue = (self._queue[:count], self._queue[count:]) if count else (self._queue, [])
        sent = 0
        for number, (_, sensor, message) in enumerate(batch):
            if only is None or sensor in only:
                self.outputs[sensor].publish(message)
                sent += 1
            if spinning and number % 100 == 99:
                for _ in range(100):
                    self.graph.executor.spin_once(timeout_sec=0.0)
        return sent


@contextmanager
def child(graph: Graph, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """One of our commands as a process of its own, in the graph's domain; ended by Ctrl-C at the latest."""
    environment = os.environ | {"ROS_DOMAIN_ID": str(graph.context.get_domain_id())}
    process = subprocess.Popen(
        [sys.executable, "-m", "biodyn_ros.commands.cli", *arguments],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
