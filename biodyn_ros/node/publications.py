"""Publications: arrays and figures become messages; samples are serialised only for topics with subscribers.

Samples leave one by one on six topics, and in blocks on one. A block costs about as much as one sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Generic, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import AccelStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.body.model import parts_of_motion
from biodyn_core.pipeline.frames import Frames, MeasuredFrames, PredictedFrames
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag.cdr import AccelStampedTemplate
from biodyn_ros.bag.trajectories import SEQUENCES, TrajectoryTemplate
from biodyn_ros.base import topics
from biodyn_ros.node.health import Mark, Status

OUTPUT_DEPTH: Final = 2000
BLOCK_DEPTH: Final = 400
"""Two seconds of blocks of 5 ms."""

LONGEST_BLOCK: Final = 256
"""Most samples of one message; after a stall there are more than one block of them."""

SCALAR_DEPTH: Final = 10


class AccelTopics:
    """The AccelStamped topics of one kind, one for each column of its frames."""

    def __init__(self, node: LifecycleNode, names: dict[str, str]) -> None:
        overrides = QoSOverridingOptions.with_default_policies()
        self.publishers = [
            node.create_publisher(AccelStamped, topic, _reliable(), qos_overriding_options=overrides)
            for topic in names.values()
        ]
        self._fills = [AccelStampedTemplate(frame_id=name).fill for name in names]
        self._wanted: list[tuple[int, Any, Any]] = []

    def update_subscribers(self) -> None:
        """From now on send only the columns whose topics have subscribers."""
        outputs = enumerate(zip(self.publishers, self._fills, strict=True))
        self._wanted = [
            (column, publisher.publish, fill)
            for column, (publisher, fill) in outputs
            if publisher.get_subscription_count() > 0
        ]

    @property
    def is_wanted(self) -> bool:
        """Whether a topic has subscribers."""
        return bool(self._wanted)

    def publish(self, frames: PredictedFrames | MeasuredFrames) -> None:
        """Send every value that is not NaN."""
        if self._wanted and frames.stamps_ns.size:
            for stamp_ns, row in zip(frames.stamps_ns.tolist(), frames.accel_mps2.tolist(), strict=True):
                for column, publish, fill in self._wanted:
                    value = row[column]
                    if not math.isnan(value):
                        publish(fill(stamp_ns, value))


AnyFrames = TypeVar("AnyFrames", PredictedFrames, MeasuredFrames)


class BlockTopic(Generic[AnyFrames]):
    """A topic of blocks: `add` frames, `publish` all that were added since, while somebody subscribes.

    numbers: the sequences of a message, (n, names) by name, of some frames.
    """

    def __init__(
        self, node: LifecycleNode, topic: str, names: Sequence[str], sequences: Sequence[str],
        numbers: Callable[[AnyFrames], dict[str, Floats]],
    ) -> None:  # fmt: skip
        self.publisher = node.create_publisher(
            JointTrajectory, topic, _reliable(BLOCK_DEPTH),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )  # fmt: skip
        self._template, self._numbers = TrajectoryTemplate(SEAT, names, sequences), numbers
        self._is_wanted = False
        self._waiting: list[AnyFrames] = []

    def update_subscribers(self) -> None:
        """From now on collect frames only if the topic has subscribers."""
        self._is_wanted = self.publisher.get_subscription_count() > 0
        if not self._is_wanted:
            self._waiting = []

    def add(self, frames: AnyFrames) -> None:
        """Add frames; they must not be written to afterwards."""
        if self._is_wanted and frames.stamps_ns.size:
            self._waiting.append(frames)

    def publish(self) -> None:
        """Send the frames that were added, without instants at which no acceleration is known."""
        if not self._waiting:
            return
        frames, *others = self._waiting
        if others:
            frames = type(frames)(*map(np.concatenate, zip(frames, *others, strict=True)))
        self._waiting = []
        known = ~np.isnan(frames.accel_mps2).all(axis=1)
        stamps_ns, numbers = frames.stamps_ns[known], {key: rows[known] for key, rows in self._numbers(frames).items()}
        for begin in range(0, stamps_ns.size, LONGEST_BLOCK):
            part = slice(begin, begin + LONGEST_BLOCK)
            self.publisher.publish(
                self._template.fill(stamps_ns[part], {key: rows[part] for key, rows in numbers.items()})
            )


def _predicted_numbers(frames: PredictedFrames) -> dict[str, Floats]:
    displacement_m, velocity_mps, force_n = parts_of_motion(frames.motion)
    return {
        "positions": displacement_m, "velocities": velocity_mps, "accelerations": frames.accel_mps2, "effort": force_n
    }  # fmt: skip


def _measured_numbers(frames: MeasuredFrames) -> dict[str, Floats]:
    return {"accelerations": frames.accel_mps2}


def _reliable(depth: int = OUTPUT_DEPTH) -> QoSProfile:
    """A profile for one publisher: rclpy writes overrides into the given profile."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE)


class Publications:
    """Everything that the node publishes, from configuration to clean-up."""

    def __init__(self, node: LifecycleNode, with_measured: bool, with_forces: bool) -> None:
        self._node = node
        self._predicted, self._measured = AccelTopics(node, topics.PREDICTED), AccelTopics(node, topics.MEASURED)
        # Without forces, as under `cascade`, the effort stays empty.
        sequences = SEQUENCES if with_forces else [name for name in SEQUENCES if name != "effort"]
        self._predicted_block = BlockTopic(node, topics.PREDICTED_BLOCK, SEGMENTS, sequences, _predicted_numbers)
        self._measured_block = BlockTopic(node, topics.MEASURED_BLOCK, SENSORS, ["accelerations"], _measured_numbers)
        self._with_measured = with_measured
        self._scalars = {topic: node.create_publisher(Float64, topic, SCALAR_DEPTH) for topic in topics.SCALARS}
        self._diagnostics = node.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, SCALAR_DEPTH)
        self._snapshots = node.create_publisher(String, topics.SNAPSHOT, SCALAR_DEPTH)
        self._marks = node.create_publisher(String, topics.MARKS, SCALAR_DEPTH)

    def close(self) -> None:
        """Destroy every publisher."""
        accel = (*self._predicted.publishers, *self._measured.publishers)
        blocks = (self._predicted_block.publisher, self._measured_block.publisher)
        for publisher in (*accel, *blocks, *self._scalars.values(), self._diagnostics, self._snapshots, self._marks):
            self._node.destroy_publisher(publisher)

    def update_subscribers(self) -> None:
        """Check which topics have subscribers."""
        self._predicted.update_subscribers()
        self._predicted_block.update_subscribers()
        if self._with_measured:
            self._measured.update_subscribers()
            self._measured_block.update_subscribers()

    @property
    def has_sample_subscriber(self) -> bool:
        """Whether a topic of single predictions has subscribers."""
        return self._predicted.is_wanted

    def frames(self, frames: Frames) -> None:
        """Publish accelerations of the model and, if configured, of the sensors; blocks wait for `blocks`."""
        self._predicted.publish(frames.predicted)
        self._measured.publish(frames.measured)
        self._predicted_block.add(frames.predicted)
        self._measured_block.add(frames.measured)

    def blocks(self) -> None:
        """Publish the blocks."""
        self._predicted_block.publish()
        self._measured_block.publish()

    def exposure(self, pipeline: Pipeline) -> None:
        """Publish the figures since reset and of the window."""
        since, rolling = pipeline.exposure(), pipeline.exposure(rolling=True)
        values = topics.exposure_values(since, topics.EXPOSURE) | topics.exposure_values(rolling, topics.ROLLING)
        values |= {topics.RESIDUAL[segment]: rms for segment, (rms, _) in rolling.residual.items()}
        values |= topics.seat_values(pipeline.seat())
        for topic, value in values.items():
            self._scalars[topic].publish(Float64(data=value))

    def diagnostics(self, statuses: Sequence[Status]) -> None:
        """Publish the statuses."""
        message = DiagnosticArray(status=[_diagnostic(status) for status in statuses])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def mark(self, mark: Mark) -> None:
        """Publish the name of a mark at its instant."""
        self._marks.publish(String(data=mark.name))

    @property
    def has_snapshot_subscriber(self) -> bool:
        """Whether the snapshot topic has subscribers."""
        return bool(self._snapshots.get_subscription_count() > 0)

    def snapshot(self, text: str) -> None:
        """Publish the content of the live page."""
        self._snapshots.publish(String(data=text))


def _diagnostic(status: Status) -> DiagnosticStatus:
    values = [KeyValue(key=key, value=value) for key, value in status.values.items()]
    return DiagnosticStatus(
        level=bytes([status.level]),
        name=topics.status_name(status.of),
        message=status.message,
        hardware_id=topics.NODE_NAME,
        values=values,
    )
