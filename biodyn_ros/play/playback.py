"""Playing a bag, without ROS: topics, order of messages, and length of a lap."""

from __future__ import annotations

import heapq
import sys
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median_low
from typing import Final

from biodyn_ros.bag import BagReader
from biodyn_ros.bag.cdr import NS_PER_S
from biodyn_ros.base.topics import INPUT
from biodyn_ros.reading.mapping import check_given

MAX_SPAN_DIFFERENCE_NS: Final = NS_PER_S
"""If the spans of stamps and recording differ by more, a clock was set, and the recorder's times are used."""

INTERVALS: Final = 1000
"""Number of the last intervals from which a topic's period is computed."""


@dataclass(frozen=True)
class Played:
    """Messages sent by topic, the time taken, and warnings about the bag."""

    messages: dict[str, int]
    seconds: float
    warnings: tuple[str, ...] = ()


class Lap:
    """The first lap of a looped bag: `note` every message, then `length_ns` is the time to the next lap.

    steady: the topics whose period continues from lap to lap; all topics if empty.
    """

    def __init__(self, steady: frozenset[str]) -> None:
        self._steady = steady
        self._tracks: dict[str, _Track] = {}

    def note(self, topic: str, log_ns: int, stamp_ns: int) -> None:
        """Note a message with the recorder's time and its own stamp."""
        if topic not in self._tracks:
            self._tracks[topic] = _Track(log_ns, stamp_ns)
        self._tracks[topic].note(log_ns, stamp_ns)

    def length_ns(self) -> int:
        """The length of a lap: the shortest without overlap of laps in which every steady topic keeps its period."""
        tracks = [track.checked() for track in self._tracks.values()]
        together_ns = max(t.stamps_ns[-1] + t.delay_ns for t in tracks) - min(t.first_ns + t.delay_ns for t in tracks)
        steady = [track for name, track in zip(self._tracks, tracks, strict=True) if name in self._steady] or tracks
        return max(together_ns, *(track.span_ns + track.period_ns() for track in steady)) or NS_PER_S


@dataclass
class _Track:
    """One topic of a lap: first and last log times and stamps, and the smallest delay."""

    first_log_ns: int
    first_ns: int
    log_ns: deque[int] = field(default_factory=lambda: deque(maxlen=INTERVALS + 1))
    stamps_ns: deque[int] = field(default_factory=lambda: deque(maxlen=INTERVALS + 1))
    delay_ns: int = sys.maxsize

    def note(self, log_ns: int, stamp_ns: int) -> None:
        self.log_ns.append(log_ns)
        self.stamps_ns.append(stamp_ns)
        self.delay_ns = min(self.delay_ns, log_ns - stamp_ns)

    @property
    def span_ns(self) -> int:
        return self.stamps_ns[-1] - self.first_ns

    def checked(self) -> _Track:
        """The same by log time if the stamps do not change or a clock was set."""
        recorded_ns = self.log_ns[-1] - self.first_log_ns
        if abs(self.span_ns - recorded_ns) <= min(MAX_SPAN_DIFFERENCE_NS, recorded_ns // 2):
            return self
        return _Track(self.first_log_ns, self.first_log_ns, self.log_ns, self.log_ns, 0)

    def period_ns(self) -> int:
        """The median interval; 0 for a single message."""
        return median_low([b - a for a, b in pairwise(self.stamps_ns)] or [0])


def played_on(reader: BagReader, given: dict[str, str], left_out: Collection[str] = ()) -> dict[str, str]:
    """Return {topic of the bag: output topic}: the same topic, or the input of the sensor that it is given as.

    A given topic replaces a topic of the same output name, which is not played, nor are the topics left out. Raises
    InputError for a given topic that is not in the bag.
    """
    check_given(reader, given)
    inputs = {topic: INPUT[sensor] for sensor, topic in given.items()}
    taken = set(inputs.values())
    names = [topic.name for topic in reader.topics if topic.messages and topic.name not in left_out]
    return {name: inputs.get(name, name) for name in names if name in inputs or name.lstrip("/") not in taken}


def in_order(reader: BagReader, topics: list[str]) -> Iterator[tuple[int, str, bytes]]:
    """All messages of the topics as (log time, topic, bytes), in order of log time, one or two chunks in memory."""
    waiting: list[tuple[int, int, str, bytes]] = []
    number = 0
    for chunk in reader.chunks(topics):
        while waiting and waiting[0][0] < chunk.start_ns:
            log_ns, _, name, message = heapq.heappop(waiting)
            yield log_ns, name, message
        for block in chunk.blocks():
            for log_ns, message in zip(block.log_ns.tolist(), block.messages(), strict=True):
                heapq.heappush(waiting, (log_ns, number, block.topic, message))
                number += 1
    while waiting:
        log_ns, _, name, message = heapq.heappop(waiting)
        yield log_ns, name, message
