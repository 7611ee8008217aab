"""How far long work is: percent and the time at which it will be done, on a terminal; silent where nobody watches."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from types import TracebackType
from typing import Final, TextIO

OnProgress = Callable[[int, int], None]
"""Hears how much is done, of how much."""

REDRAWN_S: Final = 1.0
"""A line whose percent stands still is drawn again after this long, for its ETA."""

_ERASE: Final = "\x1b[K"
"""To the end of the line: a shorter text must not leave the tail of a longer one."""


def unwatched(done: int, total: int) -> None:
    """An `OnProgress` for nobody."""


class Progress:
    """One line on stderr, redrawn in place: `with Progress("replaying") as progress: work(progress)`.

    It hears (done, total). The rate is measured from the first call on, so what was done before, a block that was read
    or a file that was taken up, promises nothing. Leaving the block ends the line, also by an error or Ctrl-C.
    """

    def __init__(self, what: str, stream: TextIO | None = None) -> None:
        self._what, self._stream = what, sys.stderr if stream is None else stream
        self._watched = self._stream.isatty()
        self._first: tuple[float, int] | None = None
        self._shown, self._drawn_at = -1, 0.0
        self._open = False

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._open:
            self._open = False
            print(file=self._stream, flush=True)

    def __call__(self, done: int, total: int) -> None:
        """Show that `done` of `total` are done."""
        if not self._watched:
            return
        now, percent = time.monotonic(), min(100 * done // max(total, 1), 100)
        self._first = self._first or (now, done)
        if percent == self._shown and (percent == 100 or now - self._drawn_at < REDRAWN_S):
            return
        self._shown, self._drawn_at, self._open = percent, now, percent < 100
        eta, end = self._eta(now, done, total), "" if self._open else "\n"
        print(f"\r{self._what}: {percent:3d} %{eta}{_ERASE}", end=end, file=self._stream, flush=True)

    def _eta(self, now: float, done: int, total: int) -> str:
        """When it will be done, as a time of day: unlike seconds left it stays true while nothing is heard."""
        begun, before = self._first or (now, done)
        if not before < done < total:
            return ""
        left_s = (now - begun) * (total - done) / (done - before)
        pattern = "%H:%M:%S" if left_s < 12 * 3600.0 else "%a %d %b %H:%M"
        return ", ETA " + time.strftime(pattern, time.localtime(time.time() + left_s))


def silent(what: str) -> AbstractContextManager[OnProgress]:  # noqa: ARG001 - it is called as Progress is
    """What takes the place of a `Progress` that nobody is to see."""
    return nullcontext(unwatched)
