"""Bags that are cut, damaged, hostile, split or invalid: intact parts are read, and the rest is reported."""

from __future__ import annotations

import sqlite3
import struct
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from logged import (
    COMPRESSIONS,
    RECORDING,
    SEAT,
    START_NS,
    by_topic,
    constant_size,
    merged,
    read_ours,
    write_ours,
    write_with_mcap,
    write_with_rosbags,
)
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

from biodyn_core.base.errors import InputError
from biodyn_ros.bag import imu_blocks, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE

ROOT = Path(__file__).resolve().parents[1]


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


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_flipped_bit_leads_to_no_wrong_message(tmp_path, compression):
    """The summary is whole; each chunk states the checksum of its content."""
    path, damaged = tmp_path / "whole.mcap", tmp_path / "damaged.mcap"
    write_with_mcap(path, RECORDING, compression=COMPRESSIONS[compression])
    with open_bag(path) as reader:
        expected = {topic: set(messages) for topic, messages in read_ours(reader).items()}
    with path.open("rb") as stream:
        indexes = make_reader(stream).get_summary().chunk_indexes
    assert len(indexes) > 5
    whole, rng = path.read_bytes(), np.random.default_rng(3)
    for index in indexes:
        bits = bytearray(whole)
        at = index.chunk_start_offset + 100 + int(rng.integers(index.chunk_length - 150))
        bits[at] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(bits)
        with open_bag(damaged) as reader:
            found = read_ours(reader)
            warned = any("damaged" in line for line in reader.warnings)
        assert all(set(messages) <= expected[topic] for topic, messages in found.items())
        assert warned and sum(map(len, found.values())) < sum(map(len, expected.values()))


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
        assert "damaged and omitted: zstd" in bag.warnings[0]


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
def test_a_chunk_with_a_false_size_allocates_nothing(tmp_path, compression, size):
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
        assert "damaged and omitted" in bag.warnings[0]


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


def test_missing_parts_are_reported(tmp_path):
    split_bag(tmp_path / "drive")
    metadata_yaml(tmp_path / "drive", [f"drive_{k}.mcap" for k in range(13)])
    with open_bag(tmp_path / "drive") as bag:
        assert bag.message_count == 1200
        assert bag.warnings == [f"{tmp_path / 'drive'}: drive_12.mcap is missing: its part of the recording is omitted"]


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


def test_other_files_are_refused_in_one_line(tmp_path):
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
        "zstd": "whole files are compressed",
        "zstd/a.mcap.zstd": "the whole file is compressed",
        "compressed": "compression by file",
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
        with pytest.raises(InputError, match=f"compression by {mode.name.lower()}"):
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
def test_without_the_extra_the_module_loads_and_names_the_package_to_install(tmp_path, missing):
    write_with_mcap(tmp_path / "a.mcap", RECORDING)
    program = f"""
import sys
sys.modules[{missing!r}] = None
from biodyn_core.base.errors import InputError
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
