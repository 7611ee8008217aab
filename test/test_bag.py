"""Bags against mcap's and rosbags' own writers and readers, both ways; cut, odd and hostile files."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

from biodyn_core.errors import InputError
from biodyn_ros import cdr
from biodyn_ros.bag import SLICE_NS, BagReader, BagWriter, imu_blocks, open_bag
from biodyn_ros.cdr import IMU_TYPE

ROOT = Path(__file__).resolve().parents[1]
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


# They write, we read.


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        {"index_types": IndexType.NONE},
        {"index_types": IndexType.CHUNK},
        {"use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {"use_summary_offsets": False, "enable_crcs": False},
        {"chunk_size": 1},
    ],
    ids=lambda options: ",".join(options) or "all",
)
def test_what_mcap_writes_is_read_to_the_byte(tmp_path, compression, options):
    write_with_mcap(tmp_path / "a.mcap", RECORDING, compression=COMPRESSIONS[compression], **options)
    with open_bag(tmp_path / "a.mcap") as bag:
        assert (bag.storage, bag.recovered, bag.warnings) == ("mcap", False, [])
        assert {(t.name, t.type, t.messages) for t in bag.topics} == {(t, IMU_TYPE, 400) for t in (SEAT, HEAD, ODD)}
        assert bag.message_count == 1200
        assert (bag.start_ns, bag.end_ns) == (RECORDING[0][1], RECORDING[-1][1])
        assert read_ours(bag) == by_topic(RECORDING)
        assert read_ours(bag, [HEAD]) == {HEAD: by_topic(RECORDING)[HEAD]}
        assert bag.metadata("biodyn") == {"command": "test"}
        assert bag.metadata("nothing") == {}


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_what_rosbags_writes_is_read_to_the_byte(tmp_path, plugin):
    write_with_rosbags(tmp_path / "a", RECORDING, plugin)
    (file,) = (f for f in (tmp_path / "a").iterdir() if f.suffix in (".mcap", ".db3"))
    for path in (tmp_path / "a", file):
        with open_bag(path) as bag:
            assert bag.storage == ("mcap" if plugin == StoragePlugin.MCAP else "sqlite3")
            assert (bag.message_count, bag.recovered, bag.warnings) == (1200, False, [])
            assert (bag.start_ns, bag.end_ns) == (RECORDING[0][1], RECORDING[-1][1])
            assert {t.name: t.messages for t in bag.topics} == {SEAT: 400, HEAD: 400, ODD: 400}
            assert read_ours(bag) == by_topic(RECORDING)
            assert read_ours(bag, [ODD, SEAT]) == {t: by_topic(RECORDING)[t] for t in (ODD, SEAT)}


def test_reading_a_database_leaves_nothing_beside_it(tmp_path):
    write_with_rosbags(tmp_path / "a", RECORDING, StoragePlugin.SQLITE3)
    before = sorted(f.name for f in (tmp_path / "a").iterdir())
    with open_bag(tmp_path / "a") as bag:
        read_ours(bag)
    assert sorted(f.name for f in (tmp_path / "a").iterdir()) == before


def test_the_write_ahead_log_of_a_killed_recorder_is_read(tmp_path):
    write_with_rosbags(tmp_path / "a", RECORDING, StoragePlugin.SQLITE3)
    whole = tmp_path / "a" / "a.db3"
    database = sqlite3.connect(whole)
    database.execute("PRAGMA journal_mode=WAL")
    with database:
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)", (2**62, b"last"))
    for suffix in ("", "-wal"):
        shutil.copy(f"{whole}{suffix}", tmp_path / f"cut.db3{suffix}")
    database.close()
    with open_bag(tmp_path / "cut.db3") as bag:
        assert bag.message_count == 1201
        assert bag.end_ns == 2**62
        assert any(found[-1] == (2**62, b"last") for found in read_ours(bag).values())


def test_an_index_by_time_and_two_channels_of_a_topic_come_in_file_order(tmp_path):
    """Some writers sort the message index; two publishers of a topic are two channels."""
    messages = [(i % 2, START_NS + (7 * i % 50), bytes([i])) for i in range(50)]
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(IMU_TYPE, "ros2msg", b"")
        channels = [writer.register_channel(SEAT, "cdr", schema) for _ in range(2)]
        for which, log_ns, data in messages:
            writer.add_message(channels[which], log_ns, data, log_ns)
        writer.finish()
    with open_bag(tmp_path / "a.mcap") as bag:
        assert [(t.name, t.messages) for t in bag.topics] == [(SEAT, 50)]
        assert read_ours(bag) == {SEAT: [(log_ns, data) for _, log_ns, data in messages]}


# We write, they read.


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("chunk_bytes", [1, 5000, 1 << 20])
@pytest.mark.parametrize("block", [1, 25, 1000])
def test_mcap_and_rosbags_read_what_is_written(tmp_path, compression, chunk_bytes, block):
    written = constant_size(RECORDING)
    write_ours(tmp_path / "a", written, block, compression=compression, chunk_bytes=chunk_bytes)
    file = tmp_path / "a" / "a_0.mcap"
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert (reader.get_header().profile, reader.get_header().library) == ("ros2", "biodyn")
        read = [(channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()]
        assert read == written
        assert reader.get_summary().statistics.message_count == len(written)
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [
            ("biodyn", {"command": "test", "version": "1"})
        ]
    with file.open("rb") as stream:
        opcodes = {
            type(record).__name__ for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records
        }
        assert {"Chunk", "MessageIndex", "DataEnd", "Footer", "Statistics", "SummaryOffset"} <= opcodes
    with RosbagsReader(tmp_path / "a") as reader:
        assert reader.message_count == len(written)
        assert [(c.topic, log_ns, data) for c, log_ns, data in reader.messages()] == written
    with AnyReader([tmp_path / "a"]) as reader:
        connection, _, data = next(reader.messages())
        assert reader.deserialize(data, connection.msgtype).header.frame_id == "seat"
    with open_bag(tmp_path / "a") as bag:
        assert (bag.recovered, bag.warnings, bag.message_count) == (False, [], len(written))
        assert read_ours(bag) == by_topic(written)
        assert bag.metadata("biodyn")["version"] == "1"


def test_schemas_are_whole_and_sequences_run(tmp_path):
    write_ours(tmp_path / "a.mcap", RECORDING)
    store = get_typestore(Stores.ROS2_JAZZY)
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        (schema,) = reader.get_summary().schemas.values()
        assert (schema.name, schema.encoding) == (IMU_TYPE, "ros2msg")
        assert schema.data.decode() == store.generate_msgdef(IMU_TYPE, ros_version=2)[0]
        assert "MSG: geometry_msgs/Vector3" in schema.data.decode()
        sequences = [message.sequence for _, channel, message in reader.iter_messages(topics=[SEAT])]
    assert sequences == list(range(400))


def test_topics_written_far_apart_still_come_in_the_order_of_time(tmp_path):
    """A topic that stops, one that never starts, and one written much later are not waited for without end."""
    payload = np.zeros((5000, 400), dtype=np.uint8)
    stamps = START_NS + np.arange(5000) * 1_000_000
    with BagWriter(tmp_path / "a.mcap", chunk_bytes=10_000) as writer:
        for topic in (SEAT, HEAD, ODD):
            writer.add_topic(topic, IMU_TYPE)
        writer.write(HEAD, stamps[:10], payload[:10])
        for lo in range(0, 5000, 100):
            writer.write(SEAT, stamps[lo : lo + 100], payload[lo : lo + 100])
        writer.write(HEAD, stamps[10:], payload[10:])
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        starts = [index.message_start_time for index in reader.get_summary().chunk_indexes]
        assert starts == sorted(starts)
        assert sum(1 for _ in reader.iter_messages()) == 10_000
        assert {channel.topic for channel in reader.get_summary().channels.values()} == {SEAT, HEAD, ODD}


def test_pending_messages_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr("biodyn_ros.bag.writer._MOST_PENDING_BYTES", 50_000)
    payload, stamps = np.zeros((100, 400), dtype=np.uint8), START_NS + np.arange(100)
    with BagWriter(tmp_path / "a.mcap", chunk_bytes=10_000) as writer:
        writer.add_topic(SEAT, IMU_TYPE)
        writer.add_topic(HEAD, IMU_TYPE)
        for k in range(10):
            writer.write(SEAT, stamps + 100 * k, payload)
            assert writer._pending_bytes < 100_000
    with open_bag(tmp_path / "a.mcap") as bag:
        assert np.concatenate([b.log_ns for b in bag.blocks()]).tolist() == (START_NS + np.arange(1000)).tolist()


@given(
    st.lists(st.tuples(st.sampled_from([SEAT, HEAD]), st.lists(st.integers(0, 2**62), max_size=6)), max_size=8),
    st.sampled_from([1, 900, 1 << 20]),
)
def test_any_blocks_in_any_order_round_trip(tmp_path_factory, blocks, chunk_bytes):
    path = tmp_path_factory.mktemp("bag") / "a.mcap"
    expected: dict[str, list[tuple[int, bytes]]] = {}
    with BagWriter(path, "none", chunk_bytes) as writer:
        for topic in (SEAT, HEAD):
            writer.add_topic(topic, IMU_TYPE)
        for k, (topic, stamps) in enumerate(blocks):
            payload = np.full((len(stamps), 300 + len(topic)), k, dtype=np.uint8)
            writer.write(topic, np.array(stamps, dtype=np.int64), payload)
            if stamps:
                expected.setdefault(topic, []).extend(zip(stamps, map(bytes, payload), strict=True))
    with open_bag(path) as bag:
        found = read_ours(bag)
        assert {t: sorted(messages) for t, messages in found.items()} == {t: sorted(m) for t, m in expected.items()}
        assert bag.message_count == sum(map(len, expected.values()))


def test_an_empty_bag_is_a_bag(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic(SEAT, IMU_TYPE)
    with RosbagsReader(tmp_path / "a") as reader:
        assert reader.message_count == 0
    with open_bag(tmp_path / "a") as bag:
        assert (bag.message_count, bag.start_ns, bag.end_ns, bag.recovered) == (0, None, None, False)
        assert [(t.name, t.messages) for t in bag.topics] == [(SEAT, 0)]
        assert list(imu_blocks(bag, [SEAT])) == []


@pytest.mark.parametrize("name", ["a", "a.mcap"])
def test_a_failure_leaves_nothing_and_what_was_there(tmp_path, name):
    write_ours(tmp_path / name, RECORDING)
    before = {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    writer = BagWriter(tmp_path / name, overwrite=True)
    assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(InputError, match="not declared"), writer:
        writer.write(SEAT, np.arange(1), np.zeros((1, 4), np.uint8))
    assert {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()} == before
    with pytest.raises(InputError, match="exists already"):
        BagWriter(tmp_path / name)
    with BagWriter(tmp_path / name, overwrite=True) as writer:
        writer.add_topic(HEAD, IMU_TYPE)
    assert len(list(tmp_path.iterdir())) == 1
    with open_bag(tmp_path / name) as bag:
        assert [t.name for t in bag.topics] == [HEAD]


def test_what_cannot_be_written_is_refused(tmp_path):
    for path, options, message in [
        (tmp_path / "no" / "a.mcap", {}, "cannot be written"),
        (tmp_path / "a.db3", {}, "only MCAP can be written"),
        (tmp_path / "a.mcap", {"compression": "gzip"}, "none, lz4, zstd are allowed"),
    ]:
        with pytest.raises(InputError, match=message):
            BagWriter(path, **options)
    payload, stamps = np.zeros((2, 300), np.uint8), np.arange(2)
    with BagWriter(tmp_path / "a.mcap") as writer:
        assert writer.add_topic(SEAT, IMU_TYPE) == writer.add_topic(SEAT, IMU_TYPE) == 1
        with pytest.raises(InputError, match="another type"):
            writer.add_topic(SEAT, "std_msgs/msg/Float64")
        with pytest.raises(InputError, match="message type nobody/msg/Knows is unknown"):
            writer.add_topic(HEAD, "nobody/msg/Knows")
        with pytest.raises(InputError, match=f"topic {HEAD} is not declared"):
            writer.write(HEAD, stamps, payload)
        for bad in [(stamps, payload[:1]), (stamps * 1.0, payload), (stamps, payload * 1.0), (stamps, payload[:, :0])]:
            with pytest.raises(InputError, match=f"topic {SEAT}"):
                writer.write(SEAT, *bad)


# Imu blocks.


def merged(blocks: Iterable[tuple[str, cdr.ImuBlock]]) -> dict[str, list[int]]:
    found = defaultdict(list)
    for topic, block in blocks:
        found[topic] += block.stamps_ns.tolist()
    return dict(found)


@pytest.mark.parametrize("time", ["header", "log"])
def test_imu_blocks_are_the_decoded_messages(tmp_path, time):
    write_with_mcap(tmp_path / "a.mcap", RECORDING)
    with open_bag(tmp_path / "a.mcap") as bag:
        blocks = list(imu_blocks(bag, [ODD, SEAT], time, gyro=True))
        assert all(block.gyro_radps is None for _, block in imu_blocks(bag, [ODD, SEAT], time))
        assert {topic for topic, _ in blocks} == {ODD, SEAT}
        for topic in (ODD, SEAT):
            log_ns, data = zip(*by_topic(RECORDING)[topic], strict=True)
            expected = cdr.decode_imu(data, gyro=True)
            mine = [block for name, block in blocks if name == topic]
            stamps = np.concatenate([block.stamps_ns for block in mine])
            np.testing.assert_array_equal(stamps, expected.stamps_ns if time == "header" else log_ns)
            np.testing.assert_array_equal(np.concatenate([block.header_ns for block in mine]), expected.stamps_ns)
            np.testing.assert_array_equal(np.concatenate([block.log_ns for block in mine]), log_ns)
            np.testing.assert_array_equal(np.concatenate([b.accel_mps2 for b in mine]), expected.accel_mps2)
            np.testing.assert_array_equal(np.concatenate([b.gyro_radps for b in mine]), expected.gyro_radps)


def test_header_and_log_time_can_be_mixed_by_topic(tmp_path):
    write_with_mcap(tmp_path / "a.mcap", RECORDING)
    with open_bag(tmp_path / "a.mcap") as bag:
        found = merged(imu_blocks(bag, [SEAT, HEAD], {SEAT: "log", HEAD: "header"}))
        assert found == {
            SEAT: merged(imu_blocks(bag, [SEAT], "log"))[SEAT],
            HEAD: merged(imu_blocks(bag, [HEAD]))[HEAD],
        }


def arrangements() -> dict[str, Callable[[list[Logged]], list[Logged]]]:
    """The same messages, laid down in the file in different orders."""
    return {
        "in time": lambda messages: messages,
        "topic by topic": lambda messages: sorted(messages, key=lambda item: item[0]),
        "blocks": lambda messages: [m for lo in range(0, 1200, 300) for m in sorted(messages[lo : lo + 300])],
    }


@pytest.mark.parametrize("arrange", arrangements().values(), ids=arrangements())
@pytest.mark.parametrize("chunk_size", [1000, 20_000, 1 << 30])
def test_topics_advance_together_however_the_bag_is_chunked(tmp_path, arrange, chunk_size):
    write_with_mcap(tmp_path / "a.mcap", arrange(RECORDING), chunk_size=chunk_size)
    with open_bag(tmp_path / "a.mcap") as bag:
        slots = []
        for _, block in imu_blocks(bag, [SEAT, HEAD, ODD], "log"):
            slot = set((block.stamps_ns // SLICE_NS).tolist())
            assert len(slot) == 1
            slots.append(slot.pop())
        assert slots == sorted(slots)
        assert len(slots) == 3 * len(set(slots))  # and nothing is cut finer than that
        assert merged(imu_blocks(bag, [SEAT, HEAD, ODD], "log")) == {
            topic: [log_ns for log_ns, _ in messages] for topic, messages in by_topic(RECORDING).items()
        }


@given(st.lists(st.integers(0, 40), max_size=30), st.sampled_from([300, 1000, 1 << 20]))
def test_disorder_in_log_time_keeps_file_order_and_loses_nothing(tmp_path_factory, jumps, chunk_size):
    message = cdr.encode_imu(np.array([1]), np.zeros((1, 3)), np.zeros((1, 3)), "f").tobytes()
    messages = [(SEAT if i % 2 else HEAD, START_NS + j * 50_000_000, message) for i, j in enumerate(jumps)]
    path = tmp_path_factory.mktemp("bag") / "a.mcap"
    write_with_mcap(path, messages, chunk_size=chunk_size)
    with open_bag(path) as bag:
        found = merged(imu_blocks(bag, [t.name for t in bag.topics], "log"))
    for topic, expected in by_topic(messages).items():
        assert sorted(found[topic]) == sorted(log_ns for log_ns, _ in expected)
    if chunk_size == 1 << 20:
        assert found == {t: [log_ns for log_ns, _ in m] for t, m in by_topic(messages).items()}


def test_a_stretch_of_hours_without_messages_costs_nothing(tmp_path):
    messages = [(SEAT, log_ns, RECORDING[0][2]) for log_ns in (0, 10**18, 2**63 - 1)]
    write_with_mcap(tmp_path / "a.mcap", messages)
    with open_bag(tmp_path / "a.mcap") as bag:
        assert [len(block) for _, block in imu_blocks(bag, [SEAT])] == [1, 1, 1]


def test_wrong_wishes_are_refused_by_name(tmp_path):
    write_with_mcap(tmp_path / "a.mcap", [*RECORDING, (SEAT, RECORDING[-1][1], b"\0\1\0\0 no imu")])
    with BagWriter(tmp_path / "b.mcap") as writer:
        writer.add_topic("/exposure", "std_msgs/msg/Float64")
    with open_bag(tmp_path / "a.mcap") as bag:
        with pytest.raises(InputError, match=f"a.mcap: topic /none is not in the bag; topics there: {HEAD}"):
            bag.blocks(["/none"])
        with pytest.raises(InputError, match="time is 'stamp': use 'header'"):
            imu_blocks(bag, [SEAT], "stamp")
        with pytest.raises(InputError, match=rf"a.mcap: topic {SEAT}: message \d+ of \d+: 11 bytes"):
            list(imu_blocks(bag, [HEAD, SEAT]))
        assert len(merged(imu_blocks(bag, [HEAD]))[HEAD]) == 400
    with open_bag(tmp_path / "b.mcap") as bag, pytest.raises(InputError, match="/exposure is std_msgs/msg/Float64"):
        imu_blocks(bag, ["/exposure"])


# Cut and damaged files.


def whole_chunks(path: Path) -> list[tuple[int, int]]:
    """(end of the chunk record in the file, messages in it)."""
    with path.open("rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    return [
        (
            index.chunk_start_offset + index.chunk_length,
            (index.message_index_length - 15 * len(index.message_index_offsets)) // 16,
        )
        for index in indexes
    ]


@pytest.mark.parametrize("who", ["mcap", "ours"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_every_whole_chunk_before_the_cut_is_recovered(tmp_path, who, compression):
    whole = tmp_path / "whole.mcap"
    if who == "mcap":
        write_with_mcap(whole, RECORDING, compression=COMPRESSIONS[compression])
    else:
        write_ours(whole, RECORDING, compression=compression, chunk_bytes=20_000)
    expected = RECORDING if who == "mcap" else constant_size(RECORDING)
    data, chunks = whole.read_bytes(), whole_chunks(whole)
    ends = [end for end, _ in chunks]
    near = {end + d for end in ends[:4] for d in (-1, 0, 1, 9, 20)}
    cut = tmp_path / "cut.mcap"
    for at in sorted(near | set(np.linspace(0, len(data) - 1, 60, dtype=int).tolist())):
        cut.write_bytes(data[:at])
        count = sum(n for end, n in chunks if end <= at)
        if not count:
            with pytest.raises(InputError):
                open_bag(cut)
            continue
        with open_bag(cut) as bag:
            assert bag.recovered
            assert bag.message_count == count
            (warning,) = bag.warnings
            seconds = (expected[count - 1][1] - expected[0][1]) / 1e9
            assert f"cut.mcap: unfinished or cut: recovered {count} messages, up to {seconds:.3f} s" in warning
            assert read_ours(bag) == by_topic(expected[:count])


def test_every_whole_message_outside_of_chunks_is_recovered(tmp_path):
    write_with_mcap(tmp_path / "a.mcap", RECORDING, use_chunking=False)
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    with open_bag(tmp_path / "cut.mcap") as bag:
        assert bag.recovered
        assert 300 < bag.message_count < 900
        assert read_ours(bag) == by_topic(RECORDING[: bag.message_count])


def test_a_damaged_chunk_is_left_out_with_a_warning(tmp_path):
    write_with_mcap(tmp_path / "a.mcap", RECORDING)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    end, count = whole_chunks(tmp_path / "a.mcap")[2]
    data[end - 400 : end] = bytes(400)
    (tmp_path / "a.mcap").write_bytes(data)
    with open_bag(tmp_path / "a.mcap") as bag:
        assert not bag.recovered
        assert sum(map(len, read_ours(bag).values())) == 1200 - count
        assert bag.recovered
        assert len(bag.warnings) == 1
        assert "damaged and left out: zstd" in bag.warnings[0]


def test_a_cut_database_is_read_as_far_as_it_goes(tmp_path):
    """Up to its last whole page: a page that is cut reads as zeros, so that what lies in it only looks whole."""
    write_with_rosbags(tmp_path / "a", RECORDING, StoragePlugin.SQLITE3)
    data = (tmp_path / "a" / "a.db3").read_bytes()
    cut, refused = tmp_path / "cut.db3", 0
    for at in np.linspace(0, len(data) - 1, 60, dtype=int):
        cut.write_bytes(data[:at])
        try:
            with open_bag(cut) as bag:
                found = read_ours(bag)
                assert bag.recovered
                (warning,) = bag.warnings
        except InputError as error:
            assert str(cut) in str(error)  # noqa: PT017
            refused += 1
            continue
        count = sum(map(len, found.values()))
        assert found == by_topic(RECORDING[:count])
        assert bag.message_count == count >= 1200 * (at - 50_000) / len(data)
        seconds = (RECORDING[count - 1][1] - RECORDING[0][1]) / 1e9
        assert f"cut.db3: cut or damaged: recovered {count} messages, up to {seconds:.3f} s after the first" in warning
    assert refused < 10


def test_a_database_with_a_page_of_zeros_is_read_up_to_it(tmp_path):
    write_with_rosbags(tmp_path / "a", RECORDING, StoragePlugin.SQLITE3)
    data = bytearray((tmp_path / "a" / "a.db3").read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 4096] = bytes(4096)
    (tmp_path / "hurt.db3").write_bytes(data)
    with open_bag(tmp_path / "hurt.db3") as bag:
        found = read_ours(bag)
        assert bag.recovered
        assert 300 < bag.message_count < 900
        assert found == by_topic(RECORDING[: bag.message_count])


def test_a_cut_recording_without_metadata_is_recovered_too(tmp_path):
    (tmp_path / "drive").mkdir()
    write_with_mcap(tmp_path / "whole.mcap", RECORDING)
    data = (tmp_path / "whole.mcap").read_bytes()
    (tmp_path / "drive" / "drive_0.mcap").write_bytes(data[: len(data) * 6 // 10])
    with open_bag(tmp_path / "drive") as bag:
        assert bag.recovered
        assert read_ours(bag) == by_topic(RECORDING[: bag.message_count])
        assert "recovered" in bag.warnings[0]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("seed", range(15))
def test_flipped_bytes_lead_to_messages_or_an_input_error(tmp_path, compression, seed):
    write_with_mcap(tmp_path / "a.mcap", RECORDING[:120], compression=COMPRESSIONS[compression], chunk_size=9000)
    data = np.frombuffer((tmp_path / "a.mcap").read_bytes(), np.uint8).copy()
    rng = np.random.default_rng(seed)
    for _ in range(20):
        hurt = data.copy()
        # Lengths and offsets live near the chunks' ends and in the summary: hit those more often than payload.
        places = rng.integers(0, len(data), 3) if rng.random() < 0.5 else rng.integers(len(data) * 4 // 5, len(data), 3)
        hurt[places] = rng.choice([0, 1, 127, 255], 3)
        (tmp_path / "b.mcap").write_bytes(hurt.tobytes())
        try:
            with open_bag(tmp_path / "b.mcap") as bag:
                assert sum(map(len, read_ours(bag).values())) <= 10_000
                merged(imu_blocks(bag, [t.name for t in bag.topics]))
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize("size", [2**64 - 1, 2**63, 2**40, 2**31, 0, 17])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_that_lies_about_its_size_allocates_nothing(tmp_path, compression, size):
    write_with_mcap(tmp_path / "a.mcap", RECORDING, compression=COMPRESSIONS[compression], chunk_size=1 << 30)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    with (tmp_path / "a.mcap").open("rb") as stream:
        (index,) = make_reader(stream).get_summary().chunk_indexes
    at = index.chunk_start_offset
    assert struct.unpack_from("<q", data, at + 9)[0] == START_NS
    struct.pack_into("<Q", data, at + 25, size)
    (tmp_path / "a.mcap").write_bytes(data)
    with open_bag(tmp_path / "a.mcap") as bag:
        assert read_ours(bag) == {}
        assert "damaged and left out" in bag.warnings[0]


@pytest.mark.parametrize("field", ["offset", "length"])
def test_an_index_that_points_outside_is_not_followed(tmp_path, field):
    """The messages are then found by walking the chunk."""
    write_with_mcap(tmp_path / "a.mcap", RECORDING, compression=CompressionType.NONE, chunk_size=1 << 30)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    ((end, _),) = whole_chunks(tmp_path / "a.mcap")
    if field == "offset":
        struct.pack_into("<Q", data, end + 9 + 6 + 8, 2**64 - 5)
        (tmp_path / "a.mcap").write_bytes(data)
        with open_bag(tmp_path / "a.mcap") as bag:
            assert read_ours(bag) == by_topic(RECORDING)
    else:
        struct.pack_into("<I", data, end + 9 + 2, 2**32 - 1)
        (tmp_path / "a.mcap").write_bytes(data)
        with open_bag(tmp_path / "a.mcap") as bag:
            assert read_ours(bag) == {}
            assert "message index has a wrong length" in bag.warnings[0]


# Directories and files that are no bag.


def split_bag(path: Path, parts: int = 12) -> None:
    path.mkdir()
    step = len(RECORDING) // parts
    for k in range(parts):
        write_with_mcap(path / f"drive_{k}.mcap", RECORDING[k * step : (k + 1) * step])


def metadata_yaml(path: Path, names: Iterable[str], mode: str = "", form: str = "cdr") -> None:
    lines = ["rosbag2_bagfile_information:", "  version: 5", "  storage_identifier: mcap", "  relative_file_paths:"]
    lines += [f"    - {name}" for name in names]
    lines += ["  topics_with_message_count:", "    - topic_metadata:", f"        name: {SEAT}"]
    lines += [f"        type: {IMU_TYPE}", f"        serialization_format: {form}", "      message_count: 400"]
    lines += [f"  compression_mode: '{mode}'", "  compression_format: 'zstd'"]
    (path / "metadata.yaml").write_text("\n".join(lines))


@pytest.mark.parametrize("metadata", [True, False])
def test_a_split_bag_is_one_recording_in_order(tmp_path, metadata):
    split_bag(tmp_path / "drive")
    if metadata:
        metadata_yaml(tmp_path / "drive", [f"drive/drive_{k}.mcap" for k in range(12)])
    with open_bag(tmp_path / "drive") as bag:
        assert (bag.message_count, bag.warnings) == (1200, [])
        assert (bag.start_ns, bag.end_ns) == (RECORDING[0][1], RECORDING[-1][1])
        assert read_ours(bag) == by_topic(RECORDING)
        assert [t.messages for t in bag.topics] == [400, 400, 400]


def test_missing_parts_are_told(tmp_path):
    split_bag(tmp_path / "drive")
    metadata_yaml(tmp_path / "drive", [f"drive_{k}.mcap" for k in range(13)])
    with open_bag(tmp_path / "drive") as bag:
        assert bag.message_count == 1200
        assert bag.warnings == [
            f"{tmp_path / 'drive'}: drive_12.mcap is missing: its part of the recording is left out"
        ]


def test_a_renamed_file_is_used_with_a_warning(tmp_path):
    (tmp_path / "drive").mkdir()
    write_with_mcap(tmp_path / "drive" / "my_bag.mcap", RECORDING)
    metadata_yaml(tmp_path / "drive", ["../../../etc/drive_0.mcap"])
    with open_bag(tmp_path / "drive") as bag:
        assert bag.message_count == 1200
        assert "names drive_0.mcap, which is missing: my_bag.mcap is read instead" in bag.warnings[0]


@pytest.mark.parametrize("text", ["", "{", "a: 1", "rosbag2_bagfile_information: 3", "\0"])
def test_a_broken_metadata_file_is_a_warning(tmp_path, text):
    (tmp_path / "drive").mkdir()
    write_with_mcap(tmp_path / "drive" / "drive_0.mcap", RECORDING)
    (tmp_path / "drive" / "metadata.yaml").write_text(text)
    with open_bag(tmp_path / "drive") as bag:
        assert bag.message_count == 1200
        assert "metadata.yaml: not readable as rosbag2 metadata" in bag.warnings[0]


def test_what_is_no_bag_is_refused_in_one_line(tmp_path):
    for name in ("empty", "two", "both", "ros1", "zstd", "compressed", "foreign"):
        (tmp_path / name).mkdir()
    for name in ("two/a.mcap", "two/b.mcap", "both/a_0.mcap", "compressed/a.mcap", "foreign/a.mcap"):
        write_with_mcap(tmp_path / name, RECORDING[:10])
    with sqlite3.connect(tmp_path / "both/a_1.db3") as database:
        database.execute("CREATE TABLE a (b)")
    database.close()
    (tmp_path / "ros1/a.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "zstd/a.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd")
    metadata_yaml(tmp_path / "compressed", ["a.mcap"], mode="FILE")
    metadata_yaml(tmp_path / "foreign", ["a.mcap"], form="ros1")
    (tmp_path / "text.mcap").write_text("time,x,y,z\n")
    (tmp_path / "nothing.mcap").touch()
    for name, message in {
        "missing": "cannot be read",
        "empty": "no .mcap or .db3 file",
        "two": "several recordings.*a.mcap, b.mcap",
        "both": "both MCAP and sqlite3",
        "both/a_1.db3": "not a readable rosbag2 database",
        "ros1": "a ROS 1 bag",
        "ros1/a.bag": "a ROS 1 bag",
        "zstd": "compressed as a whole",
        "zstd/a.mcap.zstd": "compressed as a whole",
        "compressed": "compressed by file",
        "foreign": f"topic {SEAT} is serialized as 'ros1'",
        "text.mcap": "neither an MCAP nor a sqlite3 file",
        "nothing.mcap": "the file is empty",
    }.items():
        with pytest.raises(InputError, match=message) as caught:
            open_bag(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_bags_that_rosbags_compressed_by_file_or_message_are_refused(tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    for mode in (CompressionMode.FILE, CompressionMode.MESSAGE):
        writer = RosbagsWriter(tmp_path / mode.name, version=9)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            writer.write(writer.add_connection(SEAT, IMU_TYPE, typestore=store), 1, RECORDING[0][2])
        with pytest.raises(InputError, match=f"compressed by {mode.name.lower()}"):
            open_bag(tmp_path / mode.name)


def test_foreign_topics_beside_ros_topics_are_left_out(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        for topic, form in ((SEAT, "cdr"), ("/notes", "json")):
            channel = writer.register_channel(topic, form, writer.register_schema(IMU_TYPE, "ros2msg", b""))
            writer.add_message(channel, 5, b"x", 5)
        writer.finish()
    with open_bag(tmp_path / "a.mcap") as bag:
        assert [t.name for t in bag.topics] == [SEAT]
        assert read_ours(bag) == {SEAT: [(5, b"x")]}
        assert "topic /notes is serialized as 'json'" in bag.warnings[0]


@pytest.mark.parametrize("missing", ["mcap", "zstandard", "rosbags"])
def test_without_the_extra_the_module_loads_and_says_what_to_install(tmp_path, missing):
    write_with_mcap(tmp_path / "a.mcap", RECORDING)
    program = f"""
import sys
sys.modules[{missing!r}] = None
from biodyn_core.errors import InputError
from biodyn_ros.bag import BagWriter, open_bag
try:
    with open_bag({str(tmp_path / "a.mcap")!r}) as bag:
        list(bag.blocks())
    with BagWriter({str(tmp_path / "b.mcap")!r}) as writer:
        writer.add_topic("/a", "sensor_msgs/msg/Imu")
except InputError as error:
    print(error)
"""
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout == (
        f"bags need the Python module {missing}, which is not installed: pip install 'biodyn_ros[bags]'\n"
    )


# Real recordings.


@pytest.mark.parametrize(
    ("name", "messages"),
    [
        ("bags_odd/all_types/test_bag_mcap", 188),
        ("bags_odd/all_types/test_bag_sqlite3", 188),
        ("bags_odd/missing_file", 3878),
        ("bags_odd/plotjuggler", 4695),
        ("bags_odd/ros2_rosbag2/ros2bag/test/resources/empty_bag", 0),
        ("bags_odd/ros2_rosbag2/rosbag2_py/test/resources/mcap/reindex_test_bags/multiple_files", 3177),
        ("bags_odd/ros2_rosbag2/rosbag2_py/test/resources/mcap/talker", 20),
        ("bags_odd/ros2_rosbag2/rosbag2_py/test/resources/mcap/wbag", 6074),
        ("bags_odd/ros2_rosbag2/rosbag2_tests/resources/mcap/cdr_test", 7),
        ("rosbag2_real_imu/av_start_position_A", 3168),
        ("rosbag2_real_imu/byu_SO_bag", 2671),
    ],
)
def test_real_bags_are_read_whole(shared_data, name, messages):
    with open_bag(shared_data / name) as bag:
        found = read_ours(bag)
        assert bag.message_count == messages == sum(map(len, found.values()))
        assert not bag.recovered
        assert bool(bag.warnings) == (name == "bags_odd/missing_file")
    files = [f for f in (shared_data / name).iterdir() if f.suffix in (".mcap", ".db3")]
    theirs = by_topic(message for file in files for message in read_plainly(file))
    assert {t: sorted(m) for t, m in found.items()} == {t: sorted(m) for t, m in theirs.items()}


def read_plainly(file: Path) -> list[Logged]:
    if file.suffix == ".mcap":
        with file.open("rb") as stream:
            return [(channel.topic, m.log_time, m.data) for _, channel, m in make_reader(stream).iter_messages()]
    database = sqlite3.connect(f"{file.as_uri()}?immutable=1", uri=True)
    query = "SELECT name, timestamp, data FROM messages JOIN topics ON topic_id = topics.id"
    found = database.execute(query).fetchall()
    database.close()
    return found


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("bags_odd/mcap2arrow", "several recordings"),
        ("bags_odd/mcap2arrow/no_summary.mcap", "topic /decoded is serialized as 'json'"),
        ("bags_odd/mcap2arrow/with_summary.mcap", "topic /decoded is serialized as 'json'"),
        ("bags_odd/mcap_crate/chunk_not_closed.mcap", "cut before its first whole chunk"),
        ("bags_odd/mcap_crate/compressed.mcap", "is serialized as 'ros1'"),
        ("bags_odd/plotjuggler/tilt_laser.bag", "a ROS 1 bag"),
        ("bags_odd/ros2_rosbag2/rosbag2_tests/resources/mcap/wrong_rmw_test", "is serialized as 'wrong_format'"),
        ("bags_odd/ros2_rosbag2/rosbag2_tests/resources/sqlite3/wrong_rmw_test", "is serialized as 'wrong_format'"),
    ],
)
def test_real_files_that_cannot_be_read_say_why(shared_data, name, message):
    with pytest.raises(InputError, match=message):
        open_bag(shared_data / name)


def test_real_imus_decode_to_what_is_known_of_them(shared_data):
    with open_bag(shared_data / "rosbag2_real_imu/byu_SO_bag") as bag:
        blocks = [block for _, block in imu_blocks(bag, ["/coug2/modem_imu"], gyro=True)]
        rates = np.concatenate([b.gyro_radps for b in blocks])
        assert 25.0 < np.abs(rates).max() < 35.0  # SOURCE.txt: up to 29, clearly not rad/s, and nothing says so
        assert not np.concatenate([b.stamps_ns for b in blocks]).any()  # all stamps are zero: take log time
        norm = np.linalg.norm(np.concatenate([b.accel_mps2 for b in blocks]), axis=1)
        assert (len(norm), round(norm.mean(), 2)) == (161, 10.08)
        stamps = np.concatenate([b.stamps_ns for _, b in imu_blocks(bag, ["/coug2/modem_imu"], "log")])
        assert 9.8 < 1e9 / np.diff(stamps).mean() < 10.2
    with open_bag(shared_data / "rosbag2_real_imu/av_start_position_A") as bag:
        blocks = [block for _, block in imu_blocks(bag, ["/ins/imu"], gyro=True)]
        accel = np.concatenate([b.accel_mps2 for b in blocks])
        assert len(accel) == 1264
        assert round(accel[:, 0].mean(), 1) == -9.8
