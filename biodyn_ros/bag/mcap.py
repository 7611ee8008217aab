"""MCAP files, chunk by chunk: one read and one decompression per chunk, numpy views of its flat message index.

A finished file is read by its summary. A file without one, or with one that does not account for every message (cut,
still being written, messages outside of chunks), is scanned from the front, and every whole chunk is used.

Every length in the file is checked before it is used. Files are read, not mapped: a mapped file that shrinks kills
the process, and its pages count as memory of the process.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from biodyn_core.arrays import Integers
from biodyn_core.errors import InputError
from biodyn_ros.bag.storage import Bytes, Chunk, TopicInfo, TopicKey, grouped, refuse_foreign, require
from biodyn_ros.cdr import gather

MAGIC = b"\x89MCAP0\r\n"

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07
_CHUNK_INDEX, _STATISTICS, _METADATA, _METADATA_INDEX, _DATA_END = 0x08, 0x0B, 0x0C, 0x0D, 0x0F

_RECORD = struct.Struct("<BQ")
# Log times are unsigned in the file; read as signed they fit int64 until the year 2262.
_CHUNK_HEAD = struct.Struct("<qqQII")
_CHUNK_INDEX_HEAD = struct.Struct("<qqQQI")
_MESSAGE_HEAD = struct.Struct("<BQHIqQ")
_MESSAGE_START = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2")])
_FOOTER_BYTES = 9 + 20 + len(MAGIC)

_LOOSE_BYTES = 1 << 20
_PLAUSIBLE_BYTES = 256 << 20
_PLAUSIBLE_RATIO = 1000


class _DamagedError(Exception):
    """Bytes that cannot be what they claim to be; the reader leaves out the chunk they are in."""


@dataclass(frozen=True)
class _Piece:
    """A stretch of the file with messages: a chunk record and its index, or a run of records outside of chunks.

    channels are those with messages in it. index_bytes is 0 where there is no index to trust.
    """

    offset: int
    length: int
    index_bytes: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]
    loose: bool = False


class McapStorage:
    """One MCAP file, open for reading; see `storage.Storage`. Raises InputError for what is no ROS 2 MCAP."""

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
        except (KeyError, _DamagedError):
            return {}

    def chunks(self, topics: frozenset[str]) -> Iterator[Chunk]:
        """The messages of these topics, chunk by chunk in the order of log time; damaged chunks give a warning."""
        keys = tuple((t.name, t.type) for t in self.topics if t.name in topics)
        place = {key: k for k, key in enumerate(keys)}
        group_of = {c: place[key] for c in self._channels if (key := self._key(c)) in place}
        for piece in self._pieces:
            if piece.channels.isdisjoint(group_of):
                continue
            try:
                yield self._chunk(piece, keys, group_of)
            except _DamagedError as damage:
                self._leave_out(piece, damage)

    def _leave_out(self, piece: _Piece, damage: _DamagedError) -> None:
        self.recovered = True
        text = f"{self._path}: the chunk at byte {piece.offset} is damaged and left out: {damage}"
        if text not in self._warnings:  # a bag may be read more than once
            self._warnings.append(text)

    # Opening: by the summary, or by a scan.

    def _open(self) -> None:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise InputError(f"{self._path}: not an MCAP file, the first bytes are not {MAGIC!r}: check the file")
        try:
            self._load_summary()
        except _DamagedError:
            self._scan_or_refuse()
        channels = self._channels.values()
        refuse_foreign(self._path, {c.topic: c.message_encoding for c in channels}.items(), self._warnings)
        self._channels = {i: c for i, c in self._channels.items() if c.message_encoding == "cdr"}
        self._pieces.sort(key=lambda piece: piece.start_ns)
        counts: Counter[TopicKey] = Counter({self._key(c): 0 for c in self._channels})
        for channel in self._channels:
            counts[self._key(channel)] += self._counts[channel]
        self.topics = tuple(TopicInfo(topic, kind, n) for (topic, kind), n in counts.items())
        self.start_ns = min((piece.start_ns for piece in self._pieces), default=None)
        self.end_ns = max((piece.end_ns for piece in self._pieces), default=None)
        if self.recovered:
            self._tell_recovery()

    def _scan_or_refuse(self) -> None:
        try:
            self._scan()
        except _DamagedError as damage:
            raise InputError(f"{self._path}: damaged beyond recovery: {damage}; record again") from None

    def _tell_recovery(self) -> None:
        if self.start_ns is None or self.end_ns is None:
            raise InputError(f"{self._path}: cut before its first whole chunk, nothing to recover: record again")
        count, seconds = sum(t.messages for t in self.topics), (self.end_ns - self.start_ns) / 1e9
        self._warnings.append(
            f"{self._path}: unfinished or cut: recovered {count} messages, up to {seconds:.3f} s after the first"
        )

    def _load_summary(self) -> None:
        """Channels, chunks and counts by the summary; _DamagedError unless it accounts for every message."""
        footer_at = self._size - _FOOTER_BYTES
        if footer_at < len(MAGIC):
            raise _DamagedError("no footer")
        footer = self._read(footer_at, _FOOTER_BYTES)
        opcode, length, start, _, crc = struct.unpack_from("<BQQQI", footer)
        if (opcode, length) != (_FOOTER, 20) or footer[-8:] != MAGIC or not len(MAGIC) <= start <= footer_at:
            raise _DamagedError("no summary")
        summary = self._read(start, footer_at - start)
        if crc and zlib.crc32(footer[:25], zlib.crc32(summary)) != crc:
            raise _DamagedError("summary checksum")
        statistics = None
        for opcode, lo, hi in _records_in(summary):
            if opcode == _CHUNK_INDEX:
                self._pieces.append(self._indexed_piece(summary[lo:hi]))
            elif opcode == _STATISTICS:
                statistics = self._parse("Statistics", summary[lo:hi])
            elif opcode == _METADATA_INDEX:
                index = self._parse("MetadataIndex", summary[lo:hi])
                self._metadata[index.name] = (index.offset, index.length)
            else:
                self._note_definition(opcode, summary[lo:hi])
        self._check_summary(statistics)

    def _check_summary(self, statistics: Any) -> None:
        """A MessageIndex record is 15 bytes and 16 per message, which gives the count without reading one."""
        indexed = sum((p.index_bytes - 15 * len(p.channels)) // 16 for p in self._pieces)
        known = all(p.channels <= self._channels.keys() for p in self._pieces)
        if statistics is None or not known or statistics.message_count != indexed:
            raise _DamagedError("summary without all messages")
        self._counts.update(statistics.channel_message_counts)
        if self._counts.total() != indexed:
            raise _DamagedError("summary without all counts")
        self._pieces = [p for p in self._pieces if p.channels]

    def _indexed_piece(self, body: bytes) -> _Piece:
        """A ChunkIndex record; unpacked here because a long bag has thousands of them."""
        try:
            start_ns, end_ns, offset, length, map_bytes = _CHUNK_INDEX_HEAD.unpack_from(body)
            at = _CHUNK_INDEX_HEAD.size
            channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", body[at : at + map_bytes]))
            (index_bytes,) = struct.unpack_from("<Q", body, at + map_bytes)
        except struct.error:
            raise _DamagedError("chunk index") from None
        if offset + length + index_bytes > self._size:
            raise _DamagedError("chunk outside the file")
        return _Piece(offset, length, index_bytes, start_ns, end_ns, channels)

    def _scan(self) -> None:
        """Channels, chunks and counts from the records themselves, up to DataEnd or where the file breaks off."""
        self._channels, self._metadata, self._counts, self._pieces = {}, {}, Counter(), []
        opcode = 0
        for opcode, at, end in self._records_of_file():
            if opcode == _CHUNK:
                self._pieces.append(self._bare_piece(at, end))
            elif opcode == _MESSAGE_INDEX:
                self._extend_index(at, end)
            elif opcode == _MESSAGE:
                self._extend_loose(at, end)
            elif opcode == _METADATA:
                name_bytes = self._read(at + 9, min(end - at - 9, 4096))
                self._metadata[_prefixed(name_bytes)] = (at, end - at)
            elif opcode in (_SCHEMA, _CHANNEL):
                self._note_definition(opcode, self._read(at + 9, end - at - 9))
        ended = opcode == _DATA_END
        self.recovered = not (ended and self._read(self._size - len(MAGIC), len(MAGIC)) == MAGIC)
        if not ended and self._pieces and not self._pieces[-1].loose:
            self._forget_index(len(self._pieces) - 1)
        self._look_into_chunks()

    def _records_of_file(self) -> Iterator[tuple[int, int, int]]:
        """(opcode, start, end) of the records up to DataEnd that lie whole in the file."""
        at = len(MAGIC)
        while at + 9 <= self._size:
            opcode, length = _RECORD.unpack(self._read(at, 9))
            if length > self._size - at - 9 or opcode in (0, _FOOTER):
                return
            yield opcode, at, at + 9 + length
            at += 9 + length
            if opcode == _DATA_END:
                return

    def _bare_piece(self, at: int, end: int) -> _Piece:
        head = self._read(at + 9, min(end - at - 9, _CHUNK_HEAD.size))
        start_ns, end_ns = struct.unpack_from("<qq", head.ljust(16, b"\0"))
        return _Piece(at, end - at, 0, start_ns, end_ns, frozenset())

    def _extend_index(self, at: int, end: int) -> None:
        """Take a MessageIndex record into its chunk, the last piece; one that stands anywhere else is ignored."""
        last = self._pieces[-1] if self._pieces else None
        if last is None or last.loose or last.offset + last.length + last.index_bytes != at or end - at < 15:
            return
        (channel,) = struct.unpack("<H", self._read(at + 9, 2))
        channels = last.channels | {channel} if end - at > 15 else last.channels
        self._counts[channel] += (end - at - 15) // 16
        self._pieces[-1] = replace(last, index_bytes=last.index_bytes + end - at, channels=channels)

    def _extend_loose(self, at: int, end: int) -> None:
        """Take a message outside of chunks into the run it continues, or begin a new run of up to 1 MiB."""
        if end - at < _MESSAGE_HEAD.size:
            return
        _, _, channel, _, log_ns, _ = _MESSAGE_HEAD.unpack(self._read(at, _MESSAGE_HEAD.size))
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
        """Take back what the index of piece i told: it is incomplete where the file breaks off behind the chunk."""
        piece = self._pieces[i]
        for channel, entries in _index_entries(self._read(piece.offset + piece.length, piece.index_bytes)):
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
            except _DamagedError as damage:
                self._leave_out(piece, damage)
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
        for opcode, lo, hi in _records_in(data):
            if opcode == _MESSAGE and hi - lo >= 22:
                counts[data[lo] | data[lo + 1] << 8] += 1
            elif opcode in (_SCHEMA, _CHANNEL):
                self._note_definition(opcode, bytes(data[lo:hi]))
        return counts

    def _note_definition(self, opcode: int, body: bytes) -> None:
        if opcode == _SCHEMA:
            schema = self._parse("Schema", body)
            self._schemas[schema.id] = schema
        elif opcode == _CHANNEL:
            channel = self._parse("Channel", body)
            self._channels[channel.id] = channel

    # Reading a chunk.

    def _chunk(self, piece: _Piece, keys: tuple[TopicKey, ...], group_of: dict[int, int]) -> Chunk:
        raw = self._read(piece.offset, piece.length + piece.index_bytes)
        data = raw if piece.loose else self._chunk_data(memoryview(raw)[: piece.length])
        buffer = np.frombuffer(data, dtype=np.uint8)
        if piece.index_bytes:
            entries = [e for e in _index_entries(raw[piece.length :]) if e[0] in group_of and len(e[1])]
            chunk = _by_index(piece.start_ns, buffer, entries, keys, group_of)
            if chunk is not None:
                return chunk
        return grouped(piece.start_ns, buffer, keys, *_by_walking(data, group_of))

    def _chunk_data(self, record: bytes | memoryview) -> bytes | memoryview:
        """The records inside a chunk, decompressed; the checksum is verified only in a file that is being recovered.

        It costs as much as the decompression, which itself notices most damage.
        """
        try:
            _, _, size, crc, name_bytes = _CHUNK_HEAD.unpack_from(record, 9)
            at = 9 + _CHUNK_HEAD.size + name_bytes
            (data_bytes,) = struct.unpack_from("<Q", record, at)
        except struct.error:
            raise _DamagedError("its header is cut") from None
        compressed = record[at + 8 : at + 8 + data_bytes]
        if len(compressed) != data_bytes:
            raise _DamagedError(f"{data_bytes} bytes claimed, {len(compressed)} there")
        compression = bytes(record[at - name_bytes : at]).decode("utf-8", errors="replace")
        if compression not in _DECOMPRESS:
            raise InputError(f"{self._path}: chunk compression {compression!r}: none, lz4 and zstd can be read")
        if size > max(_PLAUSIBLE_BYTES, _PLAUSIBLE_RATIO * data_bytes):
            raise _DamagedError(f"{size} bytes cannot come out of {data_bytes}")
        data = _DECOMPRESS[compression](compressed, size)
        if len(data) != size:
            raise _DamagedError(f"{size} bytes claimed, {len(data)} decompressed")
        if self.recovered and crc and zlib.crc32(data) != crc:
            raise _DamagedError("its checksum is wrong")
        return data

    def _read(self, at: int, length: int) -> bytes:
        self._file.seek(at)
        data = self._file.read(length) if at + length <= self._size else b""
        if len(data) != length:
            raise _DamagedError(f"the file ends before byte {at + length}")
        return data

    def _parse(self, record: str, body: bytes) -> Any:
        try:
            return getattr(self._records, record).read(self._stream(BytesIO(body)))
        except (self._error, struct.error, ValueError) as error:
            raise _DamagedError(f"{record} record: {error}") from None

    def _key(self, channel_id: int) -> TopicKey:
        channel = self._channels[channel_id]
        schema = self._schemas.get(channel.schema_id)
        return channel.topic, schema.name if schema else ""


def _records_in(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """(opcode, start, end) of the bodies of the records in a chunk or summary; _DamagedError where one is cut."""
    at, size, unpack = 0, len(data), _RECORD.unpack_from
    while at < size:
        if at + 9 > size:
            raise _DamagedError("a record is cut")
        opcode, length = unpack(data, at)
        at += 9
        if length > size - at:
            raise _DamagedError(f"a record claims {length} bytes, {size - at} are left")
        yield opcode, at, at + length
        at += length


def _prefixed(data: bytes) -> str:
    (length,) = struct.unpack_from("<I", data.ljust(4, b"\0"))
    return data[4 : 4 + length].decode("utf-8", errors="replace")


def _from_zstd(data: bytes | memoryview, size: int) -> bytes:
    zstandard = require("zstandard")
    try:
        # zstandard believes the frame's own size before max_output_size, so compare the two beforehand.
        if zstandard.frame_content_size(data) not in (-1, size):
            raise _DamagedError("the frame has another size than the chunk")
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size)) if size else b""
    except zstandard.ZstdError as error:
        raise _DamagedError(f"zstd: {error}") from None


def _from_lz4(data: bytes | memoryview, size: int) -> bytes:
    lz4 = require("lz4.frame")
    try:
        if lz4.get_frame_info(data)["content_size"] not in (0, size):
            raise _DamagedError("the frame has another size than the chunk")
        # A frame need not state its size, so no more is taken out of it than the chunk states, and one byte.
        return bytes(lz4.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (RuntimeError, EOFError) as error:
        raise _DamagedError(f"lz4: {error}") from None


_DECOMPRESS: dict[str, Callable[[bytes | memoryview, int], bytes | memoryview]] = {
    "": lambda data, size: data,
    "none": lambda data, size: data,
    "lz4": _from_lz4,
    "zstd": _from_zstd,
}


def _index_entries(records: bytes) -> Iterator[tuple[int, Integers]]:
    """(channel, int64 (n, 2) of log time and offset in the chunk) of each MessageIndex record."""
    for opcode, lo, hi in _records_in(records):
        if opcode == _MESSAGE_INDEX and hi - lo >= 6:
            channel, length = struct.unpack_from("<HI", records, lo)
            if length != hi - lo - 6 or length % 16:
                raise _DamagedError("its message index has a wrong length")
            yield channel, np.frombuffer(records, "<i8", length // 8, lo + 6).reshape(-1, 2)


def _by_index(
    start_ns: int,
    buffer: Bytes,
    entries: list[tuple[int, Integers]],
    keys: tuple[TopicKey, ...],
    group_of: dict[int, int],
) -> Chunk | None:
    """The messages that the index entries of the wanted channels point at; None if one does not point at a message.

    Each must be a message record of its channel that lies inside the chunk.
    """
    if not entries:
        return None
    entries.sort(key=lambda entry: group_of[entry[0]])
    counts = [len(rows) for _, rows in entries]
    log_ns, at = np.concatenate([rows for _, rows in entries]).T.copy()
    if at.min() < 0 or at.max() > buffer.size - _MESSAGE_HEAD.size:
        return None
    start = gather(buffer, at, _MESSAGE_START.itemsize).view(_MESSAGE_START)
    lengths = start["length"].astype(np.int64) - 22
    fits = start["channel"] == np.repeat([channel for channel, _ in entries], counts)
    fits &= start["opcode"] == _MESSAGE
    fits &= (lengths >= 0) & (lengths <= buffer.size - _MESSAGE_HEAD.size - at)
    if not fits.all():
        return None
    group = np.repeat([group_of[channel] for channel, _ in entries], counts)
    if ((at[1:] <= at[:-1]) & (group[1:] == group[:-1])).any():
        # An index sorted by time, or two channels of one topic: back to the order of the file.
        order = np.lexsort((at, group))
        log_ns, at, lengths = log_ns[order], at[order], lengths[order]
    edges = np.searchsorted(group, np.arange(len(keys) + 1)).tolist()
    return Chunk(start_ns, buffer, keys, tuple(edges), log_ns, at + _MESSAGE_HEAD.size, lengths)


def _by_walking(data: bytes | memoryview, group_of: dict[int, int]) -> tuple[Integers, Integers, Integers, Integers]:
    """The same, record after record in file order, for what has no index."""
    found = []
    for opcode, lo, hi in _records_in(data):
        if opcode == _MESSAGE and hi - lo >= 22:
            channel, _, log_ns = struct.unpack_from("<HIq", data, lo)
            if channel in group_of:
                found.append((group_of[channel], log_ns, lo + 22, hi - lo - 22))
    group, log_ns, offsets, lengths = np.array(found, dtype=np.int64).reshape(-1, 4).T.copy()
    return group, log_ns, offsets, lengths
