"""Bags: 60 s of six Imu topics at 1129.3 Hz, read to arrays and written from arrays, compared with other libraries."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader

from bench.table import Row, render
from biodyn_core.base.arrays import Integers
from biodyn_core.base.segments import SENSORS
from biodyn_ros.bag import BagWriter, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, Bytes, decode_imu, encode_imu

RATE_HZ = 1129.3
SECONDS = 60.0
BLOCK = 282  # a quarter of a second
ROUNDS = 5

Recording = dict[str, tuple[Integers, Bytes]]
"""Log times and messages by topic."""


def rows() -> list[Row]:
    """Measure; about half a minute."""
    recording = _recording()
    count = sum(len(stamps_ns) for stamps_ns, _ in recording.values())
    # In memory if possible, to exclude the disk.
    memory = Path("/dev/shm")  # noqa: S108
    with TemporaryDirectory(dir=memory if memory.is_dir() else None) as directory:
        bag = Path(directory) / "bag.mcap"
        plain = _rates(count, lambda: _write(bag, recording, "none"), lambda: _write_singly(bag, recording, "none"))
        packed = _rates(count, lambda: _write(bag, recording, "zstd"), lambda: _write_singly(bag, recording, "zstd"))
        _write(bag, recording, "zstd")
        ours, bound, rosbags = _rates(
            count, lambda: _read(bag), lambda: _decompress(bag), lambda: _read_with_rosbags(bag)
        )
    unit, singly = "messages/s", "mcap, message by message"
    return [
        Row("bag to arrays, zstd", ours, unit, bound, "read, decompress", ">= 0.5 x", ours >= 0.5 * bound),
        Row("bag to arrays, zstd", ours, unit, rosbags, "rosbags raw, numpy", ">= 8 x", ours >= 8 * rosbags),
        Row("arrays to bag, none", plain[0], unit, plain[1], singly, ">= 1,500,000", plain[0] >= 1.5e6),
        Row("arrays to bag, zstd", packed[0], unit, packed[1], singly, "-", None),
    ]


def _rates(count: int, *tasks: Callable[[], object]) -> list[float]:
    """Messages per second of each task, the best of alternating rounds."""
    best = [np.inf] * len(tasks)
    for _ in range(ROUNDS):
        for i, task in enumerate(tasks):
            start = time.perf_counter()
            task()
            best[i] = min(best[i], time.perf_counter() - start)
    return [count / seconds for seconds in best]


def _recording() -> Recording:
    rng = np.random.default_rng(0)
    n = int(SECONDS * RATE_HZ)
    stamps_ns = 1_700_000_000_000_000_000 + np.rint(np.arange(n) * 1e9 / RATE_HZ).astype(np.int64)
    recording = {}
    for k, sensor in enumerate(SENSORS):
        accel, gyro = rng.normal(size=(n, 3)), rng.normal(scale=0.1, size=(n, 3))
        recording[f"imu/{sensor}/data"] = (stamps_ns + k, encode_imu(stamps_ns, accel, gyro, f"imu_{sensor}"))
    return recording


def _write(path: Path, recording: Recording, compression: str) -> None:
    with BagWriter(path, compression, overwrite=True) as writer:
        for topic in recording:
            writer.add_topic(topic, IMU_TYPE)
        for lo in range(0, int(SECONDS * RATE_HZ), BLOCK):
            for topic, (stamps_ns, messages) in recording.items():
                writer.write(topic, stamps_ns[lo : lo + BLOCK], messages[lo : lo + BLOCK])


def _write_singly(path: Path, recording: Recording, compression: str) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType[compression.upper()])
        writer.start("ros2")
        schema = writer.register_schema(IMU_TYPE, "ros2msg", b"")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in recording]
        for step in zip(*(zip(stamps.tolist(), data, strict=True) for stamps, data in recording.values()), strict=True):
            for channel, (log_ns, message) in zip(channels, step, strict=True):
                writer.add_message(channel, log_ns, message.tobytes(), log_ns)
        writer.finish()


def _read(path: Path) -> None:
    with open_bag(path) as bag:
        for _ in imu_blocks(bag, [topic.name for topic in bag.topics]):
            pass


def _decompress(path: Path) -> None:
    """The lower bound of the time of any reader."""
    decompressor = zstandard.ZstdDecompressor()
    with path.open("rb") as stream:
        for index in make_reader(stream).get_summary().chunk_indexes:
            stream.seek(index.chunk_start_offset + 49 + len(index.compression))
            decompressor.decompress(stream.read(index.compressed_size), max_output_size=index.uncompressed_size)


def _read_with_rosbags(path: Path) -> None:
    messages = defaultdict(list)
    with Reader(path) as reader:
        for connection, _, data in reader.messages():
            messages[connection.topic].append(data)
    for found in messages.values():
        decode_imu(found)


if __name__ == "__main__":
    print(render(rows()))
