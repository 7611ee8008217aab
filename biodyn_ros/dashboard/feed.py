"""The connection to the node: subscribes to snapshots and calls reset and mark, in its own thread."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable
from typing import Any, Final

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from biodyn_core.base.errors import InputError
from biodyn_ros.base import topics
from biodyn_ros.base.wording import typeset

TIMEOUT_S: Final = 3.0

SERVICES: Final = {"reset": topics.RESET, "mark": topics.MARK}


class Feed:
    """Subscribes to the snapshots of a node by its full name; `on_snapshot` gets each in the loop's thread."""

    def __init__(self, node: str, on_snapshot: Callable[[str], None], loop: asyncio.AbstractEventLoop) -> None:
        self.node = node
        self._loop = loop
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        try:
            self._node = Node(f"biodyn_page_{os.getpid()}", context=self._context, enable_rosout=False)
            qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=4, reliability=ReliabilityPolicy.RELIABLE)
            self._node.create_subscription(
                String,
                topics.absolute(topics.SNAPSHOT, node.lstrip("/")),
                lambda message: loop.call_soon_threadsafe(on_snapshot, typeset(message.data)),
                qos,
            )
            self._clients = {
                name: self._node.create_client(Trigger, topics.absolute(service, node.lstrip("/")))
                for name, service in SERVICES.items()
            }
        except (rclpy.exceptions.InvalidTopicNameException, rclpy.exceptions.InvalidServiceNameException) as error:
            self._context.try_shutdown()
            why = str(error).splitlines()[0]
            raise InputError(f"--node {node!r}: not a valid node name ({why})") from None
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="biodyn page", daemon=True)
        self._thread.start()

    async def call(self, name: str) -> str:
        """Call reset or mark of the node and return its message; raises TimeoutError without a response."""
        client = self._clients[name]
        if not client.service_is_ready():
            raise TimeoutError(f"the node {self.node} is not available to {name}")
        response: asyncio.Future[Any] = self._loop.create_future()

        def done(future: Any) -> None:
            self._loop.call_soon_threadsafe(lambda: None if response.done() else response.set_result(future.result()))

        client.call_async(Trigger.Request()).add_done_callback(done)
        try:
            return str((await asyncio.wait_for(response, TIMEOUT_S)).message)
        except asyncio.TimeoutError:
            raise TimeoutError(f"{self.node} did not respond within {TIMEOUT_S:g} s") from None

    def close(self) -> None:
        """Leave the ROS graph."""
        self._context.try_shutdown()
        self._thread.join(TIMEOUT_S)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        finally:
            self._executor.shutdown()
            self._node.destroy_node()
