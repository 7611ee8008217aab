"""Marks: on the live page and in the results of a replay."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from streams import START_NS, noisy_streams, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, STANDARD_GRAVITY_MPS2
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, STRING_TYPE, decode_string, encode_imu
from biodyn_ros.base import topics
from biodyn_ros.node.health import MARKS_SHOWN, HealthMonitor
from biodyn_ros.replay.replaying import replay, replay_to_directory
from biodyn_ros.replay.text import summary

LATE_NS = 7_000_000
"""By how much the recorder's clock is ahead of the sensors'."""


def string(text: str, order: str = "little") -> bytes:
    """A std_msgs/String as CDR."""
    data = text.encode() + b"\0"
    return bytes([0, order == "little", 0, 0]) + len(data).to_bytes(4, order) + data


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A seat's recording, with two marks of a node in a namespace."""
    (seat,) = (stream for stream in noisy_streams() if stream.sensor == SEAT)
    path = tmp_path / "bag.mcap"
    with BagWriter(path) as writer:
        writer.add_topic(topics.INPUT[SEAT], IMU_TYPE)
        messages = encode_imu(seat.stamps_ns, seat.accel_mps2, seat.gyro_radps, "imu")
        writer.write(topics.INPUT[SEAT], seat.stamps_ns + LATE_NS, messages)
        writer.add_topic("/car/biodyn/marks", STRING_TYPE)
        for number, after_s in ((1, 1.25), (2, 3.5)):
            at_ns = np.array([seat.stamps_ns[0] + LATE_NS + int(after_s * 1e9)])
            writer.write("/car/biodyn/marks", at_ns, np.frombuffer(string(f"mark {number}"), np.uint8)[None])
    return path


def test_a_replay_lists_the_marks_of_the_recording(bag: Path, tmp_path: Path) -> None:
    replayed = replay_to_directory(bag, subject(), tmp_path / "out")
    document = json.loads((tmp_path / "out" / "exposure.json").read_text(encoding="utf-8"))
    assert document["marks"] == [
        {"name": "mark 1", "time_s": pytest.approx(1.25)},
        {"name": "mark 2", "time_s": pytest.approx(3.5)},
    ]
    assert "marked: mark 1 at 1.250 s, mark 2 at 3.500 s" in summary(replayed.report)
    assert "<td>mark 2</td><td>3.500</td>" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_marks_count_from_the_seat_though_another_sensor_began_earlier(bag: Path, tmp_path: Path) -> None:
    """The head was recorded from 30 s before the first sample of the seat on; a part counts from its begin."""
    early = tmp_path / "early.mcap"
    with open_bag(bag) as reader, BagWriter(early) as writer:
        assert reader.start_ns is not None
        head_ns = reader.start_ns - 30 * 10**9 + 10**7 * np.arange(1000)
        writer.add_topic(topics.INPUT["head"], IMU_TYPE)
        still = np.tile([0.0, 0.0, STANDARD_GRAVITY_MPS2], (head_ns.size, 1))
        writer.write(topics.INPUT["head"], head_ns, encode_imu(head_ns - LATE_NS, still, 0.0 * still, "imu"))
        for block in reader.blocks():
            writer.add_topic(block.topic, block.type)
            messages = np.frombuffer(b"".join(block.messages()), np.uint8).reshape(len(block), -1)
            writer.write(block.topic, block.log_ns, messages)
    marks = replay(early, subject()).report.marks
    assert [mark.time_s for mark in marks] == [pytest.approx(1.25), pytest.approx(3.5)]
    (mark,) = replay(f"{early}@1.5..4.5", subject()).report.marks
    assert mark == ("mark 2", pytest.approx(2.0))


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_string_is_read_in_either_byte_order(order: str) -> None:
    assert decode_string(string("Bordstein, größer", order)) == "Bordstein, größer"


@pytest.mark.parametrize(
    "message", [b"", string("mark 1")[:-1], string("mark 1")[:7], b"\x00\x02" + string("mark 1")[2:]]
)
def test_a_string_that_is_cut_is_refused(message: bytes) -> None:
    with pytest.raises(InputError, match="std_msgs/msg/String: the message is cut"):
        decode_string(message)


def test_the_latest_marks_are_shown_newest_first() -> None:
    monitor = HealthMonitor(Pipeline(subject()), {})
    for number in range(MARKS_SHOWN + 2):
        mark = monitor.mark(START_NS * 1e-9 + number)
    assert mark.name == f"mark {MARKS_SHOWN + 2}"
    assert [mark.name for mark in monitor.marks] == [f"mark {number}" for number in range(MARKS_SHOWN + 2, 2, -1)]
    assert str(monitor.marks[0]) == f"mark {MARKS_SHOWN + 2} at {START_NS * 1e-9 + MARKS_SHOWN + 1:.3f} s"
