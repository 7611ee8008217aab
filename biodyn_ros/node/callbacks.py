"""Callbacks: the fastest executor available, and a guard by which an exception does not stop the node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future

from biodyn_core.base.errors import one_line

SPIN_S: Final = 0.5


def make_executor(context: Any = None) -> Any:
    """EventsExecutor where rclpy has it, eight times cheaper per message; never the multi-threaded one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Any, ended: Future) -> None:
    """Spin until the future is done; any thread may set it.

    EventsExecutor's own `spin` busy-loops in rclpy 7.1, and its `spin_once` returns after every message. Its timeout
    does not run while messages wait: a node slower than its sensors ends by the future alone.
    """
    while not ended.done():
        executor.spin_until_future_complete(ended, timeout_sec=SPIN_S)


def guarded(callback: Callable[..., None], report: Callable[[str], None]) -> Callable[..., None]:
    """Report a callback's exception and go on: rclpy drops it, EventsExecutor ends its loop."""

    def run(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception as error:  # noqa: BLE001 - a bad message must not stop the node
            report(one_line(error))

    return run
