"""Bags against mcap's and rosbags' own writers and readers, both ways, and real recordings."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from logged import (
    COMPRESSIONS,
    HEAD,
    ODD,
    RECORDING,
    SEAT,
    START_NS,
    Logged,
    by_topic,
    constant_size,
    merged,
    read_ours,
    write_ours,
    write_with_mcap,
    write_with_rosbags,
)
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from biodyn_core.base.errors import InputError
from biodyn_ros.bag import SLICE_NS, BagWriter, cdr, imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE

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
def test_bags_of_mcap_are_read_to_the_byte(tmp_path, compression, options):
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
def test_bags_of_rosbags_are_read_to_the_byte(tmp_path, plugin):
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


def test_reading_a_database_creates_no_files(tmp_path):
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
@pytest.mark.parametrize("block", [1, 1000])
def test_mcap_and_rosbags_read_written_bags(tmp_path, compression, chunk_bytes, block):
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
    monkeypatch.setattr("biodyn_ros.bag.writer._MAX_PENDING_BYTES", 50_000)
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


def test_an_empty_bag_is_written_and_read(tmp_path):
    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic(SEAT, IMU_TYPE)
    with RosbagsReader(tmp_path / "a") as reader:
        assert reader.message_count == 0
    with open_bag(tmp_path / "a") as bag:
        assert (bag.message_count, bag.start_ns, bag.end_ns, bag.recovered) == (0, None, None, False)
        assert [(t.name, t.messages) for t in bag.topics] == [(SEAT, 0)]
        assert list(imu_blocks(bag, [SEAT])) == []


@pytest.mark.parametrize("name", ["a", "a.mcap"])
def test_a_failure_leaves_earlier_files_and_no_new_ones(tmp_path, name):
    write_ours(tmp_path / name, RECORDING)
    before = {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    with pytest.raises(InputError, match="not declared"), BagWriter(tmp_path / name, overwrite=True) as writer:
        writer.write(SEAT, np.arange(1), np.zeros((1, 4), np.uint8))
    assert {f: f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()} == before
    with pytest.raises(InputError, match="exists already"):
        BagWriter(tmp_path / name)
    with BagWriter(tmp_path / name, overwrite=True) as writer:
        writer.add_topic(HEAD, IMU_TYPE)
    assert len(list(tmp_path.iterdir())) == 1
    with open_bag(tmp_path / name) as bag:
        assert [t.name for t in bag.topics] == [HEAD]


def test_invalid_messages_are_refused_by_the_writer(tmp_path):
    with pytest.raises(InputError, match="cannot be written"), BagWriter(tmp_path / "no" / "a.mcap"):
        pass
    for path, options, message in [
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


def test_hours_without_messages_take_no_time(tmp_path):
    messages = [(SEAT, log_ns, RECORDING[0][2]) for log_ns in (0, 10**18, 2**63 - 1)]
    write_with_mcap(tmp_path / "a.mcap", messages)
    with open_bag(tmp_path / "a.mcap") as bag:
        assert [len(block) for _, block in imu_blocks(bag, [SEAT])] == [1, 1, 1]


def test_invalid_options_are_refused_by_name(tmp_path):
    write_with_mcap(tmp_path / "a.mcap", [*RECORDING, (SEAT, RECORDING[-1][1], b"\0\1\0\0 no imu")])
    with BagWriter(tmp_path / "b.mcap") as writer:
        writer.add_topic("/exposure", "std_msgs/msg/Float64")
    with open_bag(tmp_path / "a.mcap") as bag:
        with pytest.raises(InputError, match=f"a.mcap: topic /none is not in the bag; its topics: {HEAD}"):
            bag.blocks(["/none"])
        with pytest.raises(InputError, match="time is 'stamp': use 'header'"):
            imu_blocks(bag, [SEAT], "stamp")
        with pytest.raises(InputError, match=rf"a.mcap: topic {SEAT}: message \d+ of \d+: 11 bytes"):
            list(imu_blocks(bag, [HEAD, SEAT]))
        assert len(merged(imu_blocks(bag, [HEAD]))[HEAD]) == 400
    with open_bag(tmp_path / "b.mcap") as bag, pytest.raises(InputError, match="/exposure is std_msgs/msg/Float64"):
        imu_blocks(bag, ["/exposure"])


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
        ("bags_odd/mcap_crate/chunk_not_closed.mcap", "cut before its first complete chunk"),
        ("bags_odd/mcap_crate/compressed.mcap", "is serialized as 'ros1'"),
        ("bags_odd/plotjuggler/tilt_laser.bag", "a ROS 1 bag"),
        ("bags_odd/ros2_rosbag2/rosbag2_tests/resources/mcap/wrong_rmw_test", "is serialized as 'wrong_format'"),
        ("bags_odd/ros2_rosbag2/rosbag2_tests/resources/sqlite3/wrong_rmw_test", "is serialized as 'wrong_format'"),
    ],
)
def test_real_files_that_cannot_be_read_say_why(shared_data, name, message):
    with pytest.raises(InputError, match=message):
        open_bag(shared_data / name)


def test_real_imus_decode_to_their_known_values(shared_data):
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
