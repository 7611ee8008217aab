"""Publications: arrays and figures become messages; samples are serialised only for topics with subscribers.

Samples leave one by one on six topics, and in blocks on one. A block costs about as much as one sample.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, Final, Generic

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import AccelStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Float64, String
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.pipeline.frames import Frames, MeasuredFrames, PredictedFrames
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag.blocks import AnyFrames, BlockEncoder, measured_blocks, predicted_blocks
from biodyn_ros.bag.cdr import AccelStampedTemplate
from biodyn_ros.base import topics
from biodyn_ros.node.health import Mark, Status, seat_fault, silences_s
from biodyn_ros.node.sending_budget import SendingBudget

OUTPUT_DEPTH: Final = 2000
BLOCK_DEPTH: Final = 400
"""Two seconds of blocks of 5 ms."""

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


class BlockTopic(Generic[AnyFrames]):
    """A topic of blocks: `add` frames, `publish` all that were added since, while somebody subscribes."""

    def __init__(self, node: LifecycleNode, topic: str, encoder: BlockEncoder[AnyFrames]) -> None:
        self.publisher = node.create_publisher(
            JointTrajectory, topic, _reliable(BLOCK_DEPTH),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )  # fmt: skip
        self._encoder = encoder
        self.is_wanted = False
        self._waiting: list[AnyFrames] = []

    def update_subscribers(self) -> None:
        """From now on collect frames only if the topic has subscribers."""
        self.is_wanted = self.publisher.get_subscription_count() > 0
        if not self.is_wanted:
            self._waiting = []

    def add(self, frames: AnyFrames) -> None:
        """Add frames; they must not be written to afterwards."""
        if self.is_wanted and frames.stamps_ns.size:
            self._waiting.append(frames)

    def publish(self) -> None:
        """Send the frames that were added."""
        if not self._waiting:
            return
        frames, *others = self._waiting
        self._waiting = []
        if others:
            frames = type(frames)(*map(np.concatenate, zip(frames, *others, strict=True)))
        for _, message in self._encoder.blocks(frames):
            self.publisher.publish(message)


def _reliable(depth: int = OUTPUT_DEPTH) -> QoSProfile:
    """A profile for one publisher: rclpy writes overrides into the given profile."""
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE)


class Publications:
    """Everything that the node publishes, from configuration to clean-up; budget: of the topics of single samples."""

    def __init__(self, node: LifecycleNode, with_measured: bool, with_forces: bool) -> None:
        self._node = node
        self.budget = SendingBudget()
        self._predicted, self._measured = AccelTopics(node, topics.PREDICTED), AccelTopics(node, topics.MEASURED)
        self._predicted_block = BlockTopic(node, topics.PREDICTED_BLOCK, predicted_blocks(with_forces))
        self._measured_block = BlockTopic(node, topics.MEASURED_BLOCK, measured_blocks())
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
        """Whether a topic of samples or blocks has subscribers."""
        return any(
            one.is_wanted for one in (self._predicted, self._predicted_block, self._measured, self._measured_block)
        )

    def frames(self, frames: Frames) -> None:
        """Publish accelerations of the model and, if configured, of the sensors; blocks wait for `blocks`."""
        self._samples(frames)
        self._predicted_block.add(frames.predicted)
        self._measured_block.add(frames.measured)

    def _samples(self, frames: Frames) -> None:
        """Publish single samples, unless sending them takes much longer than the motion lasts."""
        if not (self._predicted.is_wanted or self._measured.is_wanted):
            self.budget.end_pause()
        elif self.budget.allows(frames.predicted.stamps_ns.size):
            before_s = time.monotonic()
            self._predicted.publish(frames.predicted)
            self._measured.publish(frames.measured)
            self.budget.spend(time.monotonic() - before_s, frames.predicted.stamps_ns)

    def blocks(self) -> None:
        """Publish the blocks."""
        self._predicted_block.publish()
        self._measured_block.publish()

    def exposure(self, pipeline: Pipeline, statuses: Sequence[Status]) -> None:
        """Publish the figures since reset and of the window, to the topics with subscribers.

        statuses: the latest of the diagnostics.
        """
        wanted = [topic for topic, publisher in self._scalars.items() if publisher.get_subscription_count() > 0]
        if not wanted:
            return
        by_name = {status.of: status for status in statuses}
        seat_at_fault = bool(by_name) and bool(seat_fault(by_name))
        values = topics.scalar_values(pipeline, silences_s(by_name), seat_at_fault)
        for topic in wanted:
            if topic in values:
                self._scalars[topic].publish(Float64(data=values[topic]))

    def diagnostics(self, statuses: Sequence[Status]) -> None:
        """Publish the statuses."""
        message = DiagnosticArray(status=[_diagnostic(self._node, status) for status in statuses])
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


def _diagnostic(node: LifecycleNode, status: Status) -> DiagnosticStatus:
    """A status under the full name of its node, because viewers distinguish statuses by name."""
    full_name = node.get_fully_qualified_name().lstrip("/")
    values = [KeyValue(key=key, value=value) for key, value in status.values.items()]
    return DiagnosticStatus(
        level=bytes([status.level]),
        name=topics.status_name(status.of, full_name),
        message=status.message,
        hardware_id=full_name,
        values=values,
    )
