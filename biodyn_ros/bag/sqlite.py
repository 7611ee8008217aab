"""rosbag2's sqlite3 files, read by the standard library, some MiB of rows at a time."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from biodyn_core.errors import InputError
from biodyn_ros.bag.storage import Chunk, TopicInfo, TopicKey, grouped, refuse_foreign

MAGIC = b"SQLite format 3\0"

_FIRST_ROWS = 256
_MOST_ROWS = 8192
_CHUNK_BYTES = 4 << 20


class SqliteStorage:
    """One .db3 file, open for reading; see `storage.Storage`. Raises InputError for what is no rosbag2 database."""

    def __init__(self, path: Path, warnings: list[str]) -> None:
        self._path, self._warnings = path, warnings
        self.recovered = False
        self._db = _connect(path, warnings)
        try:
            self._open()
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

    def chunks(self, topics: frozenset[str]) -> Iterator[Chunk]:
        """The messages of these topics in the order of log time; a damaged database ends with a warning.

        Ordered by timestamp as rosbag2 itself does, which its index on timestamp gives without sorting; rows with
        the same timestamp follow in the order they were written.
        """
        keys = tuple((t.name, t.type) for t in self.topics if t.name in topics)
        place = {key: k for k, key in enumerate(keys)}
        group_of = {i: place[key] for i, key in self._keys.items() if key in place}
        marks = ",".join("?" * len(group_of))  # nothing else goes into the text of the query
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp, id"  # noqa: S608
        try:
            yield from self._chunks(self._db.execute(query, tuple(group_of)), keys, group_of)
        except sqlite3.Error as error:
            self.recovered = True
            self._warnings.append(f"{self._path}: damaged, the messages from here on are left out: {error}")

    def _chunks(self, rows: sqlite3.Cursor, keys: tuple[TopicKey, ...], group_of: dict[int, int]) -> Iterator[Chunk]:
        count = _FIRST_ROWS
        while found := rows.fetchmany(count):
            chunk = self._chunk(found, keys, group_of)
            yield chunk
            count = max(1, min(_MOST_ROWS, _CHUNK_BYTES * len(found) // max(1, chunk.buffer.size)))

    def _open(self) -> None:
        rows = self._db.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
        if not all(isinstance(text, str) for row in rows for text in row[1:]):
            raise TypeError("a topic without name, type or format")
        refuse_foreign(self._path, [(name, form) for _, name, _, form in rows], self._warnings)
        self._keys: dict[int, TopicKey] = {i: (name, kind) for i, name, kind, form in rows if form == "cdr"}
        counts = dict.fromkeys(self._keys.values(), 0)
        for i, n in self._db.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"):
            if i in self._keys:
                counts[self._keys[i]] += n
        self.topics = tuple(TopicInfo(topic, kind, n) for (topic, kind), n in counts.items())
        # Two queries, for the index on timestamp answers only one at a time without a full scan.
        (self.start_ns,) = self._db.execute("SELECT CAST(min(timestamp) AS INTEGER) FROM messages").fetchone()
        (self.end_ns,) = self._db.execute("SELECT CAST(max(timestamp) AS INTEGER) FROM messages").fetchone()

    def _chunk(self, rows: list[tuple[int, int, bytes]], keys: tuple[TopicKey, ...], group_of: dict[int, int]) -> Chunk:
        """The rows as one buffer; the joining is the only copy."""
        ids, stamps, data = zip(*rows, strict=True)
        try:
            buffer = np.frombuffer(b"".join(data), dtype=np.uint8)
            log_ns = np.array(stamps, dtype=np.int64)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{self._path}: table messages holds other things than bytes: check the file") from None
        lengths = np.fromiter(map(len, data), dtype=np.int64, count=len(data))
        group = np.fromiter(map(group_of.__getitem__, ids), dtype=np.int64, count=len(ids))
        return grouped(int(log_ns[0]), buffer, keys, group, log_ns, np.cumsum(lengths) - lengths, lengths)


def _connect(path: Path, warnings: list[str]) -> sqlite3.Connection:
    """Open read-only; immutable, so that nothing is created beside the bag, unless a write-ahead log must be read.

    A recorder that was killed leaves its last messages in that log; an immutable connection does not see them.
    """
    log = path.with_name(path.name + "-wal")
    if log.exists() and log.stat().st_size:
        database = _connect_by(path, "mode=ro")
        try:
            database.execute("SELECT count(*) FROM sqlite_master")
        except sqlite3.Error as error:
            database.close()
            warnings.append(f"{log}: its messages are left out ({error}): copy the bag to a writable directory")
        else:
            return database
    return _connect_by(path, "mode=ro&immutable=1")


def _connect_by(path: Path, mode: str) -> sqlite3.Connection:
    try:
        return sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True, check_same_thread=False)
    except sqlite3.Error as error:
        raise InputError(f"{path}: cannot be opened ({error}): check the file and its permissions") from None
