"""The common part of the storage back-ends of a bag: topics, blocks of messages, and the protocol."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.arrays import Integers
from biodyn_core.base.errors import InputError

Bytes = NDArray[np.uint8]
LogTimes = tuple[int, int]
"""The first and last log time, ns, of wanted messages."""

TopicKey = tuple[str, str]
"""Topic name and message type."""

OFFERED_QOS: Final = "offered_qos_profiles"
"""The name under which rosbag2 records the QoS of a topic's publishers."""

UNSTATED_DEPTH: Final = 10
"""The depth of a publisher that states none: the default of ROS 2."""

MAX_LATCHED: Final = 100
"""No publisher of the player keeps more messages, because they stay in memory."""

_PROFILE: Final = re.compile(r"^- ", re.MULTILINE)
_DEPTH: Final = re.compile(r"\bdepth:\s*(\d{1,6})\b")
_TRANSIENT_LOCAL: Final = re.compile(r"\bdurability:\s*(?:1|transient_local)\b")
"""Up to Humble the policy is a number."""


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag: name, message type (sensor_msgs/msg/Imu) and number of messages.

    latched: the number of messages that transient local publishers kept for late subscribers, 0 without one.
    """

    name: str
    type: str
    messages: int
    latched: int = 0


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive messages of one topic in a buffer shared with other topics; nothing is copied.

    Message i was logged at log_ns[i] and is buffer[offsets[i] : offsets[i] + lengths[i]]; all three are int64 (n,).
    """

    topic: str
    type: str
    log_ns: Integers
    buffer: Bytes
    offsets: Integers
    lengths: Integers

    def __len__(self) -> int:
        return len(self.log_ns)

    def messages(self) -> list[bytes]:
        """The messages as bytes objects, copied."""
        data = self.buffer.data
        return [bytes(data[at : at + n]) for at, n in zip(self.offsets.tolist(), self.lengths.tolist(), strict=True)]


@dataclass(frozen=True, eq=False)
class Chunk:
    """The selected messages of one part of a bag, topic after topic, in file order within a topic.

    Rows edges[k] to edges[k + 1] of log_ns, offsets and lengths belong to keys[k]. Chunks come in the order of
    start_ns, their first log time: every message logged before start_ns is in an earlier chunk.
    """

    start_ns: int
    buffer: Bytes
    keys: tuple[TopicKey, ...]
    edges: tuple[int, ...]
    log_ns: Integers
    offsets: Integers
    lengths: Integers

    def blocks(self) -> Iterator[Block]:
        """One block per topic."""
        for (topic, kind), lo, hi in zip(self.keys, self.edges, self.edges[1:], strict=False):
            yield Block(topic, kind, self.log_ns[lo:hi], self.buffer, self.offsets[lo:hi], self.lengths[lo:hi])


class Storage(Protocol):
    """One storage file, open for reading. start_ns and end_ns are log times, None in an empty file."""

    topics: tuple[TopicInfo, ...]
    start_ns: int | None
    end_ns: int | None
    recovered: bool

    def chunks(self, topics: frozenset[str], within: LogTimes | None = None) -> Iterator[Chunk]:
        """The messages of these topics, one chunk in memory at a time; chunks without times `within` are skipped."""

    def metadata(self, name: str) -> dict[str, str]:
        """The metadata record of that name, empty if there is none."""

    def close(self) -> None:
        """Close the file."""


def latched_depth(offered_qos_profiles: object) -> int:
    """The sum of the depths of a topic's transient local publishers, from the profiles that rosbag2 records as YAML."""
    profiles = _PROFILE.split(offered_qos_profiles) if isinstance(offered_qos_profiles, str) else []
    latched = [profile for profile in profiles if _TRANSIENT_LOCAL.search(profile)]
    depths = [int(found[1]) if (found := _DEPTH.search(profile)) else 0 for profile in latched]
    return min(sum(depth or UNSTATED_DEPTH for depth in depths), MAX_LATCHED)


def topic_infos(messages: Mapping[TopicKey, int], latched: Mapping[TopicKey, int]) -> tuple[TopicInfo, ...]:
    """The topics of a bag from their numbers of messages, and those that they latched."""
    return tuple(TopicInfo(*key, n, latched.get(key, 0)) for key, n in messages.items())


def require(module: str) -> ModuleType:
    """Import a module of the 'bags' extra; raises InputError with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise InputError(
            f"bags need the Python module {name}, which is not installed: pip install 'biodyn_ros[bags]'"
        ) from None


def grouped(
    start_ns: int,
    buffer: Bytes,
    keys: tuple[TopicKey, ...],
    group: Integers,
    log_ns: Integers,
    offsets: Integers,
    lengths: Integers,
) -> Chunk:
    """A chunk from messages in file order; group[i] is the index in keys of message i's topic."""
    if (group[1:] < group[:-1]).any():
        order = np.argsort(group, kind="stable")
        group, log_ns, offsets, lengths = group[order], log_ns[order], offsets[order], lengths[order]
    edges = np.searchsorted(group, np.arange(len(keys) + 1))
    return Chunk(start_ns, buffer, keys, tuple(edges.tolist()), log_ns, offsets, lengths)


def refuse_foreign(path: Path, formats: Iterable[tuple[str, str]], warnings: list[str]) -> None:
    """Raise InputError if no topic is CDR, and warn of each (topic, format) that is not; an empty bag is accepted.

    A recording without ROS 2 topics cannot be read; among ROS 2 topics a JSON topic is only omitted.
    """
    formats = list(formats)
    foreign = [(topic, form) for topic, form in formats if form != "cdr"]
    if foreign and len(foreign) == len(formats):
        topic, form = foreign[0]
        raise InputError(
            f"{path}: topic {topic} is serialized as {form or 'unknown'!r}, only 'cdr' (ROS 2) can be read:"
            " record with ROS 2, or convert the bag with rosbags-convert"
        )
    warnings.extend(f"{path}: topic {topic} is serialized as {form!r}, not 'cdr': omitted" for topic, form in foreign)
