"""Bounded shutdown: after SIGINT or SIGTERM a process that does not end in time is killed, and its stage is reported.

A thread waits for the signals, so that a blocked main thread cannot delay them. Where Python itself blocks, in a call
that keeps the interpreter lock or after the last line of Python, the kernel's alarm ends the process.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Final

TIMEOUT_S: Final = 5.0
ALARM_S: Final = 7.0
"""Later than the thread, which reports the stage; the alarm prints the stack of each thread."""

EXIT_NOT_ENDED: Final = 1
"""Exit code of a process that did not end in time; after the alarm it is that of the signal, 142 in a shell."""

STDERR: Final = 2
SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Shutdown:
    """Bounds the time to exit after the first SIGINT or SIGTERM; a context manager of the main thread.

    name: the command, as in messages. requested: whether a signal has been received. stage: the part of the process
    that runs now, for the message. interrupts: whether the first signal raises KeyboardInterrupt in the main thread.
    """

    def __init__(self, name: str, interrupts: bool = False) -> None:
        self.name, self.interrupts = name, interrupts
        self.requested = False
        self.stage = "the work"
        self._interrupted = self._alarmed = False
        self._callbacks: list[Callable[[], None]] = []
        self._lock = threading.Lock()

    def __enter__(self) -> Shutdown:
        self._reading, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        self._before = {number: signal.signal(number, self._on_signal) for number in SIGNALS}
        self._fd_before = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        threading.Thread(target=self._wait_for_signal, name="shutdown", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Without a signal restore the handlers; after one the exit of the interpreter stays bounded."""
        if self.requested:
            self.stage = "the interpreter"
            return
        signal.set_wakeup_fd(self._fd_before)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._writing)  # the thread reads the end of the pipe and returns

    def on_request(self, callback: Callable[[], None]) -> None:
        """Call `callback` after a signal, in another thread; immediately if a signal has been received."""
        with self._lock:
            if not self.requested:
                self._callbacks.append(callback)
                return
        callback()

    def run_stages(self, stages: Iterable[tuple[str, Callable[[], object]]]) -> None:
        """Run the named stages of the shutdown one after the other."""
        for self.stage, run in stages:
            run()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._set_alarm()
        self.requested = True
        if self.interrupts and not self._interrupted:
            self._interrupted = True
            raise KeyboardInterrupt

    def _wait_for_signal(self) -> None:
        """Wait for the first signal, then bound the time to exit."""
        while number := os.read(self._reading, 1):
            if number[0] in SIGNALS:
                self._enforce_timeout(signal.Signals(number[0]))
                return
        os.close(self._reading)

    def _enforce_timeout(self, received: signal.Signals) -> None:
        self._set_alarm()
        with self._lock:
            self.requested = True
        for callback in self._callbacks:
            with contextlib.suppress(Exception):  # its object may have ended already
                callback()
        time.sleep(TIMEOUT_S)
        line = f"{self.name}: {self.stage} has not ended {TIMEOUT_S:g} s after {received.name}: the process is ended"
        with contextlib.suppress(OSError):
            os.write(STDERR, f"{line}\n".encode())
        os._exit(EXIT_NOT_ENDED)

    def _set_alarm(self) -> None:
        """Let the kernel end the process, independent of Python; the stack of each thread goes to standard error then.

        Both the handler and the thread set it, because either may be blocked.
        """
        if not self._alarmed:
            self._alarmed = True
            with contextlib.suppress(OSError, ValueError):  # standard error is closed
                faulthandler.register(signal.SIGALRM, STDERR, all_threads=True, chain=True)
            signal.setitimer(signal.ITIMER_REAL, ALARM_S)
