"""How callbacks run: on the cheapest executor there is, and one that raises costs nobody the ride."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future

from biodyn_core.errors import one_line


def make_executor(context: Any = None) -> Any:
    """EventsExecutor where rclpy has it, eight times cheaper a message; never the multi-threaded one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Any, until: Callable[[], bool]) -> None:
    """Spin a tenth of a second at a time, waiting for what never comes, until then or until SIGINT; in the main thread.

    EventsExecutor's own `spin` busy-loops in rclpy 7.1, and its `spin_once` comes back after every single message.
    SIGINT raises nothing meanwhile: what it would interrupt is a callback, and rclpy would tell of a failed one.
    """
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: asked.append(number))
    try:
        while not (asked or until()):
            try:
                executor.spin_until_future_complete(Future(), timeout_sec=0.1)
            except RCLError:
                if not until():  # a signal may end the context between the question and the spin
                    raise
    finally:
        signal.signal(signal.SIGINT, before)


def guarded(callback: Callable[..., None], tell: Callable[[str], None]) -> Callable[..., None]:
    """A callback that raises is told of and survived: rclpy swallows what it raises, EventsExecutor ends its loop."""

    def survived(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception as error:  # noqa: BLE001 - a node that judges exposure survives a bad message
            tell(one_line(error))

    return survived
