"""What playing a bag means, without ROS: what goes where, what was sent, and the order of messages."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

from biodyn_ros.bag import BagReader
from biodyn_ros.reading.mapping import check_given
from biodyn_ros.topics import INPUT


@dataclass(frozen=True)
class Played:
    """What was sent: messages by topic, and how long it took."""

    messages: dict[str, int]
    seconds: float


def played_on(reader: BagReader, given: dict[str, str]) -> dict[str, str]:
    """Return {topic of the bag: topic that it is played on}: its own, or the input of the sensor which it is given as.

    What is given takes the place of a topic of that name, which is left out. Raises InputError for a given topic that
    is not there.
    """
    check_given(reader, given)
    inputs = {topic: INPUT[sensor] for sensor, topic in given.items()}
    taken = set(inputs.values())
    names = [topic.name for topic in reader.topics if topic.messages]
    return {name: inputs.get(name, name) for name in names if name in inputs or name.lstrip("/") not in taken}


def in_order(reader: BagReader, topics: list[str]) -> Iterator[tuple[int, str, bytes]]:
    """All messages of the topics as (log time, topic, bytes), in order of log time, a chunk or two in memory."""
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
