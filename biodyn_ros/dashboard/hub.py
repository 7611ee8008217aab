"""The events for clients of the page: first the clock and the last minute, then every snapshot with its time."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import deque
from itertools import pairwise
from typing import Any, Final

from biodyn_ros.reports.downsampling import BIN_NS

HISTORY_S: Final = 60.0
BIN_S: Final = 1e-9 * BIN_NS
HISTORY_BINS: Final = round(HISTORY_S / BIN_S)
STREAMS: Final = {"predicted": HISTORY_BINS, "measured": HISTORY_BINS, "error": round(HISTORY_S)}
"""Bins of the last minute by stream; those of `error`, the interval of true minus predicted, are seconds."""

MAX_CHARACTERS: Final = 1_000_000
"""A snapshot has about ten thousand; a longer text is not from the node."""

RECENT: Final = 12
"""A client that is further behind, three seconds, receives the last minute again."""

MIXED_MS: Final = 5000.0
"""Data count as those of several nodes for so long after a source returned."""

_NONE: Final = -2
"""A number after which no event is the next one."""


def clock_ms() -> float:
    """The clock of `received_ms` in each snapshot, of an arbitrary origin."""
    return 1e3 * time.monotonic()


class Hub:
    """`add` snapshots; each client gets the `events` since its last number, and waits for the next."""

    def __init__(self) -> None:
        self.number = 0
        self._recent: deque[tuple[int, str]] = deque(maxlen=RECENT)
        self._sources: dict[str, float] = {}
        self._mixed_ms = -math.inf
        self._history: dict[str, deque[tuple[float, Any, Any]]] = {}
        self._added = asyncio.Event()

    def add(self, text: str) -> None:
        """Add a snapshot of the node; invalid text is ignored."""
        if len(text) > MAX_CHARACTERS:
            return
        try:
            snapshot = json.loads(text)
            streams = [(name, _bins(stream)) for name, stream in snapshot["strip"].items() if name in STREAMS]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return
        for name, bins in streams:
            history = self._history.setdefault(name, deque(maxlen=STREAMS[name]))
            for each in bins:
                if history and not 0.0 < each[0] - history[-1][0] <= HISTORY_S:
                    history.clear()  # another clock, a restarted bag, or a long gap
                history.append(each)
        snapshot |= {"received_ms": clock_ms(), "is_mixed": self._is_mixed(str(snapshot.get("source")))}
        self.number += 1
        self._recent.append((self.number, json.dumps(snapshot)))  # an event must be on one line
        added, self._added = self._added, asyncio.Event()
        added.set()

    def first_events(self) -> list[str]:
        """The events for a new client: the clock, from which the client finds the age of each snapshot, and the minute.

        The clock is the first event, so that no other data delay it.
        """
        return [_event("clock", json.dumps(clock_ms()), self.number), *self.events(_NONE)]

    def events(self, since: int) -> list[str]:
        """The events after that number, oldest first; the last minute for a client that is new or far behind."""
        newer = [(number, text) for number, text in self._recent if number > since]
        if newer and newer[0][0] == since + 1:
            return [_event("snapshot", text, number) for number, text in newer]
        return [_event("history", json.dumps(self._minute()), self.number)]

    async def wait(self, since: int, timeout_s: float) -> bool:
        """Wait for a snapshot after that number; returns False on a timeout."""
        if self.number > since:
            return True
        try:
            await asyncio.wait_for(self._added.wait(), timeout_s)
        except asyncio.TimeoutError:
            return False
        return True

    def _is_mixed(self, source: str) -> bool:
        """Whether several nodes of one name send: then a source returns after another one, unlike that of a restart."""
        now_ms, last = clock_ms(), next(reversed(self._sources), source)
        if source != last and source in self._sources:
            self._mixed_ms = now_ms
        self._sources.pop(source, None)
        self._sources[source] = now_ms  # the last
        self._sources = {each: at_ms for each, at_ms in self._sources.items() if now_ms - at_ms < MIXED_MS}
        return now_ms - self._mixed_ms < MIXED_MS

    def _minute(self) -> dict[str, Any]:
        return {
            name: {
                "begin_s": [begin_s for begin_s, _, _ in bins],
                "low": [low for _, low, _ in bins],
                "high": [high for _, _, high in bins],
            }
            for name, bins in self._history.items()
        }


def _bins(stream: dict[str, Any]) -> list[tuple[float, Any, Any]]:
    bins = list(zip(map(float, stream["begin_s"]), stream["low"], stream["high"], strict=True))
    # Bins of a snapshot ascend unless stamps jump back; only bins after the last jump are used.
    jumps = [at for at, (a, b) in enumerate(pairwise(bins), 1) if b[0] <= a[0]]
    return bins[jumps[-1] :] if jumps else bins


def _event(kind: str, text: str, number: int) -> str:
    return f"event: {kind}\nid: {number}\ndata: {text}\n\n"
