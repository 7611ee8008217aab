"""Reads and writes rosbag2 recordings in whole chunks, without ROS.

    with open_bag("drive") as bag:
        for topic, block in imu_blocks(bag, ["imu/seat/data", "imu/head/data"]):
            ...

A bag is a .mcap or .db3 file, or the directory of a recording, with or without its metadata.yaml, split or not.
Memory is that of one or two chunks, independent of the length of the bag.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, groupby, pairwise
from operator import itemgetter
from pathlib import Path
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.suggestions import did_you_mean, did_you_mean_file
from biodyn_ros.bag.cdr import IMU_TYPE, ImuBlock, decode_imu_in
from biodyn_ros.bag.files import files_of_directory, kind_of
from biodyn_ros.bag.mcap import McapStorage
from biodyn_ros.bag.sqlite import SqliteStorage
from biodyn_ros.bag.storage import Block, Chunk, LogTimes, Storage, TopicInfo, TopicKey, topic_infos
from biodyn_ros.bag.writer import BagWriter

__all__ = ["BagReader", "BagWriter", "Block", "Chunk", "LogTimes", "LoggedImu", "TopicInfo", "imu_blocks", "open_bag"]

SLICE_NS: Final = 250_000_000
"""Largest lead in log time of one topic over the others in `imu_blocks`."""

SEAM_S: Final = 1.0
"""A recorder that starts the next file of a split recording loses or repeats less."""

_NEVER = -(2**63)


@dataclass(frozen=True, eq=False)
class LoggedImu(ImuBlock):
    """Samples of one sensor with both times: header_ns and log_ns int64 (n,); stamps_ns is the requested one."""

    header_ns: Integers
    log_ns: Integers

    def stamped(self, stamps_ns: Integers) -> LoggedImu:
        """The same samples with other stamps (n,); the header's and the log times stay."""
        return LoggedImu(stamps_ns, self.accel_mps2, self.gyro_radps, self.header_ns, self.log_ns)

    def only(self, rows: Flags) -> LoggedImu:
        """The samples with a set flag (n,)."""
        rates = None if self.gyro_radps is None else self.gyro_radps[rows]
        return LoggedImu(self.stamps_ns[rows], self.accel_mps2[rows], rates, self.header_ns[rows], self.log_ns[rows])


_Run = tuple[int, int, int, LoggedImu]
"""Samples not yet yielded: slot of log time, number of the topic, log time of the first, the samples."""

_STORAGES: dict[str, Callable[[Path, list[str]], Storage]] = {"mcap": McapStorage, "sqlite3": SqliteStorage}


class BagReader:
    """A bag open for reading: its topics, and its messages in blocks. A context manager, made by `open_bag`.

    storage is "mcap" or "sqlite3"; start_ns and end_ns are log times, None in an empty bag. `recovered` is True for
    an unfinished, cut or damaged bag; `warnings` lists missing and omitted parts, and may grow while reading.
    """

    def __init__(
        self, path: Path, files: list[Path], storage: str, storages: list[Storage], warnings: list[str]
    ) -> None:
        self.path, self.files, self.storage, self.warnings = path, files, storage, warnings
        self._storages = storages
        warnings += _seams(files, storages)
        counts: dict[TopicKey, int] = {}
        for topic in (topic for part in storages for topic in part.topics):
            counts[topic.name, topic.type] = counts.get((topic.name, topic.type), 0) + topic.messages
        latched: dict[TopicKey, int] = {}
        for topic in (topic for part in storages for topic in part.topics):
            latched[topic.name, topic.type] = max(topic.latched, latched.get((topic.name, topic.type), 0))
        self.topics = topic_infos(counts, latched)
        self.message_count = sum(counts.values())
        self.start_ns = min((part.start_ns for part in storages if part.start_ns is not None), default=None)
        self.end_ns = max((part.end_ns for part in storages if part.end_ns is not None), default=None)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; blocks already yielded stay valid."""
        for part in self._storages:
            part.close()

    @property
    def recovered(self) -> bool:
        """Whether the bag is unfinished, cut or damaged."""
        return any(part.recovered for part in self._storages)

    def metadata(self, name: str) -> dict[str, str]:
        """The MCAP metadata record of that name (`biodyn` holds provenance), empty if there is none."""
        return next((found for part in self._storages if (found := part.metadata(name))), {})

    def chunks(self, topics: Iterable[str] | None = None, within: LogTimes | None = None) -> Iterator[Chunk]:
        """The messages of these topics, or of all, chunk by chunk in the order of log time.

        within: log times; a chunk without messages between them is skipped. InputError for a topic that is not in the
        bag.
        """
        known = {topic.name for topic in self.topics}
        wanted = known if topics is None else frozenset(topics)
        if missing := sorted(wanted - known):
            there = ", ".join(sorted(known)) or "none"
            near = did_you_mean(missing[0], known)
            raise InputError(f"{self.path}: topic {missing[0]} is not in the bag; its topics: {there}{near}")
        return chain.from_iterable(part.chunks(frozenset(wanted), within) for part in self._storages)

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[Block]:
        """The messages of these topics, or of all: one block per topic and chunk, in file order within it.

        InputError for a topic that is not in the bag.
        """
        return (block for chunk in self.chunks(topics) for block in chunk.blocks() if len(block))


def open_bag(path: str | Path) -> BagReader:
    """Open a .mcap or .db3 file or a recording's directory.

    InputError, with the file and a remedy, if it is no ROS 2 bag: ROS 1, another serialization than CDR, compression by
    file or message, several recordings in one directory, no such file.
    """
    path = Path(path)
    warnings: list[str] = []
    storages: list[Storage] = []
    try:
        files = files_of_directory(path, warnings) if path.is_dir() else [path]
        kinds = {kind_of(file) for file in files}
        if len(kinds) > 1:
            raise InputError(f"{path}: both MCAP and sqlite3 files, but a recording has one kind: give one file")
        (kind,) = kinds
        storages.extend(_STORAGES[kind](file, warnings) for file in files)
    except OSError as error:
        _close_all(storages)
        near = did_you_mean_file(path) or ": check the path"
        raise InputError(f"{error.filename or path}: cannot be read ({error.strerror}){near}") from None
    except BaseException:
        _close_all(storages)
        raise
    return BagReader(path, files, kind, storages, warnings)


def imu_blocks(
    reader: BagReader,
    topics: Iterable[str],
    time: str | Mapping[str, str] = "header",
    gyro: bool = False,
    within: LogTimes | None = None,
) -> Iterator[tuple[str, LoggedImu]]:
    """Decoded samples of these Imu topics, in parallel: an iterator of (topic, block).

    Angular velocities are decoded with `gyro` only. within: as `BagReader.chunks`.

    Blocks are cut at multiples of 0.25 s of log time: all topics' samples of one such slot come before any of the
    next, independent of the chunks of the bag. Within a chunk the samples of a topic stay in file order; one logged
    earlier than its predecessor belongs to the predecessor's slot. stamps_ns are the header's or, with time "log", the
    recorder's; a mapping sets the time by topic.
    InputError for an unknown time, a topic not in the bag or of another type, or a message that cannot be decoded.
    """
    names = tuple(dict.fromkeys(topics))
    times = dict.fromkeys(names, time) if isinstance(time, str) else {name: time[name] for name in names}
    if wrong := [value for value in times.values() if value not in ("header", "log")]:
        raise InputError(f"time is {wrong[0]!r}: use 'header' for the header stamps or 'log' for the recorder's times")
    for topic in reader.topics:
        if topic.name in names and topic.type != IMU_TYPE:
            raise InputError(f"{reader.path}: topic {topic.name} is {topic.type}, {IMU_TYPE} is needed: map another")
    by_log = frozenset(name for name in names if times[name] == "log")
    return _sliced(reader, names, reader.chunks(names, within), by_log, gyro)


def _sliced(
    reader: BagReader, names: tuple[str, ...], chunks: Iterable[Chunk], by_log: frozenset[str], gyro: bool
) -> Iterator[tuple[str, LoggedImu]]:
    waiting: list[_Run] = []
    for chunk in chunks:
        # No later chunk has messages before this chunk's first slot: every topic is complete up to there.
        yield from _advance(waiting, names, chunk.start_ns // SLICE_NS)
        block, log_ns, runs = _decoded(reader, chunk, gyro), chunk.log_ns, list(_runs(chunk))
        del chunk  # the next one reuses its memory, which is a third faster than new memory
        for name, slot, first_ns, lo, hi in runs:
            header, log = block.stamps_ns[lo:hi], log_ns[lo:hi]
            stamps = log if name in by_log else header
            rates = None if block.gyro_radps is None else block.gyro_radps[lo:hi]
            part = LoggedImu(stamps, block.accel_mps2[lo:hi], rates, header, log)
            waiting.append((slot, names.index(name), first_ns, part))
    yield from _advance(waiting, names, None)


def _runs(chunk: Chunk) -> Iterator[tuple[str, int, int, int, int]]:
    """(topic, slot, log time, first row, end row) for the stretches of a chunk within one topic and slot.

    Slot and time are those of the first row, or of an earlier run of the topic where they would fall behind it.
    """
    slots = chunk.log_ns // SLICE_NS
    cuts = np.flatnonzero(slots[1:] != slots[:-1]) + 1
    for (name, _), start, end in zip(chunk.keys, chunk.edges, chunk.edges[1:], strict=False):
        lo, hi = np.searchsorted(cuts, (start, end), side="right")
        edges = [start, *cuts[lo:hi].tolist(), end]
        slot, first_ns = _NEVER, _NEVER
        for first, stop in pairwise(edges):
            if stop > first:
                slot, first_ns = max(slot, int(slots[first])), max(first_ns, int(chunk.log_ns[first]))
                yield name, slot, first_ns, first, stop


def _advance(waiting: list[_Run], names: tuple[str, ...], end_slot: int | None) -> Iterator[tuple[str, LoggedImu]]:
    """Yield and remove the runs in slots before end_slot, or all, slot by slot over the topics."""
    waiting.sort(key=itemgetter(0, 1, 2))
    n = len(waiting) if end_slot is None else bisect_left(waiting, end_slot, key=itemgetter(0))
    ready = waiting[:n]
    del waiting[:n]
    for (_, topic), runs in groupby(ready, key=itemgetter(0, 1)):
        parts = [part for _, _, _, part in runs]
        yield names[topic], parts[0] if len(parts) == 1 else _concatenated(parts)


def _concatenated(parts: list[LoggedImu]) -> LoggedImu:
    header, log = (np.concatenate(column) for column in zip(*((p.header_ns, p.log_ns) for p in parts), strict=True))
    rates = [part.gyro_radps for part in parts if part.gyro_radps is not None]
    return LoggedImu(
        header if parts[0].stamps_ns is parts[0].header_ns else log,
        np.concatenate([part.accel_mps2 for part in parts]),
        np.concatenate(rates) if rates else None,
        header,
        log,
    )


def _decoded(reader: BagReader, chunk: Chunk, gyro: bool) -> ImuBlock:
    """All messages of a chunk in one decoding."""
    try:
        return decode_imu_in(chunk.buffer, chunk.offsets, chunk.lengths, gyro)
    except InputError:
        _raise_for_topic(reader, chunk)
        raise


def _raise_for_topic(reader: BagReader, chunk: Chunk) -> None:
    """Decode a chunk that failed again by topic; raises InputError with the topic that fails."""
    for part in chunk.blocks():
        try:
            decode_imu_in(part.buffer, part.offsets, part.lengths)
        except InputError as error:
            raise InputError(f"{reader.path}: topic {part.topic}: {error}") from None


def _seams(files: Sequence[Path], storages: Sequence[Storage]) -> Iterator[str]:
    """A line for each file of a split recording that does not begin where the one before it ends."""
    for (file, one), (next_file, other) in pairwise(zip(files, storages, strict=True)):
        if one.end_ns is None or other.start_ns is None:
            continue
        gap_s = 1e-9 * (other.start_ns - one.end_ns)
        if gap_s > SEAM_S:
            yield f"{next_file.name} begins {gap_s:.1f} s after the end of {file.name}: a part is missing"
        elif gap_s < -SEAM_S:
            yield f"{next_file.name} begins {-gap_s:.1f} s before the end of {file.name}: was a clock set?"


def _close_all(storages: list[Storage]) -> None:
    for part in storages:
        part.close()
