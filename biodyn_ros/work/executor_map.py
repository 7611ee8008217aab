"""Executor map: the parallel map of an executor, which sends a shared value once to each worker."""

from __future__ import annotations

import pickle
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from biodyn_core.base.parallel import Item, ParallelMap, Result, Shared, serial_map
from biodyn_ros.work.executors import Cluster, Processes, result_of

KEPT: Final = 2
"""Shared values that workers keep: a trace alternates between two."""


@contextmanager
def parallel_map(executor: Executor | None) -> Iterator[ParallelMap]:
    """The parallel map of an executor; an InputError names the stage of a worker that dies."""
    with tempfile.TemporaryDirectory(prefix="biodyn-") as folder:
        yield serial_map if executor is None else _ExecutorMap(executor, Path(folder))


class _ExecutorMap:
    """A `ParallelMap`; folder holds shared values for the processes of this machine."""

    def __init__(self, executor: Executor, folder: Path) -> None:
        self._executor, self._folder = executor, folder
        self._sent: deque[tuple[Any, Any]] = deque(maxlen=KEPT)  # values and their references, oldest first
        self._number = 0

    def __call__(
        self, stage: str, function: Callable[[Shared, Item], Result], shared: Shared, items: Sequence[Item]
    ) -> Iterator[Result]:
        """See `ParallelMap`."""
        if len(items) == 1:  # not worth its transfer
            yield from serial_map(stage, function, shared, items)
            return
        reference = self._reference(shared)
        futures = deque(self._executor.submit(_call, function, reference, item) for item in items)
        try:
            while futures:
                found: Result = result_of(futures.popleft(), stage)
                yield found
        finally:
            for future in futures:
                future.cancel()

    def _reference(self, shared: Any) -> Any:
        """The argument by which a worker finds the shared value, which is sent if it is new."""
        for value, reference in self._sent:
            if value is shared:
                return reference
        if isinstance(self._executor, Processes):
            reference = self._stored(shared)
        elif isinstance(self._executor, Cluster):
            reference = self._executor.scattered(shared)
        else:
            return shared
        self._sent.append((shared, reference))
        return reference

    def _stored(self, shared: Any) -> _Stored:
        """A new file with the value; only the files of the last values remain."""
        self._number += 1
        (self._folder / str(self._number - KEPT)).unlink(missing_ok=True)
        path = self._folder / str(self._number)
        with path.open("wb") as file:
            pickle.dump(shared, file, protocol=pickle.HIGHEST_PROTOCOL)
        return _Stored(str(path))


class _Stored(str):
    """The path of a stored value."""

    __slots__ = ()


def _call(function: Callable[[Any, Any], Any], reference: Any, item: Any) -> Any:
    return function(_value(reference) if isinstance(reference, _Stored) else reference, item)


@lru_cache(maxsize=KEPT)
def _value(path: _Stored) -> Any:
    """The stored value, read once in each process."""
    with Path(path).open("rb") as file:
        return pickle.load(file)  # noqa: S301 - written by the process that started this one
