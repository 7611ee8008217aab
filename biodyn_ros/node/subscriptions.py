"""Subscriptions: the messages of six topics become arrays, and their transport is recorded by sensor.

Messages wait in the queues of their subscriptions, which the executor does not serve: waking up for each of them costs
more than all that is done with it. The seat's are taken every few milliseconds, as a block. The other sensors, which
only the comparison needs, are drained in turn. If each sample of the seat is requested at once, the executor serves the
seat. After a stall the seat's backlog would overtake the others, so before instants are given up, the messages of all
sensors are pushed in order of stamps.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from rclpy import get_rmw_implementation_identifier
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import HistoryPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.pipeline.interleaving import in_stamp_order
from biodyn_ros.bag.cdr import IMU_TYPE, ImuBlock, decode_imu, decode_imu_one
from biodyn_ros.base import topics
from biodyn_ros.node.callbacks import guarded
from biodyn_ros.node.health import SensorHealth

Push = Callable[[str, Integers, Floats], None]
"""Called with a sensor's name, stamps (n,) ns and specific force (n, 3) m/s^2."""

NUMBERING: Final = "rmw_fastrtps"
"""Its sequence numbers show losses. Its event for lost messages can deadlock the node: in Jazzy `take_event` and
`update_sample_lost` take two locks in opposite order (ros2/rmw_fastrtps, pull request 890).
"""

MAX_SINGLE: Final = 100
"""After so many single messages of the seat all queues are read: only they give sequence numbers, hence losses.

A block of more is a backlog.
"""

PUSH_ORDER: Final = (*(sensor for sensor in SENSORS if sensor != SEAT), SEAT)
"""Order of samples of the same time: the seat's are compared with the others'."""


class Subscriptions:
    """`open` on activation, `close` on deactivation.

    Meanwhile call `take_seat`, `drain` and `check_transport` periodically, and let the executor serve all subscriptions
    but `drained`. overdue: whether the seat's next sample gives up instants. singly: whether the executor serves the
    seat, each sample at once, instead of `take_seat`. health: state of the transport by sensor; like the figures it
    survives `close`.
    """

    def __init__(
        self, node: LifecycleNode, depth: int, window_s: float, push: Push, overdue: Callable[[], bool], singly: bool
    ) -> None:
        self._singly = singly
        self._node, self._depth, self._window_s, self._push, self._overdue = node, depth, window_s, push, overdue
        self.health = {sensor: SensorHealth() for sensor in SENSORS}
        self._subscriptions: dict[str, Any] = {}
        self._single = 0
        self._notes_seat = False
        self._gids: dict[str, list[bytes]] = {}
        self._are_numbered = get_rmw_implementation_identifier().startswith(NUMBERING)
        self._next_drained = itertools.cycle(SENSORS)
        self._next_compared = itertools.cycle(SENSORS)

    def open(self) -> None:
        """Subscribe to the six topics; what was sent while none was open is not lost."""
        for health in self.health.values():
            health.forget_numbers()
        # The seat first: its samples while other topics are matched must not be lost.
        for sensor in SENSORS:
            # An executor that serves all subscriptions loses time, and nothing else.
            callback = self._on_seat if sensor == SEAT else partial(self._on_message, sensor)
            self._subscriptions[sensor] = self._subscribe(sensor, guarded(callback, partial(self._refuse, sensor)))

    def close(self) -> None:
        """Unsubscribe."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions = {}

    @property
    def drained(self) -> list[Any]:
        """The subscriptions that the executor must leave alone."""
        return [one for sensor, one in self._subscriptions.items() if not (self._singly and sensor == SEAT)]

    def take_seat(self) -> None:
        """Push the seat's messages as one block."""
        if not (messages := self._arrived(SEAT)):
            return
        if len(messages) > MAX_SINGLE or self._overdue():
            self._push_all(messages)
        else:
            guarded(self._on_seat_block, partial(self._refuse, SEAT))(messages)

    def drain(self) -> None:
        """Push the next sensor's messages; of the seat, which is taken elsewhere, note the next arrival alone."""
        sensor = next(self._next_drained)
        if sensor == SEAT:
            self._notes_seat = True
        elif taken := self._arrived(sensor):
            guarded(self._on_messages, partial(self._refuse, sensor))(sensor, taken)

    def take_all(self) -> None:
        """Push all messages that have arrived."""
        if self._subscriptions:
            self._push_all(self._arrived(SEAT))

    def check_transport(self) -> None:
        """Check the publishers, and one of the six clocks, which takes a millisecond or two.

        The event for a wrong message type does not fire across processes, so publishers are polled.
        """
        self.health[next(self._next_compared)].compare_clock()
        for sensor, health in self.health.items():
            self._check_publishers(sensor, health)

    # --- messages ----------------------------------------------------------------------------------------------------

    def _subscribe(self, sensor: str, callback: Callable[[bytes], None]) -> Any:
        # A profile for each: rclpy writes overrides into the given profile.
        qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=self._depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        return self._node.create_subscription(
            Imu,
            topics.INPUT[sensor],
            callback,
            qos,
            raw=True,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=None if self._are_numbered else partial(self._on_lost, sensor),
                incompatible_qos=partial(self._on_incompatible_qos, sensor),
            ),
        )

    def _on_seat(self, message: bytes) -> None:
        self._single += 1
        if self._single >= MAX_SINGLE or self._overdue():
            self._single = 0
            self._push_all(self._arrived(SEAT, [message]))
            return
        self.health[SEAT].arrived()  # a message that is refused has arrived too: otherwise it would count as lost
        stamp_ns, accel_mps2 = decode_imu_one(message)
        self._push(SEAT, np.array([stamp_ns]), np.array([accel_mps2]))
        self._note_seat(stamp_ns)

    def _on_seat_block(self, messages: list[bytes]) -> None:
        block = self._decoded(SEAT, messages)
        if len(block):
            self._push(SEAT, block.stamps_ns, block.accel_mps2)
            self._note_seat(int(block.stamps_ns[-1]))

    def _on_message(self, sensor: str, message: bytes) -> None:
        self._on_messages(sensor, [message])

    def _on_messages(self, sensor: str, messages: list[bytes]) -> None:
        block = self._decoded(sensor, messages)
        if len(block):
            self._push(sensor, block.stamps_ns, block.accel_mps2)
            self._note_arrival(sensor, int(block.stamps_ns[-1]))

    def _push_all(self, of_seat: list[bytes]) -> None:
        """Push the messages that have arrived of all sensors in order of stamps; the seat's are given."""
        messages = {sensor: of_seat if sensor == SEAT else self._arrived(sensor) for sensor in PUSH_ORDER}
        blocks = {sensor: self._decoded(sensor, given) for sensor, given in messages.items()}
        for sensor, part in in_stamp_order({sensor: block.stamps_ns for sensor, block in blocks.items()}):
            push, block = guarded(self._push, partial(self._refuse, sensor)), blocks[sensor]
            push(sensor, block.stamps_ns[part], block.accel_mps2[part])
        for sensor, block in blocks.items():
            if len(block):
                self._note_arrival(sensor, int(block.stamps_ns[-1]))

    def _arrived(self, sensor: str, before: Sequence[bytes] = ()) -> list[bytes]:
        """Take a sensor's messages: the given ones, and those that wait in its queue.

        Only the queue gives sequence numbers: the executor calls back without them.
        """
        waiting = queued(self._subscriptions[sensor])
        messages = [*before, *(message for message, _ in waiting)]
        health = self.health[sensor]
        if waiting and self._are_numbered and health.publishers == 1:
            health.numbered(waiting[-1][1]["publication_sequence_number"], health.messages + len(messages))
        return messages

    def _decoded(self, sensor: str, messages: list[bytes]) -> ImuBlock:
        if messages:
            self.health[sensor].arrived(len(messages))
        try:
            return decode_imu(messages)
        except InputError:
            return decode_imu([message for message in messages if self._is_readable(sensor, message)])

    def _is_readable(self, sensor: str, message: bytes) -> bool:
        """Whether a message can be decoded; count one that cannot."""
        try:
            decode_imu_one(message)
        except InputError as error:
            self._refuse(sensor, str(error))
            return False
        return True

    def _refuse(self, sensor: str, why: str) -> None:
        self.health[sensor].refused(why)
        self._node.get_logger().error(f"{sensor}: {why}", throttle_duration_sec=1.0)

    def _note_seat(self, stamp_ns: int) -> None:
        """Note an arrival of the seat as often as those of the others."""
        if self._notes_seat:
            self._notes_seat = False
            self._note_arrival(SEAT, stamp_ns)

    def _note_arrival(self, sensor: str, stamp_ns: int) -> None:
        self.health[sensor].timed(stamp_ns, self._node.get_clock().now().nanoseconds, self._window_s)

    # --- transport ---------------------------------------------------------------------------------------------------

    def _on_lost(self, sensor: str, event: Any) -> None:
        self.health[sensor].lost += event.total_count_change

    def _on_incompatible_qos(self, sensor: str, event: Any) -> None:
        text = f"{self._topic(sensor)}: a publisher offers incompatible QoS, override its QoS or this node's"
        self.health[sensor].incompatible_qos = text
        self._node.get_logger().error(text)

    def _check_publishers(self, sensor: str, health: SensorHealth) -> None:
        # rclpy remaps the name itself: given the remapped one, it would look at a swapped topic.
        found = self._node.get_publishers_info_by_topic(topics.INPUT[sensor])
        wrong = [info.topic_type for info in found if info.topic_type != IMU_TYPE]
        text = f"{self._topic(sensor)}: a publisher sends {wrong[0]}, {IMU_TYPE} is needed" if wrong else ""
        if text and text != health.wrong_type:
            self._node.get_logger().error(text)
        gids = [bytes(info.endpoint_gid) for info in found]
        if gids != self._gids.get(sensor):
            self._gids[sensor] = gids
            health.forget_numbers()
        health.publishers, health.wrong_type = len(found), text
        if all(self._is_compatible(sensor, info) for info in found if info.topic_type == IMU_TYPE):
            health.incompatible_qos = ""  # that publisher has gone

    def _is_compatible(self, sensor: str, publisher: Any) -> bool:
        """Whether a publisher's QoS is compatible with the subscription's, as far as both are known."""
        ours = self._subscriptions[sensor].qos_profile
        return qos_check_compatible(publisher.qos_profile, ours)[0] != QoSCompatibility.ERROR

    def _topic(self, sensor: str) -> str:
        return self._node.resolve_topic_name(topics.INPUT[sensor])


def queued(subscription: Any) -> list[tuple[bytes, Any]]:
    """Take the messages that wait in a raw subscription's queue, with rclpy's information on their transport.

    The executor then finds the queue empty.
    """
    waiting: list[tuple[bytes, Any]] = []
    with subscription.handle:
        # A publisher may send as fast as this takes. A depth of 0 is that of the middleware.
        for _ in range(max(1, subscription.qos_profile.depth)):
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if taken is None:
                break
            waiting.append(taken)
    return waiting
