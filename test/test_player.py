"""The player over real DDS: every message, in order, with stamps kept or moved, at the requested rate."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from mcap.writer import Writer
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros import Graph
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64, String

from biodyn_core.base.errors import InputError
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.bag.cdr import IMU_TYPE, decode_imu, encode_imu
from biodyn_ros.bag.storage import latched_depth
from biodyn_ros.play.outputs import is_output
from biodyn_ros.play.playback import Lap, played_on
from biodyn_ros.play.player import SETTLING_S, Player
from biodyn_ros.play.player_settings import PlayerSettings

COUNT = 300
START_NS = 1_700_000_000 * 10**9
STEP_NS = 1_000_000


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two topics at 1 kHz, 0.3 s, with an x acceleration that counts, and a y that is 1 on the second."""
    path = tmp_path / "bag.mcap"
    with BagWriter(path, chunk_bytes=1 << 16) as writer:
        for which, topic in enumerate(("imu/seat/data", "imu/head/data")):
            writer.add_topic(topic, IMU_TYPE)
            stamps = START_NS + np.arange(COUNT) * STEP_NS
            accel = np.column_stack([np.arange(COUNT), np.full(COUNT, which), np.zeros(COUNT)]).astype(float)
            writer.write(topic, stamps + 5_000_000, encode_imu(stamps, accel, np.zeros_like(accel), "imu"))
    return path


def play(
    graph: Graph, bag: Path, mapping: dict[str, str] | None = None, stamps: str = "header", **given: Any
) -> tuple[dict[str, Any], list[Any], Any]:
    """Play in a thread while the graph spins: (decoded samples by topic, clock messages, summary)."""
    tester = graph.node()
    got = {topic: graph.collect(tester, Imu, topic, raw=True) for topic in ("imu/seat/data", "imu/head/data")}
    clock = graph.collect(tester, Clock, "/clock")
    player = graph.add(Player(bag, PlayerSettings(**given), mapping=mapping, time=stamps, context=graph.context))
    assert player.wait_for_subscribers() == []
    result: list[Any] = []
    wanted = (2.5 if given.get("loop") else 1.0) * COUNT
    going = (lambda: any(len(messages) < wanted for messages in got.values())) if given.get("loop") else (lambda: True)
    thread = threading.Thread(target=lambda: result.append(player.play(going)))
    thread.start()
    graph.wait(lambda: all(len(messages) >= wanted for messages in got.values()), "all messages")
    thread.join(30.0)
    assert not thread.is_alive()
    return {topic: decode_imu(messages) for topic, messages in got.items()}, clock, result[0]


def test_stamps_move_to_now_and_keep_their_distances(graph: Graph, bag: Path) -> None:
    before = time.time_ns()
    got, clock, played = play(graph, bag)
    for block in got.values():
        np.testing.assert_array_equal(block.accel_mps2[:, 0], np.arange(COUNT))
        np.testing.assert_array_equal(np.diff(block.stamps_ns), STEP_NS)
        # The first message was logged 5 ms after its stamp, and is sent now.
        assert before - 5_000_000 <= block.stamps_ns[0] <= time.time_ns()
    assert clock == []
    assert played.messages == {"imu/seat/data": COUNT, "imu/head/data": COUNT}
    assert played.seconds >= 0.29


def test_with_keep_stamps_the_stamps_are_those_of_the_recording(graph: Graph, bag: Path) -> None:
    got, _, _ = play(graph, bag, keep_stamps=True)
    for block in got.values():
        np.testing.assert_array_equal(block.stamps_ns, START_NS + np.arange(COUNT) * STEP_NS)


def test_a_mapped_topic_is_played_by_log_time(graph: Graph, bag: Path) -> None:
    got, _, played = play(
        graph, bag, {"seat": "imu/head/data", "head": "imu/seat/data"}, "log", rate=1.0, keep_stamps=True
    )
    assert played.messages == {"imu/seat/data": COUNT, "imu/head/data": COUNT}
    for block, which in ((got["imu/seat/data"], 1.0), (got["imu/head/data"], 0.0)):
        np.testing.assert_array_equal(block.stamps_ns, START_NS + 5_000_000 + np.arange(COUNT) * STEP_NS)
        np.testing.assert_array_equal(block.accel_mps2[:, 1], which)


def test_a_mapped_topic_replaces_the_topic_of_that_sensor(bag: Path) -> None:
    with open_bag(bag) as reader:
        assert played_on(reader, {}) == {"imu/seat/data": "imu/seat/data", "imu/head/data": "imu/head/data"}
        assert played_on(reader, {"seat": "imu/head/data"}) == {"imu/head/data": "imu/seat/data"}
        with pytest.raises(
            InputError, match="--map seat=/floor: no such Imu topic; Imu topics: imu/seat/data, imu/head/d"
        ):
            played_on(reader, {"seat": "/floor"})


def test_the_rate_scales_time_and_the_clock_follows_the_bag(graph: Graph, bag: Path) -> None:
    _, clock, played = play(graph, bag, rate=0.5, clock=True, keep_stamps=True)
    assert played.seconds >= 0.59
    times = [nanoseconds(message) for message in clock]
    assert len(times) >= 25
    assert all(b > a for a, b in itertools.pairwise(times))
    assert START_NS <= times[0] <= times[-1] <= START_NS + 310_000_000


def test_a_loop_that_keeps_its_stamps_goes_back_and_its_clock_with_them(graph: Graph, bag: Path) -> None:
    got, clock, played = play(graph, bag, loop=True, keep_stamps=True, clock=True)
    seat = got["imu/seat/data"].stamps_ns
    assert (np.diff(seat) < 0).sum() >= 1
    assert set(seat.tolist()) == set((START_NS + np.arange(COUNT) * STEP_NS).tolist())
    assert played.messages["imu/seat/data"] >= COUNT
    assert min(b - a for a, b in itertools.pairwise(map(nanoseconds, clock))) < 0


def nanoseconds(message: Clock) -> int:
    return int(message.clock.sec * 10**9 + message.clock.nanosec)


HEAD_LATER_NS = 300_000
"""The head of the bag below samples so much later than the seat, and was recorded one sample more."""


@pytest.fixture
def uneven_bag(tmp_path: Path) -> Path:
    """As `bag`; the head begins later and ends later, messages reach the recorder with up to 7 ms of jitter."""
    path, rng = tmp_path / "uneven.mcap", np.random.default_rng(2)
    with BagWriter(path) as writer:
        for topic, later_ns, count in (("imu/seat/data", 0, COUNT), ("imu/head/data", HEAD_LATER_NS, COUNT + 1)):
            writer.add_topic(topic, IMU_TYPE)
            stamps = START_NS + later_ns + np.arange(count) * STEP_NS
            accel = np.column_stack([np.arange(count), np.zeros((count, 2))]).astype(float)
            logged = np.maximum.accumulate(stamps + rng.integers(0, 7_000_000, count))
            writer.write(topic, logged, encode_imu(stamps, accel, np.zeros_like(accel), "imu"))
    return path


@pytest.mark.parametrize("rate", [1.0, 3.0])
def test_laps_follow_each_other_after_one_period(graph: Graph, uneven_bag: Path, rate: float) -> None:
    got, clock, played = play(graph, uneven_bag, loop=True, clock=True, rate=rate)
    lap_ns = (COUNT + 1) * STEP_NS  # of the head, which lasts longest
    for topic, count in (("imu/seat/data", COUNT), ("imu/head/data", COUNT + 1)):
        stamps, numbers = got[topic].stamps_ns, got[topic].accel_mps2[:, 0]
        lap, place = np.divmod(np.arange(stamps.size), count)
        assert lap[-1] >= 1
        np.testing.assert_array_equal(numbers, place)
        np.testing.assert_array_equal(stamps - stamps[0], lap * lap_ns + place * STEP_NS)
    assert got["imu/head/data"].stamps_ns[0] - got["imu/seat/data"].stamps_ns[0] == HEAD_LATER_NS
    assert min(b - a for a, b in itertools.pairwise(map(nanoseconds, clock))) > 0
    # The last message sent is due so long after the first one.
    lasted_ns = min(block.stamps_ns[-1] - block.stamps_ns[0] for block in got.values())
    assert played.seconds >= 1e-9 * lasted_ns / rate - 0.01


def test_laps_have_the_length_of_log_time_without_usable_stamps() -> None:
    for stamps in ([0, 0, 0, 0], [0, 1, 2, 10**13]):  # never set; set again on the way
        lap = Lap(frozenset({"imu"}))
        for place, stamp_ns in enumerate(stamps):
            lap.note("imu", START_NS + 700_000_000 * place, stamp_ns)
        assert lap.length_ns() == 2_800_000_000
    lap = Lap(frozenset({"imu"}))
    lap.note("imu", START_NS, START_NS)
    assert lap.length_ns() == 10**9, "one message alone is repeated every second"


def test_a_longer_topic_lengthens_the_lap_and_a_slow_one_does_not() -> None:
    for slow_end_ns, wanted_ns in ((0, COUNT * STEP_NS), (1_000_000_000, 1_000_000_000)):
        lap = Lap(frozenset({"imu"}))
        for place in range(COUNT):
            lap.note("imu", START_NS + place * STEP_NS, place * STEP_NS)  # a clock that began at zero
        lap.note("slow", START_NS, START_NS)
        lap.note("slow", START_NS + slow_end_ns, START_NS + slow_end_ns)
        assert lap.length_ns() == wanted_ns


@pytest.mark.parametrize(("loop", "expected"), [(False, [(0, 299), (100, 299), (200, 299), (299, 299)]), (True, [])])
def test_progress_is_shown_for_a_bag_that_ends(
    graph: Graph, bag: Path, loop: bool, expected: list[tuple[int, int]]
) -> None:
    heard: list[tuple[int, int]] = []
    settings = PlayerSettings(wait_s=0.0, loop=loop)
    player = graph.add(Player(bag, settings, lambda done, total: heard.append((done, total)), context=graph.context))
    turns = iter(range(2 * COUNT))  # a loop ends in its second round
    player.play(lambda: not loop or next(turns, None) is not None)
    assert heard == expected


def test_topics_without_listener_are_named_after_the_wait(graph: Graph, bag: Path) -> None:
    player = graph.add(Player(bag, PlayerSettings(wait_s=0.2), context=graph.context))
    assert sorted(player.wait_for_subscribers()) == ["imu/head/data", "imu/seat/data"]


def test_an_empty_bag_is_refused(graph: Graph, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty.mcap"):
        pass
    with pytest.raises(InputError, match=r"empty\.mcap: the bag is empty"):
        Player(tmp_path / "empty.mcap", context=graph.context)


def test_subscribers_have_a_moment_before_the_first_message_and_behind_the_last(graph: Graph, bag: Path) -> None:
    tester = graph.node()
    for topic in ("imu/seat/data", "imu/head/data"):
        tester.create_subscription(Imu, topic, lambda message: None, 10)
    player = graph.add(Player(bag, context=graph.context))
    assert player.wait_for_subscribers() == []
    for waits in (player.wait_for_subscribers, player.flush):  # all are there, and nothing was sent
        began_s = time.monotonic()
        waits()
        assert time.monotonic() - began_s >= SETTLING_S


@pytest.fixture
def unset_bag(tmp_path: Path) -> Path:
    """As `bag`; the driver of the seat sets no stamps, that of the head sets one stamp on all messages."""
    path = tmp_path / "unset.mcap"
    with BagWriter(path) as writer:
        for topic, stamp_ns in (("imu/seat/data", 0), ("imu/head/data", START_NS)):
            writer.add_topic(topic, IMU_TYPE)
            stamps, zeros = np.full(COUNT, stamp_ns), np.zeros((COUNT, 3))
            writer.write(topic, START_NS + np.arange(COUNT) * STEP_NS, encode_imu(stamps, zeros, zeros, "imu"))
    return path


def test_the_time_of_the_recorder_replaces_stamps_that_no_driver_set(graph: Graph, unset_bag: Path) -> None:
    before = time.time_ns()
    got, _, played = play(graph, unset_bag)
    for block in got.values():
        np.testing.assert_array_equal(np.diff(block.stamps_ns), STEP_NS)
        assert before <= block.stamps_ns[0] <= time.time_ns()
    assert played.warnings == (
        "imu/seat/data: header stamps are zero: log time is used instead",
        "imu/head/data: header stamps do not change: log time is used instead",
    )


def test_with_keep_stamps_a_zero_stamp_stays_zero(graph: Graph, unset_bag: Path) -> None:
    got, _, played = play(graph, unset_bag, keep_stamps=True)
    assert not got["imu/seat/data"].stamps_ns.any()
    assert set(got["imu/head/data"].stamps_ns.tolist()) == {START_NS}
    assert played.warnings == ()


RECORDED = {
    "/biodyn/snapshot": String(data="{}"),
    "/car/biodyn_2/marks": String(data="mark 1"),
    "/biodyn/exposure/rolling/seat/vdv": Float64(data=1.0),
    "/diagnostics": DiagnosticArray(),
    "/clock": Clock(clock=Time(sec=7)),
}
"""A message of some outputs of a live node, of which one has another name, and of the clock."""

OTHERS = {"/cabin/note": String(data="rain"), "/cabin/snapshot": Float64(data=2.0), "/cabin/diagnostics": String()}
"""Topics of other nodes; the name or the type differs from that of every output."""


@pytest.fixture
def whole_bag(bag: Path, tmp_path: Path) -> Path:
    """The sensors of `bag`, and a message of every other topic, as `ros2 bag record -a` records beside a live node."""
    path = tmp_path / "whole.mcap"
    with open_bag(bag) as reader, BagWriter(path) as writer:
        for topic in ("imu/seat/data", "imu/head/data"):
            writer.add_topic(topic, IMU_TYPE)
        for block in reader.blocks():
            writer.write(
                block.topic, block.log_ns, np.stack([np.frombuffer(one, np.uint8) for one in block.messages()])
            )
        for topic, message in (RECORDED | OTHERS).items():
            package = type(message).__module__.partition(".")[0]
            writer.add_topic(topic, f"{package}/msg/{type(message).__name__}")
            writer.write(topic, np.array([START_NS]), np.frombuffer(serialize_message(message), np.uint8)[None])
    return path


def test_recorded_outputs_of_a_live_node_are_not_played_as_those_of_the_present(
    graph: Graph, whole_bag: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    others = graph.node("others")
    got = {
        topic: graph.collect(others, type(message), topic)
        for topic, message in (RECORDED | OTHERS).items()
        if topic != "/clock"
    }
    _, clock, played = play(graph, whole_bag, clock=True)
    graph.wait(lambda: all(got[topic] for topic in OTHERS), "topics of other nodes")
    assert {topic for topic, messages in got.items() if messages} == set(OTHERS)
    assert set(played.messages) == {"imu/seat/data", "imu/head/data", *OTHERS}
    assert all(message.clock.sec > 7 for message in clock)
    (line,) = [line for line in capfd.readouterr().err.splitlines() if "not played" in line]
    assert line.endswith(
        f"{', '.join(RECORDED)}: not played: the live node and the player publish these topics themselves"
    )


LATCHED = """- history: 1
  depth: 1
  reliability: 1
  durability: {}
"""


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize(("durability", "late"), [("1", ["<robot/>"]), ("transient_local", ["<robot/>"]), ("2", [])])
def test_a_latched_topic_reaches_late_subscribers(
    graph: Graph, tmp_path: Path, storage: str, durability: str, late: list[str]
) -> None:
    path, profiles = tmp_path / "bag", LATCHED.format(durability)
    messages = [serialize_message(String(data=text)) for text in ("<old/>", "<robot/>")]
    if storage == "mcap":
        path = tmp_path / "bag.mcap"
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros2")
            schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
            channel = writer.register_channel("/description", "cdr", schema, {"offered_qos_profiles": profiles})
            for message in messages:
                writer.add_message(channel, START_NS, message, START_NS)
            writer.finish()
    else:
        path.mkdir()
        with contextlib.closing(sqlite3.connect(path / "bag_0.db3")) as database:
            database.execute("CREATE TABLE topics(id INTEGER, name, type, serialization_format, offered_qos_profiles)")
            database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp INTEGER, data)")
            database.execute(
                "INSERT INTO topics VALUES(1, '/description', 'std_msgs/msg/String', 'cdr', ?)", (profiles,)
            )
            for number, message in enumerate(messages):
                database.execute("INSERT INTO messages VALUES(?, 1, ?, ?)", (number + 1, START_NS, message))
            database.commit()
        path = path / "bag_0.db3"
    player = graph.add(Player(path, PlayerSettings(wait_s=0.0), context=graph.context))
    assert player.play().messages == {"/description": 2}
    qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    got: list[String] = []
    subscriber = graph.node("late")
    subscriber.create_subscription(String, "/description", got.append, qos)
    control: list[String] = []
    subscriber.create_subscription(String, "/control", control.append, qos)
    publisher = graph.node("control").create_publisher(String, "/control", qos)
    publisher.publish(String(data="latched"))
    graph.wait(lambda: bool(control) and (not late or bool(got)), "latched messages")
    assert [one.data for one in got] == late


@pytest.mark.parametrize(
    ("profiles", "depth"),
    [
        (LATCHED.format("1"), 1),
        (LATCHED.format("transient_local") + LATCHED.format("2") + LATCHED.format("1"), 2),
        (LATCHED.format("1").replace("depth: 1", "depth: 0"), 10),
        (LATCHED.format("1").replace("depth: 1", "depth: 100000"), 100),
        (LATCHED.format("volatile"), 0),
        (LATCHED.format("11"), 0),
        ("", 0),
        (None, 0),
    ],
)
def test_as_many_messages_are_latched_as_the_recorded_publishers_kept(profiles: object, depth: int) -> None:
    assert latched_depth(profiles) == depth


def test_a_recorded_clock_is_played_unless_the_player_publishes_one(graph: Graph, whole_bag: Path) -> None:
    for clock in (False, True):
        settings = PlayerSettings(clock=clock, wait_s=0.0)
        player = graph.add(Player(whole_bag, settings, context=graph.context))
        assert ("/clock" in player.wait_for_subscribers()) == (not clock)


def test_a_bag_of_outputs_only_is_refused(graph: Graph, whole_bag: Path, tmp_path: Path) -> None:
    with open_bag(whole_bag) as reader, BagWriter(tmp_path / "outputs.mcap") as writer:
        writer.add_topic("/biodyn/snapshot", "std_msgs/msg/String")
        for block in reader.blocks(["/biodyn/snapshot"]):
            writer.write(block.topic, block.log_ns, np.frombuffer(block.messages()[0], np.uint8)[None])
    with pytest.raises(InputError, match=r"outputs\.mcap: no topic of the bag can be played"):
        Player(tmp_path / "outputs.mcap", context=graph.context)


def test_every_topic_that_the_live_node_publishes_is_known_as_its_output(graph: Graph) -> None:
    node = graph.active(("-r", "__ns:=/car", "-r", "__node:=second"), state_file="none")
    published = dict(node.get_publisher_names_and_types_by_node("second", "/car"))
    of_ros = {"/rosout", "/parameter_events", "/car/second/transition_event"}
    assert len(published) > 40
    assert {name for name, (kind,) in published.items() if not is_output(name, kind)} == of_ros


@pytest.fixture
def damaged_bag(bag: Path) -> Path:
    """The bag, of which some bytes of one chunk are inverted; its summary is whole."""
    with bag.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    data = bytearray(bag.read_bytes())
    assert len(chunks) > 2
    begin = chunks[-1].chunk_start_offset + 100
    data[begin : begin + 100] = bytes(255 - byte for byte in data[begin : begin + 100])
    bag.write_bytes(data)
    return bag


def test_a_chunk_found_damaged_while_playing_is_reported_once(
    graph: Graph, damaged_bag: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with open_bag(damaged_bag) as reader:
        assert reader.warnings == [], "opening reads no chunk"
    settings = PlayerSettings(wait_s=0.0, loop=True, rate=100.0)
    player = graph.add(Player(damaged_bag, settings, context=graph.context))
    end_s = time.monotonic() + 2.0
    played = player.play(lambda: time.monotonic() < end_s)
    sent = set(played.messages.values())
    assert min(sent) > COUNT, "more than one lap"
    (line,) = played.warnings
    assert "is damaged and omitted" in line
    assert capfd.readouterr().err.count("is damaged and omitted") == 1


def test_the_command_reports_what_it_omits_with_its_result(graph: Graph, damaged_bag: Path) -> None:
    words = ("play", str(damaged_bag), "--wait-s", "0", "--json")
    done = subprocess.run(
        [sys.executable, "-m", "biodyn_ros.commands.cli", *words],
        env=os.environ | {"ROS_DOMAIN_ID": str(graph.context.get_domain_id())},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert 0 < sum(result["messages"].values()) < 2 * COUNT
    (line,) = result["warnings"]
    assert line.startswith(f"{damaged_bag}: the chunk at byte ")
    assert line in done.stderr


@pytest.fixture
def odd_bag(bag: Path, tmp_path: Path) -> Path:
    """The sensors of `bag`, topics with names that MCAP allows and ROS does not, and channels of unusable types."""
    path = tmp_path / "odd.mcap"
    with open_bag(bag) as reader, path.open("wb") as stream:
        blocks = list(reader.blocks())
        writer = Writer(stream)
        writer.start("ros2", "test")
        imu = writer.register_schema(IMU_TYPE, "ros2msg", b"")
        names = {block.topic: block.topic for block in blocks} | dict.fromkeys(REFUSED, "imu/seat/data")
        for topic, source in names.items():
            channel = writer.register_channel(topic, "cdr", imu)
            for block in blocks:
                for log_ns, message in zip(block.log_ns.tolist(), block.messages(), strict=True):
                    if block.topic == source:
                        writer.add_message(channel, log_ns, message, log_ns)
        for topic, kind in UNUSABLE.items():
            schema = writer.register_schema(kind, "ros2msg", b"") if kind else 0
            writer.add_message(writer.register_channel(topic, "cdr", schema), START_NS, bytes(12), START_NS)
        writer.finish()
    return path


REFUSED = ("/imu-1/head/data", "//head", "/1st", "/{unknown}/data", "/ends/", "/" + 300 * "long")
"""Names of topics that ROS refuses."""

UNUSABLE = {"/no_type": "", "/no_package": ".msg/msg/Imu", "/one_word": "Imu", "/os": "os/msg/path", "/srv": "a/srv/b"}
"""Topics whose types are no message types, or are not installed."""


def test_a_topic_that_cannot_be_published_does_not_stop_the_others(graph: Graph, odd_bag: Path) -> None:
    _, _, played = play(graph, odd_bag)
    assert played.messages == {"imu/seat/data": COUNT, "imu/head/data": COUNT}
    assert [line.partition(": not played: ")[0] for line in played.warnings] == [*REFUSED, *UNUSABLE]
    assert all("\n" not in line for line in played.warnings)
