"""What the page's visitors are sent: to a newcomer the last minute, then every snapshot as it comes."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from itertools import pairwise
from typing import Any, Final

from biodyn_ros.reports.downsampling import BIN_NS

HISTORY_S: Final = 60.0
BIN_S: Final = 1e-9 * BIN_NS
HISTORY_BINS: Final = round(HISTORY_S / BIN_S)
STRIPS: Final = ("predicted", "measured")
MOST_CHARACTERS: Final = 1_000_000
"""A snapshot has some ten thousand; what is longer comes from nobody of ours."""

RECENT: Final = 12
"""A stream that is more snapshots behind, three seconds, is sent the last minute anew."""


class Hub:
    """`take` snapshots; every stream asks for `events` since the number it has, and waits for the next."""

    def __init__(self) -> None:
        self.number = 0
        self._recent: deque[tuple[int, str]] = deque(maxlen=RECENT)
        self._history: dict[str, deque[tuple[float, Any, Any]]] = {}
        self._came = asyncio.Event()

    def take(self, text: str) -> None:
        """Take a snapshot as the node sent it; what is no snapshot is left out."""
        if len(text) > MOST_CHARACTERS:
            return
        try:
            snapshot = json.loads(text)
            strips = [(name, _bins(strip)) for name, strip in snapshot["strip"].items() if name in STRIPS]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return
        for name, bins in strips:
            self._remember(self._history.setdefault(name, deque(maxlen=HISTORY_BINS)), bins)
        self.number += 1
        self._recent.append((self.number, json.dumps(snapshot)))  # anew: on one line, whatever was sent
        came, self._came = self._came, asyncio.Event()
        came.set()

    def events(self, since: int) -> list[str]:
        """The events behind that number, oldest first; the last minute for a newcomer, or one that is far behind."""
        newer = [(number, text) for number, text in self._recent if number > since]
        if newer and newer[0][0] == since + 1:
            return [_event("snapshot", text, number) for number, text in newer]
        return [_event("history", json.dumps(self._minute()), self.number)]

    async def wait(self, since: int, most_s: float) -> bool:
        """Wait for a snapshot behind that number; whether one came."""
        if self.number > since:
            return True
        try:
            await asyncio.wait_for(self._came.wait(), most_s)
        except asyncio.TimeoutError:
            return False
        return True

    def _minute(self) -> dict[str, Any]:
        return {
            name: {
                "begin_s": [begin_s for begin_s, _, _ in bins],
                "low": [low for _, low, _ in bins],
                "high": [high for _, _, high in bins],
            }
            for name, bins in self._history.items()
        }

    @staticmethod
    def _remember(history: deque[tuple[float, Any, Any]], bins: list[tuple[float, Any, Any]]) -> None:
        for each in bins:
            if history and not 0.0 < each[0] - history[-1][0] <= HISTORY_S:
                history.clear()  # another clock, a bag that began anew, or a long silence
            history.append(each)


def _bins(strip: dict[str, Any]) -> list[tuple[float, Any, Any]]:
    bins = list(zip(map(float, strip["begin_s"]), strip["low"], strip["high"], strict=True))
    # Within one snapshot they ascend, unless stamps leapt; what lies before the leap belongs to another time.
    leaps = [at for at, (a, b) in enumerate(pairwise(bins), 1) if b[0] <= a[0]]
    return bins[leaps[-1] :] if leaps else bins


def _event(kind: str, text: str, number: int) -> str:
    return f"event: {kind}\nid: {number}\ndata: {text}\n\n"
