"""Reads rosbag2's sqlite3 files with the standard library, some MiB of rows at a time.

A cut or damaged file is read in the order of writing, up to the first missing or damaged page.
"""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from biodyn_core.base.errors import InputError
from biodyn_core.base.wording import counted
from biodyn_ros.bag.storage import (
    OFFERED_QOS,
    Chunk,
    LogTimes,
    TopicKey,
    grouped,
    latched_depth,
    refuse_foreign,
    topic_infos,
)

MAGIC = b"SQLite format 3\0"

_FIRST_ROWS = 256
_MOST_ROWS = 8192
_CHUNK_BYTES = 4 << 20
_TABLE_LEAF = 0x0D


class SqliteStorage:
    """One .db3 file, open for reading; see `storage.Storage`. Raises InputError if it is no rosbag2 database."""

    def __init__(self, path: Path, warnings: list[str]) -> None:
        self._path, self._warnings = path, warnings
        self.recovered = False
        self.start_ns: int | None = None
        self.end_ns: int | None = None
        self._last_id: int | None = None  # of the last complete message of a recovered file
        self._in_cut_page = _messages_in_cut_page(path)
        self._db = _connect(path, warnings)
        try:
            try:
                self._open()
            except sqlite3.DatabaseError:
                self._recover()
        except (sqlite3.Error, UnicodeDecodeError, TypeError) as error:
            self.close()
            raise InputError(f"{path}: not a readable rosbag2 database ({error}): check the file") from None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    def metadata(self, name: str) -> dict[str, str]:
        """Always empty: rosbag2's sqlite3 files have no records of that kind."""
        return {}

    def chunks(self, topics: frozenset[str], within: LogTimes | None = None) -> Iterator[Chunk]:
        """The messages of these topics in the order of log time; a damaged database ends with a warning.

        Ordered by timestamp as in rosbag2, by its index on timestamp; rows with the same timestamp are in the order of
        writing. The index of a damaged file is not used.
        """
        keys = tuple((t.name, t.type) for t in self.topics if t.name in topics)
        place = {key: k for k, key in enumerate(keys)}
        group_of = {i: place[key] for i, key in self._keys.items() if key in place}
        marks = ",".join("?" * len(group_of))  # no data enters the text of the query
        where, values = f"topic_id IN ({marks})", [*group_of]
        if within:
            where, values = f"{where} AND timestamp BETWEEN ? AND ?", [*values, *within]
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE {where} ORDER BY timestamp, id"  # noqa: S608
        if self._last_id is not None:
            query = f"SELECT topic_id, timestamp, data FROM messages NOT INDEXED WHERE id <= ? AND {where} ORDER BY id"  # noqa: S608
            values = [self._last_id, *values]
        rows = self._rows(query, values)
        count = _FIRST_ROWS
        while found := list(islice(rows, count)):
            chunk = self._chunk(found, keys, group_of)
            yield chunk
            count = max(1, min(_MOST_ROWS, _CHUNK_BYTES * len(found) // max(1, chunk.buffer.size)))

    def _rows(self, query: str, values: Sequence[int] = ()) -> Iterator[tuple[Any, ...]]:
        """The rows up to the end or to the first damage."""
        try:
            yield from self._db.execute(query, values)
        except sqlite3.Error as error:
            if not self.recovered:
                self.recovered = True
                self._warnings.append(f"{self._path}: damaged, the messages from here on are omitted: {error}")

    def _open(self) -> None:
        if self._in_cut_page:
            raise sqlite3.DatabaseError("its last page is cut")
        self._read_topics()
        self._count(dict(self._db.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id")))
        # Two queries, because the index on timestamp avoids a full scan only for one of them at a time.
        (self.start_ns,) = self._db.execute("SELECT CAST(min(timestamp) AS INTEGER) FROM messages").fetchone()
        (self.end_ns,) = self._db.execute("SELECT CAST(max(timestamp) AS INTEGER) FROM messages").fetchone()

    def _read_topics(self) -> None:
        rows = self._db.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        if not all(isinstance(text, str) for row in rows for text in row[1:]):
            raise TypeError("a topic without name, type or format")
        refuse_foreign(self._path, [(name, form) for _, name, _, form in rows], self._warnings)
        self._keys: dict[int, TopicKey] = {i: (name, kind) for i, name, kind, form in rows if form == "cdr"}
        columns = [name for _, name, *_ in self._db.execute("PRAGMA table_info(topics)")]
        # The first versions of rosbag2 did not record QoS.
        has_qos = OFFERED_QOS in columns
        profiles = self._db.execute("SELECT id, offered_qos_profiles FROM topics") if has_qos else ()
        self._latched = {self._keys[i]: latched_depth(text) for i, text in profiles if i in self._keys}

    def _count(self, messages: Mapping[int, int]) -> None:
        counts = dict.fromkeys(self._keys.values(), 0)
        for i, n in messages.items():
            if i in self._keys:
                counts[self._keys[i]] += n
        self.topics = topic_infos(counts, self._latched)

    def _recover(self) -> None:
        """Open a damaged file: its messages in the order of writing, up to the damage."""
        self.recovered = True
        # Without this SQLite refuses every query of a file that is shorter than its header states.
        self._db.execute("PRAGMA writable_schema=ON")
        self._read_topics()
        counts: Counter[int] = Counter()
        for last_id, topic, stamp_ns in self._whole_rows():
            self._last_id = last_id
            counts[topic] += 1
            self.start_ns = stamp_ns if self.start_ns is None else min(self.start_ns, stamp_ns)
            self.end_ns = stamp_ns if self.end_ns is None else max(self.end_ns, stamp_ns)
        if self.start_ns is None or self.end_ns is None:
            raise InputError(f"{self._path}: cut before its first message, nothing to recover: record again")
        self._count(counts)
        seconds = (self.end_ns - self.start_ns) / 1e9
        self._warnings.append(
            f"{self._path}: cut or damaged: recovered {counted(counts.total(), 'message')},"
            f" up to {seconds:.3f} s after the first"
        )

    def _whole_rows(self) -> Iterator[tuple[int, int, int]]:
        """(id, topic, timestamp) of the messages before the damage, without those in a cut page.

        SQLite reads such a page as zeros after the cut: messages that start before it only appear complete.
        """
        held: deque[tuple[int, int, int]] = deque()
        for i, topic, stamp_ns, data in self._rows(
            "SELECT id, topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY id"
        ):
            if not (isinstance(stamp_ns, int) and isinstance(data, bytes)):
                return
            held.append((i, topic, stamp_ns))
            if len(held) > self._in_cut_page:
                yield held.popleft()

    def _chunk(self, rows: list[tuple[int, int, bytes]], keys: tuple[TopicKey, ...], group_of: dict[int, int]) -> Chunk:
        """The rows as one buffer; joining is the only copy."""
        ids, stamps, data = zip(*rows, strict=True)
        try:
            buffer = np.frombuffer(b"".join(data), dtype=np.uint8)
            log_ns = np.array(stamps, dtype=np.int64)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{self._path}: the table messages holds data other than bytes: check the file") from None
        lengths = np.fromiter(map(len, data), dtype=np.int64, count=len(data))
        group = np.fromiter(map(group_of.__getitem__, ids), dtype=np.int64, count=len(ids))
        return grouped(int(log_ns[0]), buffer, keys, group, log_ns, np.cumsum(lengths) - lengths, lengths)


def _messages_in_cut_page(path: Path) -> int:
    """The maximum number of messages in a cut last page; 0 if the last page is complete."""
    with path.open("rb") as stream:
        (size,) = struct.unpack(">H", stream.read(18).ljust(18, b"\0")[16:])
        size = 65536 if size == 1 else size or 1
        pages, rest = divmod(path.stat().st_size, size)
        stream.seek(pages * size)
        head = stream.read(5)
    if rest == 0:
        return 0
    return max(struct.unpack_from(">H", head, 3)[0], 1) if len(head) == 5 and head[0] == _TABLE_LEAF else 1


def _connect(path: Path, warnings: list[str]) -> sqlite3.Connection:
    """Open read-only; immutable, so that no file is created beside the bag, unless a write-ahead log must be read.

    After a killed recorder the last messages are in that log; an immutable connection does not read it.
    """
    log = path.with_name(path.name + "-wal")
    if log.exists() and log.stat().st_size:
        database = _connect_by(path, "mode=ro")
        try:
            database.execute("SELECT count(*) FROM sqlite_master")
        except sqlite3.Error as error:
            database.close()
            warnings.append(f"{log}: its messages are omitted ({error}): copy the bag to a writable directory")
        else:
            return database
    return _connect_by(path, "mode=ro&immutable=1")


def _connect_by(path: Path, mode: str) -> sqlite3.Connection:
    try:
        return sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True, check_same_thread=False)
    except sqlite3.Error as error:
        raise InputError(f"{path}: cannot be opened ({error}): check the file and its permissions") from None
