"""Where work is done: here, in processes of this machine, or on a Dask cluster, all behind one `Executor`.

On a cluster tasks and results are pickled, so its address is for trusted networks only: whoever can reach a scheduler
or a worker runs code on it.
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
from biodyn_ros.base.environment import ONE_THREAD

Call = tuple[Callable[..., Any], tuple[Any, ...]]

FORMS: Final = "none, processes[:N], threads[:N] or tcp://HOST:PORT"
MOST_WORKERS: Final = 1024
CLUSTER_ANSWERS_S: Final = 10.0
"""How long a scheduler may take to answer."""

_ADDRESS: Final = re.compile(r"(tcp|tls)://[^\s/]+:[0-9]{1,5}")

LOST: Final = "its worker died in the middle, killed or out of memory; fewer workers need less of it"


@contextmanager
def executor_of(text: str) -> Iterator[Executor | None]:
    """The executor of a text as `FORMS`; None where work is done here.

    Leaving by an error or Ctrl-C drops what has not begun and ends the processes; threads and clusters finish what they
    are at. Raises InputError for another text, a missing package, and a cluster that does not answer or does not fit.
    """
    kind, _, rest = text.partition(":")
    if text == "none":
        yield None
    elif kind == "processes":
        with _processes(_workers(text, rest)) as executor:
            yield executor
    elif kind == "threads":
        with _ended(ThreadPoolExecutor(_workers(text, rest))) as executor:
            yield executor
    elif _ADDRESS.fullmatch(text) and int(text.rpartition(":")[2]) < 2**16:
        with _cluster(text) as executor:
            yield executor
    else:
        raise InputError(f"executor {text!r}: expected {FORMS}")


def as_done(executor: Executor | None, calls: Sequence[Call]) -> Iterator[tuple[int, Future[Any]]]:
    """Do calls; yields each one's number and finished future as they come.

    Where the caller stops listening, what has not begun is not begun.
    """
    if executor is None:
        yield from ((number, _done_here(function, arguments)) for number, (function, arguments) in enumerate(calls))
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
    """A finished future's result, or its error; a lost worker is an InputError that says what was lost."""
    try:
        return future.result()
    except (BrokenExecutor, CancelledError) as error:
        raise InputError(f"{what}: {LOST}") from error
    except Exception as error:
        # Dask's, which may not be there to be named.
        if type(error).__name__ == "KilledWorker":
            raise InputError(f"{what}: {LOST}") from error
        raise


def _done_here(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Any]:
    future: Future[Any] = Future()
    try:
        future.set_result(function(*arguments))
    except Exception as error:  # noqa: BLE001 - handed on to whoever asks for the result
        future.set_exception(error)
    return future


def _workers(text: str, number: str) -> int:
    """The N of `processes:N`, by default one for each core this process may use."""
    if text.partition(":")[1] == "":
        return len(os.sched_getaffinity(0))
    if not (number.isascii() and number.isdigit() and 1 <= int(number[:9]) <= MOST_WORKERS):
        raise InputError(f"executor {text!r}: expected a number of workers from 1 to {MOST_WORKERS}")
    return int(number)


@contextmanager
def _ended(executor: Executor, end: Callable[[], None] = lambda: None) -> Iterator[Executor]:
    """An executor that is shut down at last; `end` is called first where there was an error."""
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
    # Workers see the end of this pipe, and die, when its writer is closed: by us, or by our own death, however violent.
    reader, writer = multiprocessing.Pipe(duplex=False)
    with reader, writer, _one_thread(), _ended(_Processes(workers, reader), writer.close) as executor:
        yield executor


@contextmanager
def _one_thread() -> Iterator[None]:
    """Have processes that start meanwhile do linear algebra on one thread."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class _Processes(Executor):
    """Pools of one process each, handed out by threads: a process that dies takes its own task with it and no other."""

    def __init__(self, workers: int, reader: Connection) -> None:
        self._reader = reader
        self._free: queue.SimpleQueue[ProcessPoolExecutor] = queue.SimpleQueue()
        for _ in range(workers):
            self._free.put(self._pool())
        # Processes inherit what the thread that starts them blocks. Ctrl-C is for the caller alone.
        block = (signal.SIG_BLOCK, {signal.SIGINT})
        self._threads = ThreadPoolExecutor(workers, initializer=signal.pthread_sigmask, initargs=block)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        """As every executor's."""
        return self._threads.submit(self._do, function, *arguments, **named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As every executor's."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        with contextlib.suppress(queue.Empty):
            while True:
                self._free.get_nowait().shutdown(wait)

    def _pool(self) -> ProcessPoolExecutor:
        # Forking a process with threads may deadlock.
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(1, context, initializer=_die_with, initargs=(self._reader,))

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


def _die_with(reader: Connection) -> None:
    """End this worker, whatever it is at, when the other end of the pipe is closed."""

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
    # A case is a few megabytes, and it is in a few tasks: no reason to warn of each.
    quiet = dask.config.set({"distributed.admin.large-graph-warning-threshold": "10 GB"})
    try:
        client = distributed.Client(address, timeout=CLUSTER_ANSWERS_S, set_as_default=False)
    except (OSError, TimeoutError) as error:  # in Python 3.10 Dask's TimeoutError is no OSError
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{address}: no Dask scheduler answers there ({reason}); start one: dask scheduler") from None
    with quiet, client:
        _check_workers(client, address)
        # Pure tasks would be known by a hash of their arguments, which costs more than it saves.
        executor = client.get_executor(pure=False)
        try:
            yield executor
        except BaseException:
            executor.shutdown(wait=False)
            raise
        executor.shutdown()


def _check_workers(client: Any, address: str) -> None:
    """Raise InputError for a cluster without workers, or with one that has not this version of biodyn."""
    found = client.run(version_here, on_error="return")
    if not found:
        raise InputError(f"{address}: the cluster has no worker; start one on each machine: dask worker {address}")
    for worker, version in found.items():
        if version != __version__:  # an exception where it cannot be imported
            has = f"biodyn {version}" if isinstance(version, str) else f"no biodyn ({version})"
            raise InputError(f"{address}: worker {worker} has {has}, here is {__version__}; make them equal")


def version_here() -> str:
    """The version of biodyn where this is run."""
    return __version__
