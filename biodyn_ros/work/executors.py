"""Executors: this process, processes or threads of this machine, or a Dask cluster, all as one `Executor`.

A cluster exchanges pickled tasks and results, so use it on trusted networks only: access to a scheduler or a worker
allows execution of code on it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import re
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from contextlib import contextmanager
from multiprocessing.connection import Connection
from typing import Any, Final

from biodyn_core.base.errors import InputError
from biodyn_ros import __version__
from biodyn_ros.base.environment import ONE_THREAD, variables_set

Call = tuple[Callable[..., Any], tuple[Any, ...]]

FORMS: Final = "none, processes[:N], threads[:N] or tcp://HOST:PORT"
MAX_WORKERS: Final = 1024
CLUSTER_TIMEOUT_S: Final = 10.0
"""Timeout of the connection to a scheduler."""

_ADDRESS: Final = re.compile(r"(tcp|tls)://[^\s/]+:[0-9]{1,5}")

LOST: Final = "its worker process died, killed or out of memory; fewer workers need less memory"


@contextmanager
def executor_of(text: str) -> Iterator[Executor | None]:
    """The executor of a text as in `FORMS`; None for work in this process.

    An error or Ctrl-C drops waiting tasks and ends the processes; threads and clusters finish their running tasks.
    Raises InputError for another text, a missing package, and a cluster that does not respond or has another version.
    """
    kind, _, rest = text.partition(":")
    if text == "none":
        yield None
    elif kind == "processes":
        with _processes(_workers(text, rest)) as executor:
            yield executor
    elif kind == "threads":
        with _shut_down(ThreadPoolExecutor(_workers(text, rest))) as executor:
            yield executor
    elif _ADDRESS.fullmatch(text) and int(text.rpartition(":")[2]) < 2**16:
        with _cluster(text) as executor:
            yield executor
    else:
        raise InputError(f"executor {text!r}: expected {FORMS}")


def as_done(executor: Executor | None, calls: Sequence[Call]) -> Iterator[tuple[int, Future[Any]]]:
    """Run calls; yields number and finished future of each as they finish.

    When the caller closes the generator, waiting calls are cancelled.
    """
    if executor is None:
        yield from ((number, _run_here(function, arguments)) for number, (function, arguments) in enumerate(calls))
        return
    futures: dict[Future[Any], int] = {}
    try:
        for number, (function, arguments) in enumerate(calls):
            futures[executor.submit(function, *arguments)] = number
        for future in as_completed(futures):
            yield futures[future], future
    finally:
        for future in futures:
            future.cancel()


def result_of(future: Future[Any], what: str) -> Any:
    """A finished future's result, or its error; a lost worker is an InputError that names the task."""
    try:
        return future.result()
    except (BrokenExecutor, CancelledError) as error:
        raise InputError(f"{what}: {LOST}") from error
    except Exception as error:
        # Dask's class, which cannot be imported without Dask.
        if type(error).__name__ == "KilledWorker":
            raise InputError(f"{what}: {LOST}") from error
        raise


def _run_here(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
    future: Future[Any] = Future()
    try:
        future.set_result(function(*arguments))
    except Exception as error:  # noqa: BLE001 - raised when the result is requested
        future.set_exception(error)
    return future


def _workers(text: str, number: str) -> int:
    """The N of `processes:N`, by default the number of cores available to this process."""
    if text.partition(":")[1] == "":
        return len(os.sched_getaffinity(0))
    if not (number.isascii() and number.isdigit() and 1 <= int(number[:9]) <= MAX_WORKERS):
        raise InputError(f"executor {text!r}: expected a number of workers from 1 to {MAX_WORKERS}")
    return int(number)


@contextmanager
def _shut_down(executor: Executor, end: Callable[[], None] = lambda: None) -> Iterator[Executor]:
    """An executor that is shut down at exit; after an error `end` is called first."""
    try:
        yield executor
    except BaseException:
        end()
        executor.shutdown(wait=True, cancel_futures=True)
        raise
    executor.shutdown()


# --- processes -------------------------------------------------------------------------------------------------------


@contextmanager
def _processes(workers: int) -> Iterator[Executor]:
    # Workers exit at the end of this pipe: when its writer is closed here, or when this process dies.
    reader, writer = multiprocessing.Pipe(duplex=False)
    with reader, writer, variables_set(ONE_THREAD), _shut_down(Processes(workers, reader), writer.close) as executor:
        yield executor


class Processes(Executor):
    """Pools of one process each, used by threads, so that a process that dies loses its own task alone."""

    def __init__(self, workers: int, reader: Connection) -> None:
        self._reader = reader
        self._free: queue.SimpleQueue[ProcessPoolExecutor] = queue.SimpleQueue()
        for _ in range(workers):
            self._free.put(self._pool())
        # Processes inherit the signal mask of the starting thread; only the caller handles Ctrl-C.
        block = (signal.SIG_BLOCK, {signal.SIGINT})
        self._threads = ThreadPoolExecutor(workers, initializer=signal.pthread_sigmask, initargs=block)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """See `concurrent.futures.Executor`."""
        return self._threads.submit(self._do, function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `concurrent.futures.Executor`."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        with contextlib.suppress(queue.Empty):
            while True:
                self._free.get_nowait().shutdown(wait)

    def _pool(self) -> ProcessPoolExecutor:
        # Forking a process with threads may deadlock.
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, context, initializer=_exit_with, initargs=(self._reader,))

    def _do(self, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        pool = self._free.get()
        try:
            return pool.submit(function, *arguments, **named).result()
        except BrokenExecutor:
            pool.shutdown()
            pool = self._pool()
            raise
        finally:
            self._free.put(pool)


def _exit_with(reader: Connection) -> None:
    """Exit this worker as soon as the other end of the pipe is closed."""

    def wait() -> None:
        with contextlib.suppress(EOFError, OSError):
            reader.recv_bytes()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


# --- cluster ---------------------------------------------------------------------------------------------------------


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    try:
        import dask
        import distributed
    except ImportError:
        raise InputError(f"{address}: Dask is not installed; pip install 'biodyn_ros[cluster]'") from None
    # A few tasks contain the same case of a few megabytes: no warning is needed.
    quiet = dask.config.set({"distributed.admin.large-graph-warning-threshold": "10 GB"})
    try:
        client = distributed.Client(address, timeout=CLUSTER_TIMEOUT_S, set_as_default=False)
    except (OSError, TimeoutError) as error:  # in Python 3.10 Dask's TimeoutError is no OSError
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{address}: no Dask scheduler responds there ({reason}); start one: dask scheduler") from None
    with quiet, client:
        _check_workers(client, address)
        executor = Cluster(client)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False)
            raise
        executor.shutdown()


class Cluster(Executor):
    """The workers of a Dask client."""

    def __init__(self, client: Any) -> None:
        self._client = client
        # Pure tasks are hashed by their arguments, which costs more time than it saves.
        self._executor = client.get_executor(pure=False)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """See `concurrent.futures.Executor`."""
        found: Future[Any] = self._executor.submit(function, *arguments, **named)
        return found

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """See `concurrent.futures.Executor`; tasks that wait for a worker are cancelled unless wait is set."""
        self._executor.shutdown(wait)

    def scattered(self, value: Any) -> Any:
        """A reference that tasks receive as the value, which is sent to every worker now."""
        (reference,) = self._client.scatter([value], broadcast=True, hash=False)
        return reference


def _check_workers(client: Any, address: str) -> None:
    """Raise InputError for a cluster without workers, or with a worker of another version of biodyn."""
    found = client.run(version_here, on_error="return")
    if not found:
        raise InputError(f"{address}: the cluster has no worker; start one on each machine: dask worker {address}")
    for worker, version in found.items():
        if version != __version__:  # an exception where it cannot be imported
            has = f"biodyn {version}" if isinstance(version, str) else f"no biodyn ({version})"
            raise InputError(f"{address}: worker {worker} has {has}, here is {__version__}; make them equal")


def version_here() -> str:
    """The version of biodyn on the machine that runs this."""
    return __version__
