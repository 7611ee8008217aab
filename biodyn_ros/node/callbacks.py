"""How callbacks run: on the cheapest executor there is, and one that raises costs nobody the ride."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future

from biodyn_core.base.errors import one_line

SPIN_S: Final = 0.5


def make_executor(context: Any = None) -> Any:
    """EventsExecutor where rclpy has it, eight times cheaper a message; never the multi-threaded one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Any, ended: Future) -> None:
    """Spin until the future is done, which any thread may do.

    EventsExecutor's own `spin` busy-loops in rclpy 7.1, and its `spin_once` comes back after every single message. Its
    timeout does not count while messages wait: a node that cannot keep up with its sensors ends by the future alone.
    """
    while not ended.done():
        executor.spin_until_future_complete(ended, timeout_sec=SPIN_S)


def guarded(callback: Callable[..., None], tell: Callable[[str], None]) -> Callable[..., None]:
    """A callback that raises is told of and survived: rclpy swallows what it raises, EventsExecutor ends its loop."""

    def survived(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception as error:  # noqa: BLE001 - a node that judges exposure survives a bad message
            tell(one_line(error))

    return survived
