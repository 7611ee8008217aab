"""A small recording of three topics, how mcap, rosbags and we write it, and how it is read again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from biodyn_ros.bag import BagReader, BagWriter, cdr
from biodyn_ros.bag.cdr import IMU_TYPE

COMPRESSIONS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
START_NS = 1_700_000_000_000_000_000
SEAT, HEAD, ODD = "/imu/seat/data", "/imu/head/data", "/imu/odd"

Logged = tuple[str, int, bytes]
"""Topic, log time, message."""


def recording(n: int = 400, rate_hz: float = 100.0) -> list[Logged]:
    """Some messages each of two topics of one frame_id length, and a third whose frame_id length differs each time."""
    rng = np.random.default_rng(1)
    out: list[Logged] = []
    for k, (topic, frame_id) in enumerate({SEAT: "seat", HEAD: "head_link", ODD: None}.items()):
        for i in range(n):
            frame = "o" * (i % 23) if frame_id is None else frame_id
            stamp_ns = START_NS + int(i * 1e9 / rate_hz) + k * 1000
            x = rng.normal(size=(1, 6))
            message = cdr.encode_imu(np.array([stamp_ns - 5_000_000]), x[:, :3], x[:, 3:], frame)
            out.append((topic, stamp_ns, message.tobytes()))
    return sorted(out, key=lambda item: item[1])


def by_topic(messages: Iterable[Logged]) -> dict[str, list[tuple[int, bytes]]]:
    found = defaultdict(list)
    for topic, log_ns, data in messages:
        found[topic].append((log_ns, data))
    return dict(found)


def read_ours(reader: BagReader, topics: Iterable[str] | None = None) -> dict[str, list[tuple[int, bytes]]]:
    return by_topic(
        (block.topic, log_ns, data)
        for block in reader.blocks(topics)
        for log_ns, data in zip(block.log_ns.tolist(), block.messages(), strict=True)
    )


def write_with_mcap(path: Path, messages: Iterable[Logged], **options: object) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 20_000, **options})
        writer.start("ros2", "test")
        schema = writer.register_schema(IMU_TYPE, "ros2msg", b"")
        channels: dict[str, int] = {}
        for topic, log_ns, data in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.add_metadata("biodyn", {"command": "test"})
        writer.finish()


def write_with_rosbags(path: Path, messages: Iterable[Logged], plugin: StoragePlugin) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with RosbagsWriter(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, log_ns, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, IMU_TYPE, typestore=store)
            writer.write(connections[topic], log_ns, data)


def write_ours(path: Path, messages: Iterable[Logged], block: int = 25, **options: object) -> None:
    """Blocks of some messages per topic in turns; ODD is left out, its messages differ in size."""
    topics = {topic: found for topic, found in by_topic(messages).items() if topic != ODD}
    with BagWriter(path, **options) as writer:
        for topic in topics:
            writer.add_topic(topic, IMU_TYPE)
        for lo in range(0, max(map(len, topics.values())), block):
            for topic, found in topics.items():
                if part := found[lo : lo + block]:
                    payload = np.frombuffer(b"".join(data for _, data in part), np.uint8).reshape(len(part), -1)
                    writer.write(topic, np.array([log_ns for log_ns, _ in part]), payload)
        writer.add_metadata("biodyn", {"command": "test", "version": "1"})


def constant_size(messages: Iterable[Logged]) -> list[Logged]:
    return [item for item in messages if item[0] != ODD]


RECORDING = recording()


def merged(blocks: Iterable[tuple[str, cdr.ImuBlock]]) -> dict[str, list[int]]:
    found = defaultdict(list)
    for topic, block in blocks:
        found[topic] += block.stamps_ns.tolist()
    return dict(found)
