"""The marks set during a recording, if the live node's topic of marks was recorded."""

from __future__ import annotations

from typing import NamedTuple

from biodyn_ros.bag import BagReader
from biodyn_ros.bag.cdr import STRING_TYPE, decode_string
from biodyn_ros.base import topics


class Mark(NamedTuple):
    """A mark and its time by the recorder's clock: seconds after the first sample of the seat, or a part's begin."""

    name: str
    time_s: float


def marks_of(reader: BagReader, begin_ns: int) -> list[Mark]:
    """The marks in order of time; begin_ns: log time at 0 s.

    The node may have another name or a namespace: the last part and the type of a topic identify it.
    """
    last = topics.MARKS.removeprefix("~")
    named = [t.name for t in reader.topics if t.type == STRING_TYPE and t.name.endswith(last)]
    found = [
        (log_ns, decode_string(message))
        for block in reader.blocks(named)
        for log_ns, message in zip(block.log_ns.tolist(), block.messages(), strict=True)
    ]
    return [Mark(name, 1e-9 * (log_ns - begin_ns)) for log_ns, name in sorted(found)]
