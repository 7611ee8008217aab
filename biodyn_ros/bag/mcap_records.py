"""Records of MCAP files: iteration, decompression of chunks, and messages by the message index.

Every length is checked before use.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from biodyn_core.base.arrays import Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.bag.cdr import gather
from biodyn_ros.bag.storage import Bytes, Chunk, TopicKey, require

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07
CHUNK_INDEX, STATISTICS, METADATA, METADATA_INDEX, DATA_END = 0x08, 0x0B, 0x0C, 0x0D, 0x0F

RECORD = struct.Struct("<BQ")
# Log times are unsigned in the file; read as signed they fit int64 until the year 2262.
CHUNK_HEAD = struct.Struct("<qqQII")
CHUNK_INDEX_HEAD = struct.Struct("<qqQQI")
MESSAGE_HEAD = struct.Struct("<BQHIqQ")
_MESSAGE_START = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2")])

_PLAUSIBLE_BYTES = 256 << 20
_PLAUSIBLE_RATIO = 1000


class DamagedError(Exception):
    """Invalid bytes; the reader omits the chunk with them."""


def walk(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """(opcode, start, end) of the bodies of the records in a chunk or summary; DamagedError if one is cut."""
    at, size, unpack = 0, len(data), RECORD.unpack_from
    while at < size:
        if at + 9 > size:
            raise DamagedError("a record is cut")
        opcode, length = unpack(data, at)
        at += 9
        if length > size - at:
            raise DamagedError(f"a record states {counted(length, 'byte')}, {size - at} remain")
        yield opcode, at, at + length
        at += length


def prefixed(data: bytes) -> str:
    """The text after its length in bytes; cut if the data ends before."""
    (length,) = struct.unpack_from("<I", data.ljust(4, b"\0"))
    return data[4 : 4 + length].decode("utf-8", errors="replace")


def _from_zstd(data: bytes | memoryview, size: int) -> bytes:
    zstandard = require("zstandard")
    try:
        # zstandard uses the size of the frame rather than max_output_size, so the two are compared first.
        if zstandard.frame_content_size(data) not in (-1, size):
            raise DamagedError("the frame has another size than the chunk")
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size)) if size else b""
    except zstandard.ZstdError as error:
        raise DamagedError(f"zstd: {error}") from None


def _from_lz4(data: bytes | memoryview, size: int) -> bytes:
    lz4 = require("lz4.frame")
    try:
        if lz4.get_frame_info(data)["content_size"] not in (0, size):
            raise DamagedError("the frame has another size than the chunk")
        # A frame may omit its size, so at most the size that the chunk states, plus one byte, is decompressed.
        return bytes(lz4.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (RuntimeError, EOFError) as error:
        raise DamagedError(f"lz4: {error}") from None


_DECOMPRESS: dict[str, Callable[[bytes | memoryview, int], bytes | memoryview]] = {
    "": lambda data, size: data,
    "none": lambda data, size: data,
    "lz4": _from_lz4,
    "zstd": _from_zstd,
}


def index_entries(records: bytes) -> Iterator[tuple[int, Integers]]:
    """(channel, int64 (n, 2) of log time and offset in the chunk) of each MessageIndex record."""
    for opcode, lo, hi in walk(records):
        if opcode == MESSAGE_INDEX and hi - lo >= 6:
            channel, length = struct.unpack_from("<HI", records, lo)
            if length != hi - lo - 6 or length % 16:
                raise DamagedError("its message index has a wrong length")
            yield channel, np.frombuffer(records, "<i8", length // 8, lo + 6).reshape(-1, 2)


def by_index(
    start_ns: int,
    buffer: Bytes,
    entries: list[tuple[int, Integers]],
    keys: tuple[TopicKey, ...],
    group_of: dict[int, int],
) -> Chunk | None:
    """The messages of the index entries of the selected channels; None if an entry does not refer to a message.

    Each must be a message record of its channel inside the chunk.
    """
    if not entries:
        return None
    entries.sort(key=lambda entry: group_of[entry[0]])
    counts = [len(rows) for _, rows in entries]
    log_ns, at = np.concatenate([rows for _, rows in entries]).T.copy()
    if at.min() < 0 or at.max() > buffer.size - MESSAGE_HEAD.size:
        return None
    start = gather(buffer, at, _MESSAGE_START.itemsize).view(_MESSAGE_START)
    lengths = start["length"].astype(np.int64) - 22
    fits = start["channel"] == np.repeat([channel for channel, _ in entries], counts)
    fits &= start["opcode"] == MESSAGE
    fits &= (lengths >= 0) & (lengths <= buffer.size - MESSAGE_HEAD.size - at)
    if not fits.all():
        return None
    group = np.repeat([group_of[channel] for channel, _ in entries], counts)
    if ((at[1:] <= at[:-1]) & (group[1:] == group[:-1])).any():
        # An index sorted by time, or two channels of one topic: restore the order of the file.
        order = np.lexsort((at, group))
        log_ns, at, lengths = log_ns[order], at[order], lengths[order]
    edges = np.searchsorted(group, np.arange(len(keys) + 1)).tolist()
    return Chunk(start_ns, buffer, keys, tuple(edges), log_ns, at + MESSAGE_HEAD.size, lengths)


def by_walking(data: bytes | memoryview, group_of: dict[int, int]) -> tuple[Integers, Integers, Integers, Integers]:
    """The same without an index, record by record in file order."""
    found = []
    for opcode, lo, hi in walk(data):
        if opcode == MESSAGE and hi - lo >= 22:
            channel, _, log_ns = struct.unpack_from("<HIq", data, lo)
            if channel in group_of:
                found.append((group_of[channel], log_ns, lo + 22, hi - lo - 22))
    group, log_ns, offsets, lengths = np.array(found, dtype=np.int64).reshape(-1, 4).T.copy()
    return group, log_ns, offsets, lengths


def chunk_data(record: bytes | memoryview, path: Path) -> bytes | memoryview:
    """The decompressed records inside a chunk record of a file, with the right checksum if it states one.

    Raises DamagedError, and InputError for an unknown compression.
    """
    try:
        _, _, size, crc, name_bytes = CHUNK_HEAD.unpack_from(record, 9)
        at = 9 + CHUNK_HEAD.size + name_bytes
        (data_bytes,) = struct.unpack_from("<Q", record, at)
    except struct.error:
        raise DamagedError("its header is cut") from None
    compressed = record[at + 8 : at + 8 + data_bytes]
    if len(compressed) != data_bytes:
        raise DamagedError(f"{counted(data_bytes, 'byte')} stated, {len(compressed)} found")
    compression = bytes(record[at - name_bytes : at]).decode("utf-8", errors="replace")
    if compression not in _DECOMPRESS:
        raise InputError(f"{path}: chunk compression {compression!r}: only none, lz4 and zstd can be read")
    if size > max(_PLAUSIBLE_BYTES, _PLAUSIBLE_RATIO * data_bytes):
        raise DamagedError(f"{counted(data_bytes, 'byte')} cannot contain {counted(size, 'byte')}")
    data = _DECOMPRESS[compression](compressed, size)
    if len(data) != size:
        raise DamagedError(f"{counted(size, 'byte')} stated, {len(data)} decompressed")
    if crc and zlib.crc32(data) != crc:
        raise DamagedError("its checksum is wrong")
    return data
