"""Rosbag2 recordings in and out, whole chunks at a time, without ROS.

    with open_bag("drive") as bag:
        for topic, block in imu_blocks(bag, ["imu/seat/data", "imu/head/data"]):
            ...

A bag is a .mcap or .db3 file, or the directory of a recording, with or without its metadata.yaml, split or not.
Memory is that of a chunk or two, whatever the length of the bag.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import yaml

from biodyn_core.errors import InputError
from biodyn_ros import bag_mcap, bag_sqlite
from biodyn_ros.bag_types import Block, Chunk, Ints, Storage, TopicInfo, TopicKey, refuse_foreign
from biodyn_ros.bag_writer import BagWriter
from biodyn_ros.cdr import IMU_TYPE, ImuBlock, decode_imu_in

__all__ = ["BagReader", "BagWriter", "Block", "Chunk", "TopicInfo", "imu_blocks", "open_bag"]

SLICE_NS: Final = 250_000_000
"""How far in log time one topic may run ahead of the others in `imu_blocks`."""

_STORAGES = {
    bag_mcap.MAGIC: ("mcap", bag_mcap.McapStorage),
    bag_sqlite.MAGIC: ("sqlite3", bag_sqlite.SqliteStorage),
}
_SUFFIXES = (".mcap", ".db3")
_ROS1_MAGIC = b"#ROSBAG V"
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class BagReader:
    """A bag open for reading: what is in it, and its messages in blocks. A context manager, made by `open_bag`.

    storage is "mcap" or "sqlite3"; start_ns and end_ns are log times, None in an empty bag. `recovered` is True for
    an unfinished, cut or damaged bag; `warnings` says what was missing or left out, and may grow while reading.
    """

    def __init__(self, path: Path, storage: str, storages: list[Storage], warnings: list[str]) -> None:
        self.path, self.storage, self.warnings = path, storage, warnings
        self._storages = storages
        counts: dict[TopicKey, int] = {}
        for topic in (topic for part in storages for topic in part.topics):
            counts[topic.name, topic.type] = counts.get((topic.name, topic.type), 0) + topic.messages
        self.topics = tuple(TopicInfo(name, kind, n) for (name, kind), n in counts.items())
        self.message_count = sum(counts.values())
        self.start_ns = min((part.start_ns for part in storages if part.start_ns is not None), default=None)
        self.end_ns = max((part.end_ns for part in storages if part.end_ns is not None), default=None)

    def __enter__(self) -> BagReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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

    def chunks(self, topics: Iterable[str] | None = None) -> Iterator[Chunk]:
        """The messages of these topics, or of all, chunk by chunk in the order of log time.

        InputError for a topic that is not in the bag.
        """
        known = {topic.name for topic in self.topics}
        wanted = known if topics is None else frozenset(topics)
        if missing := sorted(wanted - known):
            there = ", ".join(sorted(known)) or "none"
            raise InputError(f"{self.path}: topic {missing[0]} is not in the bag; topics there: {there}")
        return (chunk for part in self._storages for chunk in part.chunks(frozenset(wanted)))

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[Block]:
        """The messages of these topics, or of all: one block per topic and chunk, in file order within it.

        InputError for a topic that is not in the bag.
        """
        return (block for chunk in self.chunks(topics) for block in chunk.blocks() if len(block))


def open_bag(path: str | Path) -> BagReader:
    """Open a .mcap or .db3 file or a recording's directory.

    InputError, naming the file and what to do, for what is no ROS 2 bag: ROS 1, another serialization than CDR,
    compression by file or message, several recordings in one directory, nothing there.
    """
    path = Path(path)
    warnings: list[str] = []
    storages: list[Storage] = []
    try:
        files = _files_of_directory(path, warnings) if path.is_dir() else [path]
        kinds = [_kind_of(file) for file in files]
        if len({name for name, _ in kinds}) > 1:
            raise InputError(f"{path}: both MCAP and sqlite3 files, one recording has one kind: name one file")
        for file, (_, make) in zip(files, kinds, strict=True):
            storages.append(make(file, warnings))
    except OSError as error:
        _close_all(storages)
        raise InputError(f"{error.filename or path}: cannot be read ({error.strerror}): check the path") from None
    except BaseException:
        _close_all(storages)
        raise
    return BagReader(path, kinds[0][0], storages, warnings)


def imu_blocks(reader: BagReader, topics: Iterable[str], time: str = "header") -> Iterator[tuple[str, ImuBlock]]:
    """Decoded samples of these Imu topics, which advance together: (topic, block), over and over.

    Blocks are cut at multiples of 0.25 s of log time: all topics' samples of one such slot come before any of the
    next, however the bag is chunked. Samples of a topic stay in file order; one logged earlier than its predecessor
    belongs to the predecessor's slot. time "log" replaces the header stamps by log times.
    InputError for an unknown time, a topic not in the bag or of another type, or a message that cannot be decoded.
    """
    names = tuple(dict.fromkeys(topics))
    if time not in ("header", "log"):
        raise InputError(f"time is {time!r}: use 'header' for the messages' own stamps or 'log' for the recorder's")
    for topic in reader.topics:
        if topic.name in names and topic.type != IMU_TYPE:
            raise InputError(f"{reader.path}: topic {topic.name} is {topic.type}, {IMU_TYPE} is needed: map another")
    return _sliced(reader, names, reader.chunks(names), time)


@dataclass(frozen=True, eq=False)
class _Waiting:
    """Samples of one topic not yet yielded, and the slot of each, never falling: int64 (n,)."""

    slots: Ints
    block: ImuBlock

    def part(self, lo: int, hi: int) -> ImuBlock:
        block = self.block
        return ImuBlock(block.stamps_ns[lo:hi], block.accel_mps2[lo:hi], block.gyro_radps[lo:hi])


def _sliced(
    reader: BagReader, names: tuple[str, ...], chunks: Iterable[Chunk], time: str
) -> Iterator[tuple[str, ImuBlock]]:
    waiting: dict[str, _Waiting] = {}
    for chunk in chunks:
        # Nothing before the chunk's first slot can follow any more: that much of every topic is complete.
        yield from _advance(waiting, names, chunk.start_ns // SLICE_NS)
        for name, more in _decoded(reader, chunk, time):
            waiting[name] = _appended(waiting.get(name), more)
    yield from _advance(waiting, names, None)


def _advance(
    waiting: dict[str, _Waiting], names: tuple[str, ...], end_slot: int | None
) -> Iterator[tuple[str, ImuBlock]]:
    """Yield and forget the samples in slots before end_slot, slot by slot, or all of them."""
    parts: list[tuple[int, str, ImuBlock]] = []
    for name in names:
        if name not in waiting:
            continue
        item = waiting[name]
        ready = len(item.slots) if end_slot is None else int(np.searchsorted(item.slots, end_slot))
        edges = [0, *(np.flatnonzero(np.diff(item.slots[:ready])) + 1).tolist(), ready] if ready else []
        parts += [(int(item.slots[lo]), name, item.part(lo, hi)) for lo, hi in zip(edges, edges[1:], strict=False)]
        waiting[name] = _Waiting(item.slots[ready:], item.part(ready, len(item.slots)))
    parts.sort(key=lambda part: part[0])
    yield from ((name, block) for _, name, block in parts)


def _decoded(reader: BagReader, chunk: Chunk, time: str) -> Iterator[tuple[str, _Waiting]]:
    """All messages of a chunk in one decoding, then cut by topic."""
    try:
        block = decode_imu_in(chunk.buffer, chunk.offsets, chunk.lengths)
    except InputError:
        _name_culprit(reader, chunk)
        raise
    if time == "log":
        block = ImuBlock(chunk.log_ns, block.accel_mps2, block.gyro_radps)
    slots = chunk.log_ns // SLICE_NS
    whole = _Waiting(slots, block)
    for (name, _), lo, hi in zip(chunk.keys, chunk.edges, chunk.edges[1:], strict=False):
        if hi > lo:
            yield name, _Waiting(np.maximum.accumulate(slots[lo:hi]), whole.part(lo, hi))


def _name_culprit(reader: BagReader, chunk: Chunk) -> None:
    """Decode a chunk that failed once more, topic by topic, to say which one it was."""
    for part in chunk.blocks():
        try:
            decode_imu_in(part.buffer, part.offsets, part.lengths)
        except InputError as error:
            raise InputError(f"{reader.path}: topic {part.topic}: {error}") from None


def _appended(before: _Waiting | None, more: _Waiting) -> _Waiting:
    if before is None or not len(before.slots):
        return more
    slots = np.concatenate((before.slots, np.maximum(more.slots, before.slots[-1])))
    a, b = before.block, more.block
    block = ImuBlock(
        np.concatenate((a.stamps_ns, b.stamps_ns)),
        np.concatenate((a.accel_mps2, b.accel_mps2)),
        np.concatenate((a.gyro_radps, b.gyro_radps)),
    )
    return _Waiting(slots, block)


# Finding the files of a bag.


def _close_all(storages: list[Storage]) -> None:
    for part in storages:
        part.close()


def _kind_of(file: Path) -> tuple[str, Any]:
    """Storage name and back-end of a file, by its first bytes."""
    with file.open("rb") as stream:
        head = stream.read(16)
    for magic, kind in _STORAGES.items():
        if head.startswith(magic):
            return kind
    if head.startswith(_ROS1_MAGIC):
        raise InputError(f"{file}: a ROS 1 bag, only ROS 2 bags can be read: convert it with rosbags-convert")
    if head.startswith(_ZSTD_MAGIC):
        raise InputError(f"{file}: a compressed file: decompress it first (zstd -d) and open the result")
    if not head:
        raise InputError(f"{file}: the file is empty: nothing was recorded")
    raise InputError(f"{file}: neither an MCAP nor a sqlite3 file: give a .mcap, a .db3 or a rosbag2 directory")


def _files_of_directory(path: Path, warnings: list[str]) -> list[Path]:
    """The storage files of a recording in order: by metadata.yaml where that can be believed, else as found."""
    found = sorted((f for f in path.iterdir() if f.suffix in _SUFFIXES and f.is_file()), key=_split_order)
    if (path / "metadata.yaml").is_file():
        info = _bag_information(path / "metadata.yaml", warnings)
        if info is not None:
            return _named_files(path, info, found, warnings)
    _refuse_several_recordings(path, found)
    return found


def _bag_information(file: Path, warnings: list[str]) -> dict[str, Any] | None:
    """The content of metadata.yaml; None, with a warning, where it is broken, as after a full disk."""
    try:
        info = yaml.safe_load(file.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        names = info["relative_file_paths"]
        formats = [
            (str(t["topic_metadata"]["name"]), str(t["topic_metadata"]["serialization_format"]))
            for t in info["topics_with_message_count"]
        ]
        mode = str(info.get("compression_mode") or "none").lower()
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError):
        warnings.append(f"{file}: not readable as rosbag2 metadata: the files beside it are used as they are")
        return None
    if mode != "none":
        raise InputError(f"{file}: compressed by {mode}: rewrite the bag with 'ros2 bag convert', zstd in MCAP is fine")
    refuse_foreign(file, formats, [])
    return {"names": [Path(str(name)).name for name in names]}


def _named_files(path: Path, info: dict[str, Any], found: list[Path], warnings: list[str]) -> list[Path]:
    """The files metadata.yaml names; when it names none that exists, what lies there instead, with a warning."""
    named = [path / name for name in info["names"]]
    there = [file for file in named if file.is_file()]
    missing = [file.name for file in named if file not in there]
    if there:
        warnings.extend(f"{path}: {name} is missing: its part of the recording is left out" for name in missing)
        return there
    if found and missing:
        _refuse_several_recordings(path, found)
        others = ", ".join(file.name for file in found)
        warnings.append(f"{path}: metadata.yaml names {missing[0]}, which is missing: {others} is read instead")
        return found
    _refuse_several_recordings(path, found)
    return found


def _split_order(file: Path) -> tuple[str, int]:
    """drive_2.mcap before drive_10.mcap."""
    stem, number = _stem_and_number(file)
    return stem, number


def _stem_and_number(file: Path) -> tuple[str, int]:
    match = re.fullmatch(r"(.*)_(\d+)", file.stem)
    return (match[1], int(match[2])) if match else (file.stem, -1)


def _refuse_several_recordings(path: Path, found: list[Path]) -> None:
    """InputError unless the files are the splits of one recording: name_0, name_1, ..."""
    if not found:
        if any(path.glob("*.bag")):
            raise InputError(f"{path}: a ROS 1 bag, only ROS 2 bags can be read: convert it with rosbags-convert")
        if any(path.glob("*.zstd")):
            raise InputError(f"{path}: files compressed as a whole: decompress them first (zstd -d)")
        raise InputError(f"{path}: no .mcap or .db3 file in the directory: give a bag or the directory of one")
    if len({_stem_and_number(file)[0] for file in found}) > 1:
        names = ", ".join(file.name for file in found)
        raise InputError(f"{path}: several recordings and no metadata.yaml that fits: name one of {names}")
