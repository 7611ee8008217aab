"""Parallel map: one function over independent items, by default in this process; the caller chooses the workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class ParallelMap(Protocol):
    """Map a function over items, possibly in other processes."""

    def __call__(
        self, stage: str, function: Callable[[Shared, Item], Result], shared: Shared, items: Sequence[Item]
    ) -> Iterator[Result]:
        """Yield `function(shared, item)` for each item, in order.

        The function is one of a module. shared is sent once to each worker, and again only if another object follows.
        stage: named if a worker dies.
        """


def serial_map(
    stage: str,  # noqa: ARG001 - the protocol has it
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Sequence[Item],
) -> Iterator[Result]:
    """Map in this process; see `ParallelMap`."""
    return (function(shared, item) for item in items)
