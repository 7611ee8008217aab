"""Writes MCAP bags from arrays: numpy assembles whole chunks, without a loop over messages.

Blocks are buffered until all topics have passed a time, are sorted by log time, and are cut into chunks. The messages
of the file are then in order of log time.
"""

from __future__ import annotations

import os
import shutil
import struct
import zlib
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from biodyn_core.base.arrays import Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.bag.cdr import scatter
from biodyn_ros.bag.mcap import MAGIC
from biodyn_ros.bag.storage import Bytes, require

COMPRESSIONS: Final = ("none", "lz4", "zstd")

_MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_ns", "<i8"),
        ("publish_ns", "<i8"),
    ]
)
_MAX_PENDING_BYTES = 64 << 20
_NEVER = -(2**63)


@dataclass(frozen=True, eq=False)
class _Pending:
    """Messages of one topic not yet in a chunk: log times int64 (n,), payloads void (n,), sequence numbers."""

    channel: int
    log_ns: Integers
    payload: NDArray[np.void]
    sequence: NDArray[np.uint32]

    def rows(self, which: Integers) -> _Pending:
        """Some of the messages; a view if they are consecutive."""
        pick = slice(int(which[0]), int(which[-1]) + 1) if (which[1:] - which[:-1] == 1).all() else which
        return replace(self, log_ns=self.log_ns[pick], payload=self.payload[pick], sequence=self.sequence[pick])

    @property
    def nbytes(self) -> int:
        return len(self.log_ns) * (_MESSAGE_HEAD.itemsize + self.payload.itemsize)


@dataclass
class _Written:
    """The content of the summary."""

    schemas: dict[str, Any] = field(default_factory=dict)
    channels: dict[str, Any] = field(default_factory=dict)
    hashes: dict[str, str] = field(default_factory=dict)
    chunk_indexes: list[Any] = field(default_factory=list)
    metadata_indexes: list[Any] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int | None = None


class BagWriter:
    """Writes a bag: a single file for a path that ends in .mcap, else a rosbag2 directory. A context manager.

    The bag is written under a temporary name beside the path and renamed when it is closed; after an exception it is
    removed. compression is "none", "lz4" or "zstd"; chunk_bytes is the uncompressed size of a chunk.
    InputError for an unknown compression, a path that exists (unless overwrite), and, when it is entered, a path that
    cannot be written.
    """

    def __init__(
        self, path: str | Path, compression: str = "zstd", chunk_bytes: int = 1 << 20, overwrite: bool = False
    ) -> None:
        self._path = Path(path)
        if self._path.suffix == ".db3":
            raise InputError(f"{path}: only MCAP can be written: end the name with .mcap, or give a directory")
        if self._path.exists() and not overwrite:
            raise InputError(f"{path}: exists already: choose another name or remove it")
        self._compression, self._compress = "" if compression == "none" else compression, _compressor(compression)
        self._chunk_bytes = chunk_bytes
        self._records, self._builder = require("mcap.records"), require("mcap.data_stream").RecordBuilder
        self._written = _Written()
        self._pending: list[_Pending] = []
        self._pending_bytes = 0
        self._last_ns: dict[int, int] = {}
        self._complete_ns = _NEVER
        self._directory = self._path.suffix != ".mcap"
        self._part = self._path.with_name(f".{self._path.name}.{os.getpid()}.part")
        self._file: BinaryIO  # from __enter__ on

    def __enter__(self) -> BagWriter:
        """Open the bag; an interruption at any point leaves no file."""
        try:
            self._file = self._open()
            self._put(MAGIC)
            self._append(self._records.Header(profile="ros2", library="biodyn"))
            return self  # noqa: TRY300 - an interruption may come before this line too
        except BaseException:
            self.discard()
            raise

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def add_topic(self, name: str, message_type: str) -> int:
        """Declare a topic of a ROS 2 Jazzy message type and return its channel id; repeated calls return the same id.

        InputError for an unknown type, or for a topic declared with another type before.
        """
        channels, schemas = self._written.channels, self._written.schemas
        if name in channels and (message_type not in schemas or channels[name].schema_id != schemas[message_type].id):
            raise InputError(f"{self._path}: topic {name} already has another type than {message_type}: use two topics")
        if message_type not in schemas:
            text, type_hash = _definition(message_type)
            schema = self._records.Schema(len(schemas) + 1, text.encode(), "ros2msg", message_type)
            schemas[message_type], self._written.hashes[message_type] = schema, type_hash
            self._append(schema)
        if name not in channels:
            about = {"offered_qos_profiles": "", "topic_type_hash": self._written.hashes[message_type]}
            channel = self._records.Channel(len(channels) + 1, name, "cdr", about, schemas[message_type].id)
            channels[name] = channel
            self._append(channel)
            self._last_ns[channel.id] = _NEVER
        return int(channels[name].id)

    def write(self, topic: str, log_ns: Integers, payload: Bytes) -> None:
        """Append messages of a declared topic: log times int64 (n,), serialized messages uint8 (n, size).

        The arrays are kept, not copied, until their chunk is written: do not change them. Write blocks of the topics
        in turn, some tenths of a second each; the writer does not wait for a topic that is far behind.
        InputError for an undeclared topic or arrays that do not fit.
        """
        block = self._checked(topic, log_ns, payload)
        if not len(block.log_ns):
            return
        self._written.counts[block.channel] += len(block.log_ns)
        self._last_ns[block.channel] = int(block.log_ns[-1])
        self._pending.append(block)
        self._pending_bytes += block.nbytes
        if self._pending_bytes > _MAX_PENDING_BYTES:
            self._flush(None)
            return
        complete_ns = min(self._last_ns.values())
        if self._pending_bytes > 2 * self._chunk_bytes and complete_ns > self._complete_ns:
            self._complete_ns = complete_ns
            self._flush(complete_ns)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Append a metadata record, such as `biodyn` with the provenance; keys and values are text.

        A file name that is not UTF-8 is written with escapes.
        """
        at = self._file.tell()
        self._append(self._records.Metadata(name, {_utf8(key): _utf8(value) for key, value in values.items()}))
        index = self._records.MetadataIndex(at, self._file.tell() - at, name)
        self._written.metadata_indexes.append(index)

    def close(self) -> None:
        """Write pending messages and the summary, and rename the bag; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self._flush(None, whole=False)
            self._finish()
            self._file.close()
            if self._directory:
                (self._part / "metadata.yaml").write_text(self._metadata_yaml(), encoding="utf-8")
            _rename(self._part, self._path)
        except OSError as error:
            self.discard()
            raise self._unwritable(error) from None
        except BaseException:
            self.discard()
            raise

    def discard(self) -> None:
        """Remove the unfinished bag."""
        with suppress(OSError, AttributeError):  # on a full disk the buffered bytes fail again; or it is not open yet
            self._file.close()
        if self._directory:
            shutil.rmtree(self._part, ignore_errors=True)
        else:
            self._part.unlink(missing_ok=True)

    def _open(self) -> BinaryIO:
        try:
            if not self._directory:
                return self._part.open("wb")
            self._part.mkdir()
            return (self._part / f"{self._path.name}_0.mcap").open("wb")
        except OSError as error:
            raise self._unwritable(error) from None

    def _checked(self, topic: str, log_ns: Integers, payload: Bytes) -> _Pending:
        log_ns, payload = np.asarray(log_ns), np.asarray(payload)
        if topic not in self._written.channels:
            raise InputError(f"{self._path}: topic {topic} is not declared: call add_topic first")
        if payload.dtype != np.uint8 or payload.ndim != 2 or payload.shape[1] == 0:
            raise InputError(f"{self._path}: topic {topic}: payload must be uint8 (n, size), not {payload.shape}")
        if log_ns.shape != payload.shape[:1] or log_ns.dtype.kind not in "iu":
            raise InputError(
                f"{self._path}: topic {topic}: {log_ns.shape} log times for {counted(len(payload), 'message')}"
            )
        channel = self._written.channels[topic].id
        first, n = self._written.counts[channel], len(payload)
        void = np.ascontiguousarray(payload).view(f"V{payload.shape[1]}")[:, 0]
        return _Pending(channel, log_ns.astype(np.int64), void, np.arange(first, first + n).astype(np.uint32))

    def _flush(self, before_ns: int | None, whole: bool = True) -> None:
        """Write the pending messages, or those logged before a time, by log time and in whole chunks."""
        if not self._pending:
            return
        log_ns = np.concatenate([p.log_ns for p in self._pending])
        owner = np.repeat(np.arange(len(self._pending)), [len(p.log_ns) for p in self._pending])
        row = np.concatenate([np.arange(len(p.log_ns)) for p in self._pending])
        sizes = np.array([_MESSAGE_HEAD.itemsize + p.payload.itemsize for p in self._pending])
        order = np.argsort(log_ns, kind="stable")
        if before_ns is not None:
            order = order[: np.searchsorted(log_ns[order], before_ns)]
        chunk_of = np.cumsum(sizes[owner[order]]) // self._chunk_bytes
        edges = [0, *(np.flatnonzero(np.diff(chunk_of)) + 1).tolist()]
        if not whole:
            edges.append(len(order))
        for lo, hi in pairwise(edges):
            self._write_chunk(owner[order[lo:hi]], row[order[lo:hi]])
        self._keep(order[: edges[-1]])

    def _keep(self, taken: Integers) -> None:
        """Drop the written messages, given by their index in the concatenation of all pending ones."""
        left = np.ones(sum(len(p.log_ns) for p in self._pending), dtype=bool)
        left[taken] = False
        kept, end = [], 0
        for block in self._pending:
            end += len(block.log_ns)
            rows = np.flatnonzero(left[end - len(block.log_ns) : end])
            if len(rows):
                kept.append(block.rows(rows))
        self._pending, self._pending_bytes = kept, sum(block.nbytes for block in kept)

    def _write_chunk(self, owner: Integers, row: Integers) -> None:
        """One chunk with its message index: message i is row[i] of pending block owner[i]."""
        head = np.empty(len(owner), dtype=_MESSAGE_HEAD)
        picked = [(np.flatnonzero(owner == k), self._pending[k]) for k in np.unique(owner).tolist()]
        picked = [(at, block.rows(row[at])) for at, block in picked]
        for at, block in picked:
            head["length"][at] = _MESSAGE_HEAD.itemsize - 9 + block.payload.itemsize
            head["channel"][at] = block.channel
            head["sequence"][at] = block.sequence
            head["log_ns"][at] = block.log_ns
        head["opcode"] = 5
        head["publish_ns"] = head["log_ns"]
        sizes = head["length"].astype(np.int64) + 9
        starts = np.cumsum(sizes) - sizes
        data = np.empty(int(sizes.sum()), dtype=np.uint8)
        scatter(data, starts, head.view(f"V{_MESSAGE_HEAD.itemsize}"))
        for at, block in picked:
            scatter(data, starts[at] + _MESSAGE_HEAD.itemsize, block.payload)
        self._append_chunk(data, head["channel"], head["log_ns"], starts)

    def _append_chunk(self, data: Bytes, channel: Integers, log_ns: Integers, starts: Integers) -> None:
        first_ns, last_ns = int(log_ns.min()), int(log_ns.max())
        compressed = self._compress(data)
        chunk_at, name = self._file.tell(), self._compression.encode()
        head = struct.pack("<qqQII", first_ns, last_ns, data.size, zlib.crc32(data.data), len(name)) + name
        head += struct.pack("<Q", len(compressed))
        self._put(struct.pack("<BQ", 0x06, len(head) + len(compressed)) + head)
        self._put(compressed)
        index_at, offsets = self._file.tell(), {}
        entries = np.stack((log_ns, starts), axis=1).astype("<i8")
        for c in np.unique(channel).tolist():
            mine = entries[channel == c]
            offsets[c] = self._file.tell()
            self._put(struct.pack("<BQHI", 0x07, 6 + mine.nbytes, c, mine.nbytes) + mine.tobytes())
        index = self._records.ChunkIndex(
            chunk_start_offset=chunk_at,
            chunk_length=index_at - chunk_at,
            message_start_time=first_ns,
            message_end_time=last_ns,
            message_index_offsets=offsets,
            message_index_length=self._file.tell() - index_at,
            compression=self._compression,
            compressed_size=len(compressed),
            uncompressed_size=data.size,
        )
        done = self._written
        done.chunk_indexes.append(index)
        done.start_ns = first_ns if done.start_ns is None else min(first_ns, done.start_ns)
        done.end_ns = last_ns if done.end_ns is None else max(last_ns, done.end_ns)

    def _append(self, record: Any) -> None:
        builder = self._builder()
        record.write(builder)
        self._put(builder.end())

    def _put(self, data: bytes | memoryview) -> None:
        try:
            self._file.write(data)
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> InputError:
        return InputError(f"{self._path}: cannot be written ({error.strerror}): check the directory and its free space")

    def _finish(self) -> None:
        """Write DataEnd, the summary in groups, the summary offsets, and the footer with the summary's checksum."""
        self._append(self._records.DataEnd(0))
        done, start = self._written, self._file.tell()
        groups = (
            (0x03, list(done.schemas.values())),
            (0x04, list(done.channels.values())),
            (0x0B, [self._statistics()]),
            (0x08, done.chunk_indexes),
            (0x0D, done.metadata_indexes),
        )
        builder, offsets = self._builder(), []
        for opcode, records in groups:
            at = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(self._records.SummaryOffset(opcode, start + at, builder.count - at))
        offsets_at = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.end()
        crc = zlib.crc32(struct.pack("<BQQQ", 0x02, 20, start, offsets_at), zlib.crc32(summary))
        self._put(summary)
        self._append(self._records.Footer(start, offsets_at, crc))
        self._put(MAGIC)

    def _statistics(self) -> Any:
        done = self._written
        return self._records.Statistics(
            message_count=done.counts.total(),
            schema_count=len(done.schemas),
            channel_count=len(done.channels),
            attachment_count=0,
            metadata_count=len(done.metadata_indexes),
            chunk_count=len(done.chunk_indexes),
            message_start_time=done.start_ns or 0,
            message_end_time=done.end_ns or 0,
            channel_message_counts={c.id: done.counts[c.id] for c in done.channels.values()},
        )

    def _metadata_yaml(self) -> str:
        """rosbag2's metadata.yaml, version 9 (Jazzy)."""
        done = self._written
        type_of = {schema.id: name for name, schema in done.schemas.items()}
        topics = [
            {
                "topic_metadata": {
                    "name": name,
                    "type": type_of[channel.schema_id],
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [],
                    "type_description_hash": done.hashes[type_of[channel.schema_id]],
                },
                "message_count": done.counts[channel.id],
            }
            for name, channel in done.channels.items()
        ]
        span = {
            # rosbag2 gives an empty bag the largest time.
            "starting_time": {"nanoseconds_since_epoch": 2**63 - 1 if done.start_ns is None else done.start_ns},
            "duration": {"nanoseconds": (done.end_ns or 0) - (done.start_ns or 0)},
            "message_count": done.counts.total(),
        }
        file = f"{self._path.name}_0.mcap"
        info = {"version": 9, "storage_identifier": "mcap", **span, "topics_with_message_count": topics}
        info |= {"compression_format": "", "compression_mode": "", "relative_file_paths": [file]}
        info |= {"files": [{"path": file, **span}], "custom_data": None, "ros_distro": "jazzy"}
        return yaml.dump({"rosbag2_bagfile_information": info}, sort_keys=False, Dumper=_PlainDumper)


class _PlainDumper(yaml.SafeDumper):
    """Writes no anchors, which some YAML readers do not support."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _compressor(compression: str) -> Callable[[Bytes], bytes | memoryview]:
    if compression == "none":
        return lambda data: data.data
    if compression == "lz4":
        lz4 = require("lz4.frame")
        return lambda data: bytes(lz4.compress(data))
    if compression == "zstd":
        # Level 1: higher levels hardly compress noisy numbers further.
        zstd = require("zstandard").ZstdCompressor(level=1)
        return lambda data: bytes(zstd.compress(data))
    raise InputError(f"compression is {compression!r}: {', '.join(COMPRESSIONS)} are allowed")


@cache
def _typestore() -> Any:
    typesys = require("rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


@cache
def _definition(type_name: str) -> tuple[str, str]:
    """The definition of a message type with its nested types, as ros2msg text, and its RIHS01 hash."""
    store = _typestore()
    if type_name not in store.fielddefs:
        raise InputError(f"message type {type_name} is unknown: the types of ROS 2 Jazzy can be written")
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return text, store.hash_rihs01(type_name)


def _utf8(text: object) -> str:
    """A text that UTF-8 can encode."""
    return str(text).encode("utf-8", "backslashreplace").decode("utf-8")


def _rename(part: Path, path: Path) -> None:
    """Rename the finished bag; a directory that it replaces is removed afterwards."""
    if not path.is_dir():
        part.replace(path)
        return
    aside = path.with_name(part.name + ".old")
    path.replace(aside)
    part.replace(path)
    shutil.rmtree(aside)
