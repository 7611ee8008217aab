"""Bags through two processes over DDS: the live node publishes the results of replay."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import AccelStamped
from ros import STARTUP_S, child, ros_graph
from std_msgs.msg import Float64
from streams import accel_stamped, noisy_streams, subject, write_bag
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.body.synthesis import ImuStream
from biodyn_ros.base import topics
from biodyn_ros.base.environment import hold_domain
from biodyn_ros.base.resources import bag_file
from biodyn_ros.commands.cli import main
from biodyn_ros.replay.replaying import replay

BAG_DEPTH = 200_000
ARRIVES_WITHIN_S = 120.0


def reliable(inputs: Iterable[str], outputs: Iterable[str] = ()) -> list[str]:
    """Overrides that make the node's inputs and outputs lossless and deep enough for the whole bag.

    A process that waits for the processor loses messages, and reliable DDS repeats them up to five seconds later, each
    topic by itself (measured beside four busy processes): comparisons wait for that.
    """
    given = ["wait_s:=10.0"]
    for topic in inputs:
        prefix = f"qos_overrides./{topic}.subscription"
        given += [f"{prefix}.reliability:=reliable", f"{prefix}.depth:={BAG_DEPTH}"]
    given += [f"qos_overrides.{topics.absolute(topic)}.publisher.depth:={BAG_DEPTH}" for topic in outputs]
    return [word for parameter in given for word in ("-p", parameter)]


@cache
def offline(bag: Path) -> tuple[dict[str, dict[int, float]], dict[int, Any], Any]:
    """Every frame of the replay by topic and stamp, the motion by stamp, and the document."""
    motion: dict[int, Any] = {}
    frames: dict[str, dict[int, float]] = {t: {} for t in (*topics.PREDICTED.values(), *topics.MEASURED.values())}

    def keep(names: dict[str, str], stamps_ns: np.ndarray, accel: np.ndarray) -> None:
        for column, topic in enumerate(names.values()):
            here = ~np.isnan(accel[:, column])
            frames[topic].update(zip(stamps_ns[here].tolist(), accel[here, column].tolist(), strict=True))

    def each(pushed: Any) -> None:
        keep(topics.PREDICTED, pushed.predicted.stamps_ns, pushed.predicted.accel_mps2)
        keep(topics.MEASURED, pushed.measured.stamps_ns, pushed.measured.accel_mps2)
        motion.update(zip(pushed.predicted.stamps_ns.tolist(), pushed.predicted.motion, strict=True))

    return frames, motion, replay(bag, subject(), each=each).document


@pytest.mark.timeout(600)
def test_live_in_another_process_equals_replay_of_the_same_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "short.mcap", noisy_streams(2.0))
    expected, motion, document = offline(bag)
    with ros_graph() as graph:
        tester = graph.node()
        blocks = {
            topic: graph.collect(tester, JointTrajectory, topics.absolute(topic))
            for topic in (topics.PREDICTED_BLOCK, topics.MEASURED_BLOCK)
        }
        got = {topic: graph.collect(tester, AccelStamped, topics.absolute(topic), raw=True) for topic in expected}
        diagnostics = graph.collect(tester, DiagnosticArray, topics.DIAGNOSTICS)
        vdv = graph.collect(tester, Float64, "/biodyn/exposure/seat/vdv")
        outputs = (*expected, *blocks)
        overrides = reliable(topics.INPUT.values(), outputs)
        with child(graph, "live", "--ros-args", "-p", "publish_measured:=true", *overrides) as live:
            graph.wait(lambda: tester.count_subscribers(topics.INPUT[SEAT]) == 1, "the node listens", STARTUP_S)
            # On a busy machine outputs are found one after the other, and what is sent before is lost.
            answers = [topics.absolute(topic) for topic in (*expected, *blocks)]
            graph.wait(lambda: all(tester.count_publishers(topic) == 1 for topic in answers), "all outputs are found")
            graph.spin(1.0)  # the node finds us a moment later than we find it, which nothing here can see
            with child(graph, "play", str(bag), "--keep-stamps", "--depth", str(BAG_DEPTH)) as player:
                graph.wait(lambda: player.poll() is not None, "the bag is played", ARRIVES_WITHIN_S)
                assert player.returncode == 0
                counts = {topic: len(owed(topic, frames)) for topic, frames in expected.items()}
                graph.wait(
                    lambda: all(len(got[topic]) >= count for topic, count in counts.items()),
                    "every prediction and measurement", ARRIVES_WITHIN_S,
                )  # fmt: skip
                final = document["sensors"][SEAT]["vdv_mps175"]
                graph.wait(
                    lambda: vdv and vdv[-1].data == pytest.approx(final, rel=1e-9), "the final VDV", ARRIVES_WITHIN_S
                )
                count = len(diagnostics)
                graph.wait(lambda: len(diagnostics) > count + 1, "diagnostics after the end")
            live.send_signal(signal.SIGINT)
            assert live.wait(20) == 0
    for topic, frames in expected.items():
        assert_equal_by_stamp(topic, got[topic], frames)
    assert_blocks_equal(blocks[topics.PREDICTED_BLOCK], expected[topics.PREDICTED["head"]], motion)
    assert_measured_blocks_equal(blocks[topics.MEASURED_BLOCK], expected)
    for sensor in SENSORS:
        status = next(s for s in diagnostics[-1].status if s.name == f"biodyn: {sensor}")
        values = {pair.key: pair.value for pair in status.values}
        assert values["lost"] == "0"
        assert values["late"] == "0"
        assert values["runs"] == "1"


def owed(topic: str, frames: dict[int, float]) -> set[int]:
    """The stamps that must come: only the last second of measurements may still be waiting."""
    waiting_ns = 0 if topic in topics.PREDICTED.values() else 1_100_000_000
    last_ns = max(frames) - waiting_ns
    return {stamp for stamp in frames if stamp <= last_ns}


def assert_equal_by_stamp(topic: str, messages: list[bytes], frames: dict[int, float]) -> None:
    """Joined by stamp, live and offline agree to 1e-9, and nothing is missing that is owed."""
    stamps, linear = accel_stamped(messages)
    live = dict(zip(stamps.tolist(), linear[:, 2].tolist(), strict=True))
    assert len(live) == len(messages), f"{topic}: a stamp came twice"
    missing = owed(topic, frames) - live.keys()
    assert live.keys() <= frames.keys(), topic
    assert not missing, f"{topic}: {len(missing)} frames are missing"
    shared = sorted(live)
    np.testing.assert_allclose(
        [live[s] for s in shared], [frames[s] for s in shared], rtol=1e-9, atol=1e-12, err_msg=topic
    )


def samples(blocks: list[JointTrajectory]) -> dict[int, Any]:
    """The points of blocks by stamp."""
    return {
        block.header.stamp.sec * 10**9 + block.header.stamp.nanosec
        + point.time_from_start.sec * 10**9 + point.time_from_start.nanosec: point
        for block in blocks
        for point in block.points
    }  # fmt: skip


def assert_blocks_equal(blocks: list[JointTrajectory], head: dict[int, float], motion: dict[int, Any]) -> None:
    """Every sample came in a block, with the motion of the replay."""
    live = samples(blocks)
    assert live.keys() == head.keys() and sum(len(block.points) for block in blocks) == len(live)
    assert len(live) / len(blocks) > 3.0  # blocks, not single samples
    stamps = sorted(live)
    expected = np.array([motion[stamp] for stamp in stamps])
    got = np.array([[*live[s].positions, *live[s].velocities, *live[s].effort] for s in stamps])
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([live[s].accelerations[-1] for s in stamps], [head[s] for s in stamps], rtol=1e-9)


def assert_measured_blocks_equal(blocks: list[JointTrajectory], expected: dict[str, dict[int, float]]) -> None:
    """Measurements in blocks are those of the single topics."""
    live = samples(blocks)
    for column, topic in enumerate(topics.MEASURED.values()):
        frames = expected[topic]
        assert owed(topic, frames) <= live.keys()
        shared = sorted(live.keys() & frames.keys())
        np.testing.assert_allclose(
            [live[s].accelerations[column] for s in shared], [frames[s] for s in shared], rtol=1e-9, atol=1e-12
        )


def test_the_live_command_ends_with_zero_on_sigterm() -> None:
    with ros_graph() as graph:
        tester = graph.node()
        with child(graph, "live") as live:
            graph.wait(lambda: tester.count_subscribers(topics.INPUT[SEAT]) == 1, "the node listens", STARTUP_S)
            live.send_signal(signal.SIGTERM)
            said = live.communicate(timeout=20)
            assert live.returncode == 0 and not any("warn" in text.lower() for text in said if text), said


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("cutof_hz:=50.0", "parameter cutof_hz is unknown; did you mean cutoff_hz?"),
        ("subject_file:=nobody", "no subject file nobody"),
    ],
)
def test_the_live_command_ends_with_two_on_bad_input(
    given: str, wanted: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["live", "--ros-args", "-p", given]) == 2
    _, errors = capfd.readouterr()
    assert wanted in errors
    assert "Traceback" not in errors


def test_an_interrupted_play_ends_with_zero_and_an_interrupted_replay_leaves_nothing(tmp_path: Path) -> None:
    bag = str(bag_file("subject_1.mcap"))
    with ros_graph() as graph:
        tester = graph.node()
        for stop in (signal.SIGINT, signal.SIGTERM):
            with child(graph, "play", bag, "--wait-s", "0") as player:
                graph.wait(lambda: tester.count_publishers(topics.INPUT[SEAT]) == 1, "the player plays")
                player.send_signal(stop)
                _, errors = player.communicate(timeout=20)
                assert player.returncode == 0, errors
                assert "Traceback" not in errors
            graph.wait(lambda: tester.count_publishers(topics.INPUT[SEAT]) == 0, "the player is gone")
        long, out = write_bag(tmp_path / "long.mcap", noisy_streams(60.0)), tmp_path / "out"
        with child(graph, "replay", str(long), "--subject", "subject_1", "-o", str(out)) as replay_:
            graph.wait(lambda: any(out.glob(".predicted.mcap.*.part")), "the replay writes")
            replay_.send_signal(signal.SIGINT)
            _, errors = replay_.communicate(timeout=20)
        # Python may re-raise the signal at its very end; a shell calls both 130.
        assert replay_.returncode in (130, -signal.SIGINT), errors
        assert errors.strip().splitlines()[-1] == "biodyn replay: interrupted"
        assert sorted(tmp_path.iterdir()) == [long], sorted(out.iterdir())


_INTERRUPTED_TIMER = """
import signal

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from biodyn_ros.node.callbacks import guarded, make_executor, spin
from biodyn_ros.base.shutdown import Shutdown

with Shutdown("biodyn test") as shutdown:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, executor, ended = rclpy.create_node("interrupted"), make_executor(), Future()
    executor.add_node(node)
    shutdown.on_request(lambda: ended.set_result(None))
    node.create_timer(0.01, guarded(lambda: signal.raise_signal(signal.SIGINT), print))
    spin(executor, ended)
    print("ended", rclpy.ok())
    node.destroy_node()
    rclpy.try_shutdown()
"""


def test_sigint_in_the_middle_of_a_timer_is_no_failure_of_the_timer() -> None:
    with hold_domain() as domain:
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain.domain_id)}
        done = subprocess.run(
            [sys.executable, "-c", _INTERRUPTED_TIMER], env=environment, capture_output=True, text=True, timeout=60,
            check=True,
        )  # fmt: skip
    assert (done.stdout, done.stderr) == ("ended True\n", "")


_INTERRUPTED_START = """
import signal
import sys

import rclpy.node

from biodyn_ros.node.live import main

add_waitable, count = rclpy.node.Node.add_waitable, 0

def interrupted(node, waitable):
    global count
    count += 1
    if count == int(sys.argv[1]):
        signal.raise_signal(signal.SIGTERM)
    add_waitable(node, waitable)

rclpy.node.Node.add_waitable = interrupted
sys.exit(main([]))
"""


@pytest.mark.parametrize("call", [pytest.param(1, marks=pytest.mark.slow), 20])
def test_sigterm_in_the_middle_of_a_call_during_the_start_is_a_clean_end(call: int) -> None:
    """The node then has a subscription or a publisher whose events rclpy does not know yet."""
    with ros_graph() as graph:
        environment = os.environ | {"ROS_DOMAIN_ID": str(graph.context.get_domain_id())}
        done = subprocess.run(
            [sys.executable, "-c", _INTERRUPTED_START, str(call)], env=environment, capture_output=True, text=True,
            timeout=STARTUP_S, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        assert "Traceback" not in done.stderr and "error" not in done.stderr.lower(), done.stderr
        tester = graph.node()
        graph.spin(1.0)
        assert tester.get_node_names() == ["tester"]


_APT_ONLY = """
import sys
for name in ("numba", "mcap", "rosbags", "matplotlib", "jinja2", "aiohttp", "lz4", "zstandard"):
    sys.modules[name] = None
from biodyn_ros.node.live import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_an_apt_only_install_predicts_with_uncompiled_kernels_and_warns(tmp_path: Path) -> None:
    whole = noisy_streams(2.0)  # 0.8 s of rest, and a second of motion
    streams = [
        ImuStream(one.sensor, one.stamps_ns[:2000], one.accel_mps2[:2000], one.gyro_radps[:2000]) for one in whole
    ]
    bag = write_bag(tmp_path / "short.mcap", streams)
    with ros_graph() as graph:
        tester = graph.node()
        head = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]), raw=True)
        environment = os.environ | {"ROS_DOMAIN_ID": str(graph.context.get_domain_id())}
        live = subprocess.Popen(
            [sys.executable, "-c", _APT_ONLY, "--ros-args", *reliable(topics.INPUT.values())],
            env=environment, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            graph.wait(lambda: tester.count_subscribers(topics.INPUT[SEAT]) == 1, "the node listens", STARTUP_S)
            with child(graph, "play", str(bag), "--keep-stamps", "--depth", str(BAG_DEPTH)) as player:
                graph.wait(lambda: player.poll() is not None, "the bag is played", 60.0)
            expected, _, _ = offline(bag)
            frames = expected[topics.PREDICTED["head"]]
            graph.wait(lambda: len(head) >= len(frames), "every prediction", STARTUP_S)
        finally:
            live.send_signal(signal.SIGINT)
            _, errors = live.communicate(timeout=20)
    assert "numba is missing or switched off: kernels run uncompiled" in errors
    # Compiled and uncompiled kernels differ in the last bits alone.
    stamps, linear = accel_stamped(head)
    np.testing.assert_allclose(linear[:, 2], [frames[s] for s in stamps.tolist()], rtol=1e-9, atol=1e-9)
