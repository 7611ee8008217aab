"""The other processes of the live benchmark: `python -m bench.graph publisher|subscriber|minimal|blocks ARGUMENT...`.

publisher TOPICS RATE SECONDS FILE, subscriber TOPICS FILE, minimal and blocks; TOPICS is one of `KINDS`.
All of them use serialized messages, so that their cost is small compared with that of the node.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import itertools
import json
import struct
import sys
import time
from array import array
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.base.segments import N_SEGMENTS, SEAT, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.model import MOTION_COLUMNS
from biodyn_core.pipeline.frames import PredictedFrames
from biodyn_ros.bag.blocks import BlockEncoder, measured_blocks, predicted_blocks
from biodyn_ros.bag.cdr import AccelStampedTemplate, decode_imu, encode_imu
from biodyn_ros.base import topics
from biodyn_ros.node.live import DRAIN_RATE_HZ
from biodyn_ros.node.publications import BLOCK_DEPTH
from biodyn_ros.node.settings import LiveSettings
from biodyn_ros.node.subscriptions import queued

REST_S = 1.5
START_TIMEOUT_S = 180.0  # without a cache the node compiles every kernel before it subscribes
FLUSH_S = 5.0
STAMP = struct.Struct("<iI")


def _qos(depth: int, reliable: bool) -> QoSProfile:
    kind = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=kind)


SINGLE = {f"predicted/{name}": topics.absolute(topic) for name, topic in topics.PREDICTED.items()}
PREDICTED_BLOCK = {"predicted/block": topics.absolute(topics.PREDICTED_BLOCK)}
MEASURED_BLOCK = {"measured/block": topics.absolute(topics.MEASURED_BLOCK)}
KINDS = {"single": SINGLE, "block": PREDICTED_BLOCK, "blocks": PREDICTED_BLOCK | MEASURED_BLOCK, "none": {}}
"""The topics that are subscribed to: six of single samples, blocks of predictions, those of measurements too, none."""

BLOCKS = {"predicted/block": predicted_blocks(True), "measured/block": measured_blocks()}


# --- publisher -------------------------------------------------------------------------------------------------------


def publisher(kind: str, rate_hz: float, seconds: float, path: Path) -> None:
    """Publish six Imu topics at one rate; save the stamp, the time of sending and the delay of every tick."""
    node = Node("bench_publisher")
    outputs = [node.create_publisher(Imu, topics.INPUT[sensor], _qos(2000, reliable=True)) for sensor in SENSORS]
    rest, motion = _tails(rate_hz)
    _wait(node, outputs, KINDS[kind].values())
    print("streaming", flush=True)
    sent = _stream(outputs, rest, motion, 1e9 / rate_hz, round(seconds * rate_hz))
    for output in outputs:
        output.wait_for_all_acked(Duration(seconds=FLUSH_S))
    np.savez(path, **sent)
    node.destroy_node()


def _stream(outputs: list[Any], rest: list[bytes], motion: list[list[bytes]], period_ns: float, ticks: int) -> Any:
    """Send all six sensors at every tick: stamps, times of sending of the seat's message, and delays, ns."""
    stamps_ns, sent_ns, late_ns = array("q"), array("q"), array("q")
    resting = round(REST_S * 1e9 / period_ns)
    begin_ns, wall_ns = time.monotonic_ns(), time.time_ns()
    for tick in range(ticks):
        at_ns = round(tick * period_ns)
        wait_ns = begin_ns + at_ns - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(1e-9 * wait_ns)
        late_ns.append(time.monotonic_ns() - begin_ns - at_ns)
        # An even clock: a delay of the publisher by the machine must not appear as a jump of the clock.
        stamp = b"\0\1\0\0" + STAMP.pack(*divmod(wall_ns + at_ns, 10**9))
        stamps_ns.append(wall_ns + at_ns)
        sent_ns.append(time.time_ns())
        for output, tail in zip(
            outputs, rest if tick < resting else motion[(tick - resting) % len(motion)], strict=True
        ):
            output.publish(stamp + tail)
    return {"stamps_ns": np.array(stamps_ns), "sent_ns": np.array(sent_ns), "late_ns": np.array(late_ns)}


def _tails(rate_hz: float) -> tuple[list[bytes], list[list[bytes]]]:
    """The bytes after the stamp in each sensor's message: at rest, and for every sample of a periodic motion."""
    t = np.arange(round(rate_hz)) / round(rate_hz)
    # Whole cycles per second, so that the motion is periodic; 3 m/s^2 in total, as on a rough road.
    up = 1.5 * np.sin(2 * np.pi * 2 * t) + np.sin(2 * np.pi * 5 * t) + 0.5 * np.sin(2 * np.pi * 13 * t)
    accel = np.column_stack([0.3 * up, 0.2 * up, STANDARD_GRAVITY_MPS2 + up])
    still = np.array([[0.0, 0.0, STANDARD_GRAVITY_MPS2]])
    moving = [_tails_of(sensor, accel) for sensor in SENSORS]
    return [_tails_of(sensor, still)[0] for sensor in SENSORS], [list(each) for each in zip(*moving, strict=True)]


def _tails_of(sensor: str, accel: Any) -> list[bytes]:
    messages = encode_imu(np.zeros(len(accel), dtype=np.int64), accel, np.zeros_like(accel), f"imu_{sensor}")
    return [message[12:].tobytes() for message in messages]


def _wait(node: Node, outputs: list[Any], answers: Collection[str]) -> None:
    """Wait until the node subscribes to every sensor, its answers have subscribers, and discovery is complete."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while not all([output.get_subscription_count() for output in outputs] + [*map(node.count_subscribers, answers)]):
        if time.monotonic() > deadline:
            raise SystemExit("bench: the publisher has no subscriber")
        time.sleep(0.05)
    time.sleep(1.0)


# --- subscriber ------------------------------------------------------------------------------------------------------


def subscriber(kind: str, path: Path) -> None:
    """Store every response with its time of arrival until SIGINT, then save them with the last diagnostics."""
    node, outputs = Node("bench_subscriber"), KINDS[kind]
    got = {name: _Answers(BLOCKS.get(name)) for name in outputs}
    statuses: dict[str, dict[str, str]] = {}
    for name, topic in outputs.items():
        message = JointTrajectory if name in BLOCKS else AccelStamped
        node.create_subscription(message, topic, got[name].keep, _qos(50_000, reliable=True), raw=True)
    node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, functools.partial(_note, statuses), 10)
    _spin(node)
    arrays = {f"{name}/arrived_ns": np.array(answers.arrived_ns) for name, answers in got.items()}
    arrays |= {f"{name}/stamps_ns": np.array(answers.stamps_ns) for name, answers in got.items()}
    np.savez(path, diagnostics=json.dumps(statuses), **arrays)
    node.destroy_node()


class _Answers:
    """Stamps and arrival times of responses, compact enough for hours."""

    def __init__(self, blocks: BlockEncoder[Any] | None) -> None:
        self._blocks = blocks
        self.arrived_ns, self.stamps_ns = array("q"), array("q")

    def keep(self, message: bytes) -> None:
        """Store one response, or those of a block."""
        now_ns = time.time_ns()
        if self._blocks is None:
            seconds, nanoseconds = STAMP.unpack_from(message, 4)
            stamps_ns = [seconds * 10**9 + nanoseconds]
        else:
            stamps_ns = self._blocks.times_ns(message).tolist()
        self.stamps_ns.extend(stamps_ns)
        self.arrived_ns.extend([now_ns] * len(stamps_ns))


def _note(statuses: dict[str, dict[str, str]], message: DiagnosticArray) -> None:
    for status in message.status:
        statuses[status.name] = {item.key: item.value for item in status.values}


# --- the baselines ---------------------------------------------------------------------------------------------------


class _Minimal(Node):
    """The live node without computation: six topics of single samples in and out, through the same executor."""

    def __init__(self) -> None:
        super().__init__("biodyn")
        outputs = {
            name: (self.create_publisher(AccelStamped, topic, _qos(2000, reliable=True)), _around(name))
            for name, topic in SINGLE.items()
        }
        for sensor in SENSORS:
            callback = functools.partial(self._answer, list(outputs.values()) if sensor == SEAT else [])
            self.create_subscription(Imu, topics.INPUT[sensor], callback, _qos(2000, reliable=False), raw=True)

    def _answer(self, outputs: list[tuple[Any, tuple[bytes, bytes]]], message: bytes) -> None:
        """Publish with the stamp of the message, as the live node does for the seat."""
        for output, (before, after) in outputs:
            output.publish(before + message[4:12] + after)


class _Blocks(Node):
    """The live node without computation, in blocks: queues read by timers, the stamps of the seat sent in blocks."""

    def __init__(self) -> None:
        super().__init__("biodyn")
        self._queues = {
            sensor: self.create_subscription(Imu, topics.INPUT[sensor], _ignore, _qos(2000, reliable=False), raw=True)
            for sensor in SENSORS
        }
        self._output = self.create_publisher(
            JointTrajectory, topics.absolute(topics.PREDICTED_BLOCK), _qos(BLOCK_DEPTH, reliable=True)
        )
        self._next_drained = itertools.cycle(sensor for sensor in SENSORS if sensor != SEAT)
        self.create_timer(1e-3 * LiveSettings.block_ms, _until_shutdown(self._answer))
        self.create_timer(1.0 / DRAIN_RATE_HZ, _until_shutdown(lambda: queued(self._queues[next(self._next_drained)])))

    @property
    def subscriptions(self) -> Iterator[Any]:
        """None for the executor."""
        return iter(())

    def _answer(self) -> None:
        """Send a block with the stamps of the seat's messages that have arrived."""
        if messages := queued(self._queues[SEAT]):
            stamps_ns = decode_imu([message for message, _ in messages]).stamps_ns
            numbers = (np.zeros((stamps_ns.size, columns)) for columns in (N_SEGMENTS, MOTION_COLUMNS))
            for _, block in BLOCKS["predicted/block"].blocks(PredictedFrames(stamps_ns, *numbers)):
                self._output.publish(block)


def _until_shutdown(callback: Callable[[], object]) -> Callable[[], None]:
    """A callback that may run while a signal ends the context."""

    def run() -> None:
        with contextlib.suppress(RCLError):
            callback()

    return run


def _ignore(message: bytes) -> None:
    """The callback of a subscription that the executor does not serve."""


def _around(name: str) -> tuple[bytes, bytes]:
    """The bytes of a response before and after its stamp."""
    message = AccelStampedTemplate(name.partition("/")[2]).fill(0, 0.0)
    return message[:4], message[12:]


def _spin(node: Node) -> None:
    """Spin until SIGINT, with the loop of the targets; EventsExecutor's own `spin` busy-loops in rclpy 7.1."""
    executor = EventsExecutor()
    executor.add_node(node)
    # A signal may end the context between the check and the spin.
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException, RCLError):
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.1)


def main(role: str, *arguments: str) -> None:
    """Run one process until its end."""
    rclpy.init(args=[])
    # Garbage collection over the stored data would appear as latency of the node.
    gc.disable()
    if role == "publisher":
        kind, rate_hz, seconds, path = arguments
        publisher(kind, float(rate_hz), float(seconds), Path(path))
    elif role == "subscriber":
        subscriber(arguments[0], Path(arguments[1]))
    else:
        node = _Blocks() if role == "blocks" else _Minimal()
        _spin(node)
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
