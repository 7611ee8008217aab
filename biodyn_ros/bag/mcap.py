"""Reads MCAP files chunk by chunk: one read and one decompression per chunk, numpy views of its message index.

A finished file is read by its summary. A file without a summary, or with one that does not cover every message (cut,
still being written, messages outside of chunks), is scanned from the start, and every complete chunk is used.

Every length in the file is checked before use. Files are not memory-mapped: a mapped file that shrinks kills the
process, and its pages count as memory of the process.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.bag import mcap_records as records
from biodyn_ros.bag.mcap_records import DamagedError
from biodyn_ros.bag.storage import (
    OFFERED_QOS,
    Chunk,
    LogTimes,
    TopicKey,
    grouped,
    latched_depth,
    refuse_foreign,
    require,
    topic_infos,
)

MAGIC = b"\x89MCAP0\r\n"

_FOOTER_BYTES = 9 + 20 + len(MAGIC)

_LOOSE_BYTES = 1 << 20


@dataclass(frozen=True)
class _Piece:
    """A part of the file with messages: a chunk record and its index, or consecutive records outside of chunks.

    channels are those with messages in it. index_bytes is 0 if there is no complete index.
    """

    offset: int
    length: int
    index_bytes: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]
    loose: bool = False

    def overlaps(self, within: LogTimes) -> bool:
        """Whether it may have messages between these log times."""
        return self.start_ns <= within[1] and within[0] <= self.end_ns


class McapStorage:
    """One MCAP file, open for reading; see `storage.Storage`. Raises InputError if it is no ROS 2 MCAP file."""

    def __init__(self, path: Path, warnings: list[str]) -> None:
        self._records = require("mcap.records")
        self._stream = require("mcap.data_stream").ReadDataStream
        self._error = require("mcap.exceptions").McapError
        self._path, self._warnings = path, warnings
        self._file: BinaryIO = path.open("rb")
        self._size = path.stat().st_size
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}
        self._metadata: dict[str, tuple[int, int]] = {}
        self._counts: Counter[int] = Counter()
        self._pieces: list[_Piece] = []
        self.recovered = False
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def metadata(self, name: str) -> dict[str, str]:
        """The metadata record of that name, empty if there is none or it is damaged."""
        try:
            return dict(self._parse("Metadata", self._read(*self._metadata[name])[9:]).metadata)
        except (KeyError, DamagedError):
            return {}

    def chunks(self, topics: frozenset[str], within: LogTimes | None = None) -> Iterator[Chunk]:
        """The messages of these topics, chunk by chunk in the order of log time; damaged chunks give a warning.

        within: chunks without messages between these log times are skipped, unread.
        """
        keys = tuple((t.name, t.type) for t in self.topics if t.name in topics)
        place = {key: k for k, key in enumerate(keys)}
        group_of = {c: place[key] for c in self._channels if (key := self._key(c)) in place}
        for piece in self._pieces:
            if piece.channels.isdisjoint(group_of) or (within and not piece.overlaps(within)):
                continue
            try:
                yield self._chunk(piece, keys, group_of)
            except DamagedError as damage:
                self._omit(piece, damage)

    def _omit(self, piece: _Piece, damage: DamagedError) -> None:
        self.recovered = True
        text = f"{self._path}: the chunk at byte {piece.offset} is damaged and omitted: {damage}"
        if text not in self._warnings:  # a bag may be read more than once
            self._warnings.append(text)

    # Opening: by the summary, or by a scan.

    def _open(self) -> None:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise InputError(f"{self._path}: not an MCAP file, the first bytes are not {MAGIC!r}: check the file")
        try:
            self._load_summary()
        except DamagedError:
            self._scan_or_refuse()
        channels = self._channels.values()
        refuse_foreign(self._path, {c.topic: c.message_encoding for c in channels}.items(), self._warnings)
        self._channels = {i: c for i, c in self._channels.items() if c.message_encoding == "cdr"}
        self._pieces.sort(key=lambda piece: piece.start_ns)
        counts: Counter[TopicKey] = Counter({self._key(c): 0 for c in self._channels})
        for channel in self._channels:
            counts[self._key(channel)] += self._counts[channel]
        latched = {self._key(i): latched_depth(c.metadata.get(OFFERED_QOS)) for i, c in self._channels.items()}
        self.topics = topic_infos(counts, latched)
        self.start_ns = min((piece.start_ns for piece in self._pieces), default=None)
        self.end_ns = max((piece.end_ns for piece in self._pieces), default=None)
        if self.recovered:
            self._report_recovery()

    def _scan_or_refuse(self) -> None:
        try:
            self._scan()
        except DamagedError as damage:
            raise InputError(f"{self._path}: cannot be recovered: {damage}; record again") from None

    def _report_recovery(self) -> None:
        if self.start_ns is None or self.end_ns is None:
            raise InputError(f"{self._path}: cut before its first complete chunk, nothing to recover: record again")
        count, seconds = sum(t.messages for t in self.topics), (self.end_ns - self.start_ns) / 1e9
        self._warnings.append(
            f"{self._path}: unfinished or cut: recovered {counted(count, 'message')},"
            f" up to {seconds:.3f} s after the first"
        )

    def _load_summary(self) -> None:
        """Read channels, chunks and counts from the summary; DamagedError unless it covers every message."""
        footer_at = self._size - _FOOTER_BYTES
        if footer_at < len(MAGIC):
            raise DamagedError("no footer")
        footer = self._read(footer_at, _FOOTER_BYTES)
        opcode, length, start, _, crc = struct.unpack_from("<BQQQI", footer)
        if (opcode, length) != (records.FOOTER, 20) or footer[-8:] != MAGIC or not len(MAGIC) <= start <= footer_at:
            raise DamagedError("no summary")
        summary = self._read(start, footer_at - start)
        if crc and zlib.crc32(footer[:25], zlib.crc32(summary)) != crc:
            raise DamagedError("summary checksum")
        statistics = None
        for opcode, lo, hi in records.walk(summary):
            if opcode == records.CHUNK_INDEX:
                self._pieces.append(self._indexed_piece(summary[lo:hi]))
            elif opcode == records.STATISTICS:
                statistics = self._parse("Statistics", summary[lo:hi])
            elif opcode == records.METADATA_INDEX:
                index = self._parse("MetadataIndex", summary[lo:hi])
                self._metadata[index.name] = (index.offset, index.length)
            else:
                self._note_definition(opcode, summary[lo:hi])
        self._check_summary(statistics)

    def _check_summary(self, statistics: Any) -> None:
        """Compare the counts: a MessageIndex record has 15 bytes and 16 per message, so its size gives the count."""
        indexed = sum((p.index_bytes - 15 * len(p.channels)) // 16 for p in self._pieces)
        known = all(p.channels <= self._channels.keys() for p in self._pieces)
        if statistics is None or not known or statistics.message_count != indexed:
            raise DamagedError("summary without all messages")
        self._counts.update(statistics.channel_message_counts)
        if self._counts.total() != indexed:
            raise DamagedError("summary without all counts")
        self._pieces = [p for p in self._pieces if p.channels]

    def _indexed_piece(self, body: bytes) -> _Piece:
        """A ChunkIndex record; unpacked here because a long bag has thousands of them."""
        try:
            start_ns, end_ns, offset, length, map_bytes = records.CHUNK_INDEX_HEAD.unpack_from(body)
            at = records.CHUNK_INDEX_HEAD.size
            channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", body[at : at + map_bytes]))
            (index_bytes,) = struct.unpack_from("<Q", body, at + map_bytes)
        except struct.error:
            raise DamagedError("chunk index") from None
        if offset + length + index_bytes > self._size:
            raise DamagedError("chunk outside the file")
        return _Piece(offset, length, index_bytes, start_ns, end_ns, channels)

    def _scan(self) -> None:
        """Read channels, chunks and counts from the records, up to DataEnd or the end of the file."""
        self._channels, self._metadata, self._counts, self._pieces = {}, {}, Counter(), []
        opcode = 0
        for opcode, at, end in self._records_of_file():
            if opcode == records.CHUNK:
                self._pieces.append(self._bare_piece(at, end))
            elif opcode == records.MESSAGE_INDEX:
                self._extend_index(at, end)
            elif opcode == records.MESSAGE:
                self._extend_loose(at, end)
            elif opcode == records.METADATA:
                name_bytes = self._read(at + 9, min(end - at - 9, 4096))
                self._metadata[records.prefixed(name_bytes)] = (at, end - at)
            elif opcode in (records.SCHEMA, records.CHANNEL):
                self._note_definition(opcode, self._read(at + 9, end - at - 9))
        ended = opcode == records.DATA_END
        self.recovered = not (ended and self._read(self._size - len(MAGIC), len(MAGIC)) == MAGIC)
        if not ended and self._pieces and not self._pieces[-1].loose:
            self._forget_index(len(self._pieces) - 1)
        self._look_into_chunks()

    def _records_of_file(self) -> Iterator[tuple[int, int, int]]:
        """(opcode, start, end) of the complete records up to DataEnd."""
        at = len(MAGIC)
        while at + 9 <= self._size:
            opcode, length = records.RECORD.unpack(self._read(at, 9))
            if length > self._size - at - 9 or opcode in (0, records.FOOTER):
                return
            yield opcode, at, at + 9 + length
            at += 9 + length
            if opcode == records.DATA_END:
                return

    def _bare_piece(self, at: int, end: int) -> _Piece:
        head = self._read(at + 9, min(end - at - 9, records.CHUNK_HEAD.size))
        start_ns, end_ns = struct.unpack_from("<qq", head.ljust(16, b"\0"))
        return _Piece(at, end - at, 0, start_ns, end_ns, frozenset())

    def _extend_index(self, at: int, end: int) -> None:
        """Add a MessageIndex record to its chunk, the last piece; a record elsewhere is ignored."""
        last = self._pieces[-1] if self._pieces else None
        if last is None or last.loose or last.offset + last.length + last.index_bytes != at or end - at < 15:
            return
        (channel,) = struct.unpack("<H", self._read(at + 9, 2))
        channels = last.channels | {channel} if end - at > 15 else last.channels
        self._counts[channel] += (end - at - 15) // 16
        self._pieces[-1] = replace(last, index_bytes=last.index_bytes + end - at, channels=channels)

    def _extend_loose(self, at: int, end: int) -> None:
        """Add a message outside of chunks to the preceding run, or start a new run of up to 1 MiB."""
        if end - at < records.MESSAGE_HEAD.size:
            return
        _, _, channel, _, log_ns, _ = records.MESSAGE_HEAD.unpack(self._read(at, records.MESSAGE_HEAD.size))
        self._counts[channel] += 1
        last = self._pieces[-1] if self._pieces else None
        if last is None or not last.loose or last.offset + last.length != at or last.length > _LOOSE_BYTES:
            self._pieces.append(_Piece(at, end - at, 0, log_ns, log_ns, frozenset((channel,)), loose=True))
            return
        first_ns, last_ns, channels = min(last.start_ns, log_ns), max(last.end_ns, log_ns), last.channels | {channel}
        self._pieces[-1] = replace(
            last, length=last.length + end - at, start_ns=first_ns, end_ns=last_ns, channels=channels
        )

    def _forget_index(self, i: int) -> None:
        """Remove the index of piece i, which is incomplete if the file ends after the chunk."""
        piece = self._pieces[i]
        for channel, entries in records.index_entries(self._read(piece.offset + piece.length, piece.index_bytes)):
            self._counts[channel] -= len(entries)
        self._pieces[i] = replace(piece, index_bytes=0, channels=frozenset())

    def _look_into_chunks(self) -> None:
        """Count the messages of chunks without index, and find the channels defined inside of chunks."""
        unknown = self._counts.keys() - self._channels.keys()
        for i, piece in enumerate(self._pieces):
            bare = not piece.index_bytes
            if piece.loose or not (bare or unknown):
                continue
            try:
                found = self._counted(self._chunk_data(self._read(piece.offset, piece.length)))
            except DamagedError as damage:
                self._omit(piece, damage)
                self._forget_index(i)
                continue
            if bare:
                self._counts.update(found)
                self._pieces[i] = replace(piece, channels=frozenset(found))
            unknown -= self._channels.keys()
        self._pieces = [piece for piece in self._pieces if piece.channels]

    def _counted(self, data: bytes | memoryview) -> Counter[int]:
        """Messages per channel in a chunk's data; notes the schemas and channels in it."""
        counts: Counter[int] = Counter()
        for opcode, lo, hi in records.walk(data):
            if opcode == records.MESSAGE and hi - lo >= 22:
                counts[data[lo] | data[lo + 1] << 8] += 1
            elif opcode in (records.SCHEMA, records.CHANNEL):
                self._note_definition(opcode, bytes(data[lo:hi]))
        return counts

    def _note_definition(self, opcode: int, body: bytes) -> None:
        if opcode == records.SCHEMA:
            schema = self._parse("Schema", body)
            self._schemas[schema.id] = schema
        elif opcode == records.CHANNEL:
            channel = self._parse("Channel", body)
            self._channels[channel.id] = channel

    # Reading a chunk.

    def _chunk(self, piece: _Piece, keys: tuple[TopicKey, ...], group_of: dict[int, int]) -> Chunk:
        raw = self._read(piece.offset, piece.length + piece.index_bytes)
        data = raw if piece.loose else self._chunk_data(memoryview(raw)[: piece.length])
        buffer = np.frombuffer(data, dtype=np.uint8)
        if piece.index_bytes:
            entries = [e for e in records.index_entries(raw[piece.length :]) if e[0] in group_of and len(e[1])]
            chunk = records.by_index(piece.start_ns, buffer, entries, keys, group_of)
            if chunk is not None:
                return chunk
        return grouped(piece.start_ns, buffer, keys, *records.by_walking(data, group_of))

    def _chunk_data(self, record: bytes | memoryview) -> bytes | memoryview:
        return records.chunk_data(record, self._path)

    def _read(self, at: int, length: int) -> bytes:
        self._file.seek(at)
        data = self._file.read(length) if at + length <= self._size else b""
        if len(data) != length:
            raise DamagedError(f"the file ends before byte {at + length}")
        return data

    def _parse(self, record: str, body: bytes) -> Any:
        try:
            return getattr(self._records, record).read(self._stream(BytesIO(body)))
        except (self._error, struct.error, ValueError) as error:
            raise DamagedError(f"{record} record: {error}") from None

    def _key(self, channel_id: int) -> TopicKey:
        channel = self._channels[channel_id]
        schema = self._schemas.get(channel.schema_id)
        return channel.topic, schema.name if schema else ""
