"""Shutdown: SIGINT and SIGTERM ask a process to end; one that does not end in time is ended, and its stage is named.

A thread hears the signals, so that a main thread that hangs cannot hold them up. Where Python itself hangs, in a call
that keeps the interpreter's lock or behind the last line of Python, the kernel's alarm ends the process.
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

ENDS_WITHIN_S: Final = 5.0
ALARM_S: Final = 7.0
"""Later than the thread, which names the stage; the alarm shows where each thread is."""

EXIT_NOT_ENDED: Final = 1
"""Of a process that did not end in time; the alarm's is that of its signal, 142 in a shell."""

STDERR: Final = 2
SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Shutdown:
    """Bounds the end of the process from the first SIGINT or SIGTERM on, as a context in the main thread.

    name: the command, as messages call it. asked: whether a signal has come. stage: the part of the process that runs
    now, for the message. interrupts: whether the first signal raises KeyboardInterrupt in the main thread.
    """

    def __init__(self, name: str, interrupts: bool = False) -> None:
        self.name, self.interrupts = name, interrupts
        self.asked = False
        self.stage = "the work"
        self._interrupted = self._alarmed = False
        self._told: list[Callable[[], None]] = []
        self._lock = threading.Lock()

    def __enter__(self) -> Shutdown:
        self._reading, self._writing = os.pipe()
        os.set_blocking(self._writing, False)
        self._before = {number: signal.signal(number, self._on_signal) for number in SIGNALS}
        self._fd_before = signal.set_wakeup_fd(self._writing, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, name="shutdown", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Without a signal all is as before; behind one the interpreter's own end stays bounded."""
        if self.asked:
            self.stage = "the interpreter"
            return
        signal.set_wakeup_fd(self._fd_before)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._writing)  # the thread reads its end, and leaves

    def on_asked(self, tell: Callable[[], None]) -> None:
        """Call `tell` once a signal has come, in another thread; at once where it has."""
        with self._lock:
            if not self.asked:
                self._told.append(tell)
                return
        tell()

    def through(self, stages: Iterable[tuple[str, Callable[[], object]]]) -> None:
        """Run the stages of the end in a row, each by its name."""
        for self.stage, run in stages:
            run()

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._set_alarm()
        self.asked = True
        if self.interrupts and not self._interrupted:
            self._interrupted = True
            raise KeyboardInterrupt

    def _watch(self) -> None:
        """Hear the first signal, tell of it, and end the process where it does not end itself."""
        while number := os.read(self._reading, 1):
            if number[0] in SIGNALS:
                self._bound(signal.Signals(number[0]))
                return
        os.close(self._reading)

    def _bound(self, asking: signal.Signals) -> None:
        self._set_alarm()
        with self._lock:
            self.asked = True
        for tell in self._told:
            with contextlib.suppress(Exception):  # what is told may have ended already
                tell()
        time.sleep(ENDS_WITHIN_S)
        line = f"{self.name}: {self.stage} has not ended {ENDS_WITHIN_S:g} s after {asking.name}: the process is ended"
        with contextlib.suppress(OSError):
            os.write(STDERR, f"{line}\n".encode())
        os._exit(EXIT_NOT_ENDED)

    def _set_alarm(self) -> None:
        """Have the kernel end the process, whatever Python does; each thread's place goes to standard error then.

        Both the handler and the thread do it: either may be the one that still runs.
        """
        if not self._alarmed:
            self._alarmed = True
            with contextlib.suppress(OSError, ValueError):  # standard error is closed
                faulthandler.register(signal.SIGALRM, STDERR, all_threads=True, chain=True)
            signal.setitimer(signal.ITIMER_REAL, ALARM_S)
