"""The player over real DDS: every message, in order, with stamps kept or moved, at the pace asked for."""

from __future__ import annotations

import itertools
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros import Graph
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from biodyn_core.errors import InputError
from biodyn_ros.bag import BagWriter, open_bag
from biodyn_ros.cdr import IMU_TYPE, decode_imu, encode_imu
from biodyn_ros.playback import played_on
from biodyn_ros.player import MOMENT_S, Player
from biodyn_ros.player_settings import PlayerSettings

COUNT = 300
START_NS = 1_700_000_000 * 10**9
STEP_NS = 1_000_000


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two topics at 1 kHz, 0.3 s, with an x acceleration that counts, and a y that is 1 on the second."""
    path = tmp_path / "bag.mcap"
    with BagWriter(path) as writer:
        for which, topic in enumerate(("imu/seat/data", "imu/head/data")):
            writer.add_topic(topic, IMU_TYPE)
            stamps = START_NS + np.arange(COUNT) * STEP_NS
            accel = np.column_stack([np.arange(COUNT), np.full(COUNT, which), np.zeros(COUNT)]).astype(float)
            writer.write(topic, stamps + 5_000_000, encode_imu(stamps, accel, np.zeros_like(accel), "imu"))
    return path


def play(
    graph: Graph, bag: Path, mapping: dict[str, str] | None = None, stamps: str = "header", **given: Any
) -> tuple[dict[str, Any], list[Any], Any]:
    """Play in a thread while the graph spins: (decoded samples by topic, clock messages, what was played)."""
    tester = graph.node()
    got = {topic: graph.collect(tester, Imu, topic, raw=True) for topic in ("imu/seat/data", "imu/head/data")}
    clock = graph.collect(tester, Clock, "/clock")
    player = graph.add(Player(bag, PlayerSettings(**given), mapping=mapping, time=stamps, context=graph.context))
    assert player.wait_for_subscribers() == []
    result: list[Any] = []
    loops = 2 if given.get("loop") else 1
    going = (lambda: len(got["imu/head/data"]) < 2 * COUNT) if given.get("loop") else (lambda: True)
    thread = threading.Thread(target=lambda: result.append(player.play(going)))
    thread.start()
    graph.wait(lambda: all(len(messages) >= loops * COUNT for messages in got.values()), "all messages")
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


def test_kept_stamps_are_those_of_the_recording(graph: Graph, bag: Path) -> None:
    got, _, _ = play(graph, bag, keep_stamps=True)
    for block in got.values():
        np.testing.assert_array_equal(block.stamps_ns, START_NS + np.arange(COUNT) * STEP_NS)


def test_a_topic_is_played_as_the_sensor_it_is_given_as_by_the_recorder_s_clock(graph: Graph, bag: Path) -> None:
    got, _, played = play(
        graph, bag, {"seat": "imu/head/data", "head": "imu/seat/data"}, "log", rate=1.0, keep_stamps=True
    )
    assert played.messages == {"imu/seat/data": COUNT, "imu/head/data": COUNT}
    for block, which in ((got["imu/seat/data"], 1.0), (got["imu/head/data"], 0.0)):
        np.testing.assert_array_equal(block.stamps_ns, START_NS + 5_000_000 + np.arange(COUNT) * STEP_NS)
        np.testing.assert_array_equal(block.accel_mps2[:, 1], which)


def test_what_is_given_as_a_sensor_takes_the_place_of_the_topic_of_that_name(bag: Path) -> None:
    with open_bag(bag) as reader:
        assert played_on(reader, {}) == {"imu/seat/data": "imu/seat/data", "imu/head/data": "imu/head/data"}
        assert played_on(reader, {"seat": "imu/head/data"}) == {"imu/head/data": "imu/seat/data"}
        with pytest.raises(
            InputError, match="--map seat=/floor: no such Imu topic; there is imu/seat/data, imu/head/d"
        ):
            played_on(reader, {"seat": "/floor"})


def test_slower_is_slower_and_the_clock_follows_the_bag(graph: Graph, bag: Path) -> None:
    _, clock, played = play(graph, bag, rate=0.5, clock=True, keep_stamps=True)
    assert played.seconds >= 0.59
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clock]
    assert len(times) >= 25
    assert all(b > a for a, b in itertools.pairwise(times))
    assert START_NS <= times[0] <= times[-1] <= START_NS + 310_000_000


def test_a_loop_starts_again(graph: Graph, bag: Path) -> None:
    got, _, played = play(graph, bag, loop=True, keep_stamps=True)
    seat = got["imu/seat/data"].stamps_ns
    assert (np.diff(seat) < 0).sum() >= 1
    assert played.messages["imu/seat/data"] >= COUNT


@pytest.mark.parametrize(("loop", "told"), [(False, [(0, 299), (100, 299), (200, 299), (299, 299)]), (True, [])])
def test_how_far_it_is_is_told_of_a_bag_that_ends(
    graph: Graph, bag: Path, loop: bool, told: list[tuple[int, int]]
) -> None:
    heard: list[tuple[int, int]] = []
    settings = PlayerSettings(wait_s=0.0, loop=loop)
    player = graph.add(Player(bag, settings, lambda done, total: heard.append((done, total)), context=graph.context))
    turns = iter(range(2 * COUNT))  # a loop ends in its second round
    player.play(lambda: not loop or next(turns, None) is not None)
    assert heard == told


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
        assert time.monotonic() - began_s >= MOMENT_S
