"""Progress of long work: percent and expected end time on a terminal; no output elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Final

OnProgress = Callable[[int, int], None]
"""A callback (done, total)."""

REDRAWN_S: Final = 1.0
"""A line whose percentage does not change is redrawn after this time, for its ETA."""

_ERASE: Final = "\x1b[K"
"""Clears to the end of the line, where a longer text may have stood."""


def ignore_progress(done: int, total: int) -> None:
    """An `OnProgress` that does nothing."""


class Progress:
    """One line on stderr, redrawn in place: `with Progress("replaying") as progress: work(progress)`.

    It is called with (done, total). The rate is measured from the first call on, so that work done before, such as
    results loaded from a file, does not distort it. Leaving the block ends the line, also by an error or Ctrl-C.
    """

    def __init__(self, what: str) -> None:
        self._what, self._stream = what, sys.stderr
        self._is_terminal = self._stream.isatty()
        self._first: tuple[float, int] | None = None
        self._shown, self._drawn_at = -1, 0.0
        self._open = False

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._open:
            self._open = False
            print(file=self._stream, flush=True)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` are done."""
        if not self._is_terminal:
            return
        now, percent = time.monotonic(), min(100 * done // max(total, 1), 100)
        self._first = self._first or (now, done)
        if percent == self._shown and (percent == 100 or now - self._drawn_at < REDRAWN_S):
            return
        self._shown, self._drawn_at, self._open = percent, now, percent < 100
        eta, end = self._eta(now, done, total), "" if self._open else "\n"
        print(f"\r{self._what}: {percent:3d} %{eta}{_ERASE}", end=end, file=self._stream, flush=True)

    def _eta(self, now: float, done: int, total: int) -> str:
        """The expected end as a time of day, which stays valid between two updates."""
        begun, before = self._first or (now, done)
        if not before < done < total:
            return ""
        left_s = (now - begun) * (total - done) / (done - before)
        pattern = "%H:%M:%S" if left_s < 12 * 3600.0 else "%a %d %b %H:%M"
        return ", ETA " + time.strftime(pattern, time.localtime(time.time() + left_s))


def silent(what: str) -> AbstractContextManager[OnProgress]:  # noqa: ARG001 - it is called as Progress is
    """A `Progress` without output."""
    return nullcontext(ignore_progress)
