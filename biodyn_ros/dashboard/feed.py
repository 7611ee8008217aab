"""From ROS to the page and back: snapshots in, reset and mark out, on a thread of its own."""

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

ANSWERS_WITHIN_S: Final = 3.0

SERVICES: Final = {"reset": topics.RESET, "mark": topics.MARK}


class Feed:
    """Hears the snapshots of a node by its full name; `take` is called in the loop's thread with each."""

    def __init__(self, node: str, take: Callable[[str], None], loop: asyncio.AbstractEventLoop) -> None:
        self.node = node
        self._loop = loop
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        try:
            self._ours = Node(f"biodyn_page_{os.getpid()}", context=self._context, enable_rosout=False)
            qos = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=4, reliability=ReliabilityPolicy.RELIABLE)
            self._ours.create_subscription(
                String,
                topics.absolute(topics.SNAPSHOT, node.lstrip("/")),
                lambda message: loop.call_soon_threadsafe(take, typeset(message.data)),
                qos,
            )
            self._clients = {
                name: self._ours.create_client(Trigger, topics.absolute(service, node.lstrip("/")))
                for name, service in SERVICES.items()
            }
        except (rclpy.exceptions.InvalidTopicNameException, rclpy.exceptions.InvalidServiceNameException) as error:
            self._context.try_shutdown()
            why = str(error).splitlines()[0]
            raise InputError(f"--node {node!r}: is no name of a node ({why})") from None
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._ours)
        self._thread = threading.Thread(target=self._spin, name="biodyn page", daemon=True)
        self._thread.start()

    async def ask(self, name: str) -> str:
        """Have the node reset or mark, and return what it says; raises TimeoutError where it does not answer."""
        client = self._clients[name]
        if not client.service_is_ready():
            raise TimeoutError(f"no node {self.node} is there to {name}")
        answer: asyncio.Future[Any] = self._loop.create_future()

        def answered(future: Any) -> None:
            self._loop.call_soon_threadsafe(lambda: None if answer.done() else answer.set_result(future.result()))

        client.call_async(Trigger.Request()).add_done_callback(answered)
        try:
            said = await asyncio.wait_for(answer, ANSWERS_WITHIN_S)
        except asyncio.TimeoutError:
            raise TimeoutError(f"{self.node} did not answer within {ANSWERS_WITHIN_S:g} s") from None
        return str(said.message)

    def close(self) -> None:
        """Leave the graph."""
        self._context.try_shutdown()
        self._thread.join(ANSWERS_WITHIN_S)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            pass
        finally:
            self._executor.shutdown()
            self._ours.destroy_node()
