"""The live node over real rclpy and DDS, in-process: outputs, diagnostics, faults."""

from __future__ import annotations

import dataclasses
import json
import math
import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from expecting import until
from geometry_msgs.msg import AccelStamped
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros import DEEP, Graph, Sensors, ros_graph
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from streams import accel_stamped, noisy_streams, predicted_frames, subject
from trajectory_msgs.msg import JointTrajectory

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.body.synthesis import ImuStream
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.base import topics
from biodyn_ros.base.resources import config_file
from biodyn_ros.dashboard.settings import ServingSettings
from biodyn_ros.node import params
from biodyn_ros.node.live import BiodynNode
from biodyn_ros.node.parameters_yaml import parameters_yaml
from biodyn_ros.node.publications import AccelTopics
from biodyn_ros.node.settings import SETTINGS, LiveSettings

OK, WARN, ERROR = (bytes([level]) for level in range(3))


def first(count: int) -> tuple[ImuStream, ...]:
    """The first samples of all noisy streams: 0.8 s of rest, then a pothole."""
    return tuple(
        ImuStream(one.sensor, one.stamps_ns[:count], one.accel_mps2[:count], one.gyro_radps[:count])
        for one in noisy_streams()
    )


SHORT = first(2600)


class Diagnostics:
    """The newest diagnostics by name."""

    def __init__(self, graph: Graph, node: Any) -> None:
        self._got = graph.collect(node, DiagnosticArray, topics.DIAGNOSTICS)

    def status(self, name: str) -> Any:
        """The status of the node's part of that name, None before the first."""
        statuses = self._got[-1].status if self._got else []
        return next((status for status in statuses if status.name == f"biodyn: {name}"), None)

    def value(self, name: str, key: str) -> str | None:
        """The value of a key of a status, None before the first."""
        status = self.status(name)
        return None if status is None else {entry.key: entry.value for entry in status.values}[key]

    def says(self, name: str, level: bytes, text: str) -> bool:
        """Whether the status has this level and text."""
        status = self.status(name)
        return status is not None and status.level == level and text in status.message


def offline(streams=None):
    """The results of the pipeline for the same streams without ROS."""
    pipeline = Pipeline(subject())
    by_name = {stream.sensor: stream for stream in streams or SHORT}
    frames = [
        pipeline.push(name, by_name[name].stamps_ns[at : at + 100], by_name[name].accel_mps2[at : at + 100])
        for at in range(0, 6000, 100)
        for name in SENSORS
    ]
    return (
        np.concatenate([f.predicted.stamps_ns for f in frames]),
        np.concatenate([f.predicted.accel_mps2 for f in frames]),
        pipeline,
    )


def test_it_predicts_every_sample_of_every_segment_as_the_pipeline_does(graph: Graph) -> None:
    tester = graph.node()
    got = [graph.collect(tester, AccelStamped, topics.absolute(topic), raw=True) for topic in topics.PREDICTED.values()]
    typed = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]))
    graph.active()
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send()
    stamps, predicted, _ = offline()
    graph.wait(lambda: all(len(messages) >= len(stamps) for messages in got), "all predictions")
    for column, messages in enumerate(got):
        got_stamps, linear = accel_stamped(messages)
        np.testing.assert_array_equal(got_stamps, stamps)
        np.testing.assert_array_equal(linear[:, 2], predicted[:, column])
        np.testing.assert_array_equal(linear[:, :2], 0.0)
    assert {message.header.frame_id for message in typed} == {"head"}


def test_after_a_long_stall_all_arrived_samples_are_compared(graph: Graph) -> None:
    whole = [
        f"qos_overrides./{topic}.subscription.{policy}"
        for topic in topics.INPUT.values()
        for policy in ("reliability:=reliable", "depth:=200000")
    ]
    node = graph.active(tuple(w for one in whole for w in ("-p", one)), publish_measured=True, state_file="none")
    assert node.pipeline is not None
    tester = graph.node()
    topic = topics.absolute(topics.MEASURED["head"])
    head = graph.collect(tester, AccelStamped, topic, raw=True)
    seat = graph.collect(tester, AccelStamped, topics.absolute(topics.MEASURED[SEAT]), raw=True)
    streams = first(3300)
    sensors = Sensors(graph, SENSORS, streams)
    graph.wait(sensors.matched, "six inputs matched")
    graph.wait(lambda: tester.count_publishers(topic) == 1, "the output is found")
    graph.spin(0.5)
    sensors.send(6 * 1200)
    graph.wait(lambda: head, "comparisons begin")
    before = len(seat)
    sensors.send(spinning=False)  # longer than wait_s in stamp time, and the node does not spin meanwhile
    last_ns = int(streams[0].stamps_ns[-1])

    def compared_ns() -> int:
        return int(accel_stamped(seat[-1:])[0][0])

    graph.wait(lambda: compared_ns() > last_ns - 100_000_000, "the last comparison")
    assert len(seat) - before > 1.5 * 1125

    def missing() -> set[int]:
        compared = set(accel_stamped(head)[0].tolist())
        return {stamp for stamp in accel_stamped(seat)[0].tolist() if stamp > min(compared)} - compared

    graph.wait(lambda: not missing(), "every comparison")


def test_messages_beyond_the_queue_are_counted_as_lost(graph: Graph) -> None:
    node = graph.active(queue_depth=200, state_file="none")
    assert node._sensors is not None
    for subscription in node._sensors._subscriptions.values():
        kinds = {handler.event_type for handler in subscription.event_handlers}
        assert QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST not in kinds
    sensors, health = Sensors(graph, SENSORS), node._sensors.health
    graph.wait(sensors.matched, "six inputs matched")
    graph.wait(lambda: all(one.publishers == 1 for one in health.values()), "the publishers are seen")
    sensors.send(6 * 150, spinning=False)
    graph.wait(lambda: all(one.messages == 150 for one in health.values()), "the first messages")
    sensors.send(6 * 500, spinning=False)
    graph.wait(lambda: all(one.messages + one.lost == 650 for one in health.values()), "the last messages")
    assert {one.lost for one in health.values()} == {300}


def test_what_is_sent_while_the_node_is_inactive_is_not_lost(graph: Graph) -> None:
    node = graph.active(queue_depth=200, state_file="none")
    sensors, health = Sensors(graph, SENSORS), node._sensors.health
    graph.wait(sensors.matched, "six inputs matched")
    graph.wait(lambda: all(one.publishers == 1 for one in health.values()), "the publishers are seen")
    sensors.send(6 * 150, spinning=False)
    graph.wait(lambda: all(one.messages == 150 for one in health.values()), "the first messages")
    node.trigger_deactivate()
    graph.wait(lambda: all(one.get_subscription_count() == 0 for one in sensors.outputs.values()), "no subscriber")
    sensors.send(6 * 500, spinning=False)
    node.trigger_activate()
    graph.wait(sensors.matched, "six inputs matched again")
    sensors.send(6 * 150, spinning=False)
    graph.wait(lambda: all(one.messages == 300 for one in health.values()), "the messages after the activation")
    assert {one.lost for one in health.values()} == {0}
    sensors.send(6 * 500, spinning=False)  # what is lost from now on is counted
    graph.wait(lambda: all(one.messages + one.lost == 800 for one in health.values()), "the last messages")
    assert {one.lost for one in health.values()} == {300}


def test_a_refused_message_is_not_lost_where_each_sample_comes_at_once(graph: Graph) -> None:
    node = graph.active(block_ms=0.0, state_file="none")
    sensors, seat = Sensors(graph, (SEAT,)), node._sensors.health[SEAT]
    graph.wait(sensors.matched, "the seat matched")
    graph.wait(lambda: seat.publishers == 1, "the publisher is seen")
    sensors.send(250)
    sensors.outputs[SEAT].publish(b"\x00\x01\x00\x00" + b"\xff" * 20)
    sensors.send(250)  # sequence numbers are read at every hundredth message
    graph.wait(lambda: seat.messages + seat.lost >= 501, "every message")
    assert (seat.messages, seat.errors, seat.lost) == (501, 1, 0)


def test_exposure_and_residual_are_published_and_agree_with_the_pipeline(graph: Graph) -> None:
    tester = graph.node()
    names = (
        "dri",
        "seat/vdv",
        "head/aw",
        "seat/a8",
        "predicted/head/vdv",
        "head/hic15",
        "rolling/seat/vdv",
        "rolling/dri",
    )
    got = {name: graph.collect(tester, Float64, f"/biodyn/exposure/{name}") for name in names}
    residual = graph.collect(tester, Float64, "/biodyn/residual/head")
    node = graph.active(exposure_rate_hz=10.0)
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send()
    _, _, pipeline = offline()
    exposure, seat = pipeline.exposure(), pipeline.seat()
    expected = {
        "dri": exposure.dri.compression,
        "seat/vdv": exposure.sensors[SEAT].vdv_mps175,
        "head/aw": exposure.sensors["head"].aw_mps2,
        "seat/a8": seat.a8_so_far_mps2,
        "predicted/head/vdv": exposure.predicted["head"].vdv_mps175,
        "head/hic15": exposure.hic15.resultant,
    }
    for name, value in expected.items():
        graph.wait(
            lambda n=name, v=value: got[n] and got[n][-1].data == pytest.approx(v, rel=1e-12), f"{name} at {value}"
        )
    graph.wait(lambda: residual and 0.0 < residual[-1].data < 0.2, "residual of the head")
    assert got["rolling/seat/vdv"][-1].data == pytest.approx(expected["seat/vdv"], rel=1e-9)
    assert node.count_publishers("/biodyn/exposure/seat/time_to_action_value") == 1


def test_samples_are_sent_to_subscribed_topics_alone(graph: Graph) -> None:
    tester = graph.node()
    measured = graph.collect(tester, AccelStamped, topics.absolute(topics.MEASURED["head"]), raw=True)
    pelvis = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["pelvis"]), raw=True)
    graph.active(publish_measured=True, wait_s=10.0)  # what is sent here comes faster than life
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send()
    graph.wait(lambda: len(pelvis) > 1500 and len(measured) > 1000, "measured and predicted")


@pytest.mark.parametrize("block_ms", [0.0, 20.0])
def test_blocks_of_any_length_have_the_frames_of_single_samples(graph: Graph, block_ms: float) -> None:
    tester = graph.node()
    blocks = graph.collect(tester, JointTrajectory, topics.absolute(topics.PREDICTED_BLOCK))
    graph.active(block_ms=block_ms)
    sensors = Sensors(graph, (SEAT,), SHORT)
    graph.wait(sensors.matched, "the seat matched")
    graph.wait(lambda: tester.count_publishers(topics.absolute(topics.PREDICTED_BLOCK)), "the blocks matched")
    graph.spin(0.3)
    sensors.send()
    stamps, predicted, _ = offline()
    graph.wait(lambda: blocks and newest_ns(blocks[-1]) == stamps[-1], "the last sample in a block")
    accel = [point.accelerations for block in blocks for point in block.points]
    np.testing.assert_array_equal(accel, predicted)
    typical = np.median([len(block.points) for block in blocks])
    assert typical == 1 if block_ms == 0.0 else typical > 4


def newest_ns(block: JointTrajectory) -> int:
    """The stamp of the last sample of a block."""
    stamp, since = block.header.stamp, block.points[-1].time_from_start
    return (stamp.sec + since.sec) * 10**9 + stamp.nanosec + since.nanosec


def test_without_listeners_every_sample_counts(graph: Graph) -> None:
    """Blocks are longer then; figures are those of any other cut."""
    node = graph.active()
    sensors = Sensors(graph, (SEAT,), SHORT)
    graph.wait(sensors.matched, "the seat matched")
    sensors.send()
    exposure = offline()[2].exposure()
    counted = exposure.sensors[SEAT]
    graph.wait(lambda: node.pipeline.exposure().sensors.get(SEAT) == counted, "every sample is counted")
    assert node.pipeline.exposure().joint_forces == exposure.joint_forces


@pytest.mark.parametrize("block_ms", [0.3, -1.0, 101.0, float("inf")])
def test_a_block_length_out_of_range_is_refused(block_ms: float) -> None:
    with pytest.raises(InputError, match=r"block_ms is .*, allowed are 0"):
        LiveSettings(block_ms=block_ms)


def test_a_column_without_subscribers_is_not_read(graph: Graph) -> None:
    node, tester = graph.node("speaker"), graph.node()
    output = AccelTopics(node, topics.PREDICTED)
    head = graph.collect(tester, AccelStamped, "/speaker/predicted/head/accel", raw=True)
    column = list(topics.PREDICTED).index("head")
    graph.wait(lambda: output.publishers[column].get_subscription_count() > 0, "the head's column matched")
    output.update_subscribers()
    # An object that is no number would raise if it were read.
    values = np.array([[None] * column + [1.0], [None] * column + [math.nan]], dtype=object)
    output.publish(predicted_frames(np.array([1, 2]), values))
    graph.wait(lambda: head, "the head's only value")
    graph.spin(0.2)
    assert accel_stamped(head)[1][:, 2].tolist() == [1.0]


def test_without_a_sensor_predictions_continue_and_its_status_reports_it(graph: Graph) -> None:
    tester = graph.node()
    head = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]), raw=True)
    diagnostics = Diagnostics(graph, tester)
    graph.active()
    sensors = Sensors(graph, tuple(name for name in SENSORS if name != "neck"))
    graph.wait(sensors.matched, "five inputs matched")
    sensors.send(6_500)
    graph.wait(lambda: len(head) > 300, "predictions")
    graph.wait(lambda: diagnostics.says("neck", WARN, "no message yet"), "the neck is missed")
    sensors.send(5_000, only=tuple(name for name in SENSORS if name != "pelvis"))
    graph.wait(lambda: diagnostics.says("pelvis", WARN, "silent for"), "the pelvis is silent")


def test_a_silent_seat_stops_predictions_until_it_sends_again(graph: Graph) -> None:
    tester = graph.node()
    head = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]), raw=True)
    diagnostics = Diagnostics(graph, tester)
    graph.active()
    sensors = Sensors(graph, SENSORS)
    graph.wait(sensors.matched, "six inputs matched")
    graph.wait(lambda: diagnostics.says("prediction", ERROR, "seat has sent nothing"), "no seat yet")
    sensors.send(8_000)
    graph.wait(lambda: len(head) > 300, "predictions")
    graph.wait(
        lambda: diagnostics.says("prediction", ERROR, "predictions stopped: seat is silent"), "the seat is silent"
    )
    stopped = len(head)
    lag_ms = diagnostics.value(SEAT, "lag_ms")
    sensors.send(3_000, only=SENSORS[1:])
    graph.spin(1.2)
    assert diagnostics.value(SEAT, "lag_ms") == lag_ms  # a silent sensor has no growing lag
    assert len(head) == stopped
    sensors.send(6_000)
    graph.wait(lambda: len(head) > stopped + 300, "predictions again")


def test_a_seat_that_sends_only_unusable_samples_stops_predictions_in_diagnostics_and_page(graph: Graph) -> None:
    streams = []
    for stream in noisy_streams():
        accel = stream.accel_mps2.copy()
        accel[2000:] = np.nan
        streams.append(dataclasses.replace(stream, accel_mps2=accel))
    tester = graph.node()
    diagnostics = Diagnostics(graph, tester)
    snapshots = graph.collect(tester, String, topics.absolute(topics.SNAPSHOT))
    graph.active()
    sensors = Sensors(graph, SENSORS, tuple(streams))
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send(11_400)
    graph.wait(lambda: diagnostics.says("prediction", OK, ""), "predictions")
    for _ in range(40):  # messages go on in real time
        sensors.send(200)
        graph.spin(0.1)
        if diagnostics.says(SEAT, ERROR, "no usable sample for"):
            break
    assert diagnostics.says(SEAT, ERROR, "readings that are no numbers")
    assert diagnostics.says("prediction", ERROR, "predictions stopped: seat has no usable sample for")
    shown = json.loads(snapshots[-1].data)
    assert shown["verdict"]["tone"] == "none" and shown["seat"]["missing_s"] > 0.05


def test_a_publisher_of_another_type_is_an_error_naming_the_topic(graph: Graph) -> None:
    diagnostics = Diagnostics(graph, graph.node())
    graph.active()
    # A type clash inside one participant is refused by DDS at once, so the stranger is a participant of its own.
    with other_participant(graph) as stranger:
        stranger.create_publisher(String, topics.INPUT["head"], 10)
        wanted = "/imu/head/data: a publisher sends std_msgs/msg/String, sensor_msgs/msg/Imu is needed"
        graph.wait(lambda: diagnostics.says("head", ERROR, wanted), "the wrong type")


def test_a_qos_override_applies_to_its_own_topic_alone(graph: Graph) -> None:
    given = (
        ("/imu/seat/data.subscription.reliability", "reliable"),
        ("/biodyn/predicted/pelvis/accel.publisher.reliability", "best_effort"),
    )
    node = graph.active(tuple(word for name, value in given for word in ("-p", f"qos_overrides.{name}:={value}")))
    inputs = {name: node.get_subscriptions_info_by_topic(f"/imu/{name}/data") for name in SENSORS}
    outputs = {name: node.get_publishers_info_by_topic(f"/biodyn/predicted/{name}/accel") for name in SEGMENTS}
    asked = {name: one[0].qos_profile.reliability == ReliabilityPolicy.RELIABLE for name, one in inputs.items()}
    offered = {name: one[0].qos_profile.reliability == ReliabilityPolicy.RELIABLE for name, one in outputs.items()}
    assert asked == {name: name == SEAT for name in SENSORS}
    assert offered == {name: name != "pelvis" for name in SEGMENTS}


def test_incompatible_qos_is_an_error_naming_the_topic(graph: Graph) -> None:
    tester = graph.node()
    diagnostics = Diagnostics(graph, tester)
    graph.active(("-p", "qos_overrides./imu/neck/data.subscription.reliability:=reliable"))
    tester.create_publisher(Imu, topics.INPUT["neck"], QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    graph.wait(
        lambda: diagnostics.says("neck", ERROR, "/imu/neck/data: a publisher offers incompatible QoS"), "the QoS"
    )


def test_an_unreadable_message_is_counted_and_skipped(graph: Graph) -> None:
    tester = graph.node()
    head = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]), raw=True)
    diagnostics = Diagnostics(graph, tester)
    node = graph.active()
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send(8_000)
    for name in (SEAT, "head"):
        sensors.outputs[name].publish(b"\x00\x01\x00\x00" + b"\xff" * 20)
    sent = sensors.send()
    assert sent > 5_000
    stamps, predicted, _ = offline()
    graph.wait(lambda: len(head) == len(stamps), "every prediction all the same")
    np.testing.assert_array_equal(accel_stamped(head)[1][:, 2], predicted[:, SEGMENTS.index("head")])
    head_count = len(next(stream for stream in SHORT if stream.sensor == "head").stamps_ns)
    for name in (SEAT, "head"):
        graph.wait(lambda n=name: diagnostics.value(n, "refused") == "1", f"the refusal of the {name}'s")
    graph.wait(lambda: diagnostics.value("head", "messages") == str(head_count + 1), "the head's messages")
    # The garbage cost nothing but itself: every other sample of its batch was used.
    seen = node.pipeline.status("head")
    assert seen.accepted + round(seen.uncounted_s * seen.rate_hz) == head_count


def test_predictions_and_diagnostics_continue_while_the_clock_stands_still(graph: Graph) -> None:
    tester = graph.node()
    head = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]), raw=True)
    dri = graph.collect(tester, Float64, "/biodyn/exposure/dri")
    diagnostics = Diagnostics(graph, tester)
    graph.active(use_sim_time=True)
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send()
    graph.wait(lambda: len(head) > 1500 and dri, "predictions and exposure")
    graph.wait(lambda: diagnostics.says("prediction", ERROR, "silent"), "the watchdog")


def test_without_the_events_executor_the_plain_one_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy.experimental.events_executor", None)
    with ros_graph() as graph:
        assert isinstance(graph.executor, SingleThreadedExecutor)
        tester = graph.node()
        head = graph.collect(tester, AccelStamped, topics.absolute(topics.PREDICTED["head"]), raw=True)
        graph.active()
        sensors = Sensors(graph, (SEAT,))
        graph.wait(sensors.matched, "the seat matched")
        sensors.send(1_300)
        graph.wait(lambda: len(head) > 200, "predictions")


def test_reset_and_mark_respond(graph: Graph) -> None:
    tester = graph.node()
    marks = graph.collect(tester, String, topics.absolute(topics.MARKS))
    node = graph.active()
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send()
    counted = offline()[2].exposure().sensors[SEAT]
    graph.wait(lambda: node.pipeline.exposure().sensors.get(SEAT) == counted, "every sample is counted")
    for service, text in (("reset", "is set to zero"), ("mark", "mark 1 at")):
        client = tester.create_client(Trigger, f"/biodyn/{service}")
        graph.wait(client.service_is_ready, service)
        future = client.call_async(Trigger.Request())
        graph.wait(future.done, service)
        assert future.result().success
        assert text in future.result().message
    after = node.pipeline.exposure().sensors[SEAT]
    assert after.vdv_mps175 == after.seconds == 0.0 < counted.vdv_mps175
    graph.wait(lambda: [message.data for message in marks] == ["mark 1"], "the mark is published")


def test_samples_that_wait_at_a_reset_count_before_it(graph: Graph) -> None:
    node = graph.active(state_file="none")
    sensors = Sensors(graph, SENSORS, SHORT)
    graph.wait(sensors.matched, "six inputs matched")
    sensors.send(6 * 1500)
    graph.wait(lambda: node.pipeline.exposure().sensors, "samples are counted")
    delivered: list[Any] = []
    beside = Node("beside", context=graph.context)  # the graph's executor would serve the node too
    beside.create_subscription(Imu, topics.INPUT["head"], delivered.append, DEEP)
    graph.wait(lambda: sensors.outputs["head"].get_subscription_count() == 2, "a second listener of the head")
    count = sensors.send(spinning=False) // len(SENSORS)
    executor = SingleThreadedExecutor(context=graph.context)
    executor.add_node(beside)
    until(lambda: len(delivered) >= count, "all are delivered", 60.0, lambda: executor.spin_once(timeout_sec=0.02))
    beside.destroy_node()
    assert node._on_reset(Trigger.Request(), Trigger.Response()).success
    graph.spin(1.0)
    assert {dose.seconds for dose in node.pipeline.exposure().sensors.values()} == {0.0}


def test_a_short_queue_is_at_most_half_full_when_it_is_read(graph: Graph) -> None:
    node = graph.active(queue_depth=200, state_file="none")
    drain = next(
        timer
        for timer in node._node_timers
        if timer.timer_period_ns < 20_000_000 and timer.timer_period_ns != 5_000_000
    )
    assert len(SENSORS) * 1e-9 * drain.timer_period_ns * 1129.3 <= 100.5


def test_a_taken_port_of_the_page_gives_no_link(graph: Graph, capfd: pytest.CaptureFixture[str]) -> None:
    """The link would open the page of another node."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        graph.active(dashboard=True, page_port=port, state_file="none")
    said = capfd.readouterr().err
    assert f"the page cannot be served at http://127.0.0.1:{port}/" in said and "#token" not in said


def test_limits_of_the_home_directory_are_read(graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own.yaml").write_text(config_file("limits.yaml").read_text())
    monkeypatch.setenv("HOME", str(tmp_path))
    assert graph.active(limits_file="~/own.yaml", state_file="none").pipeline is not None


def test_a_swapped_pair_of_inputs_has_its_own_publishers(graph: Graph) -> None:
    """Sensors that are mounted the wrong way round: each input is remapped to the topic of the other."""
    swapped = ("imu/seat/data:=/imu/pelvis/data", "imu/pelvis/data:=/imu/seat/data")
    node = graph.active(tuple(word for one in swapped for word in ("-r", one)), state_file="none")
    outputs = [graph.node(name).create_publisher(Imu, "/imu/pelvis/data", 10) for name in ("first", "second")]
    graph.wait(lambda: node._sensors.health[SEAT].publishers == 2, "two publishers of the seat")
    assert node._sensors.health["pelvis"].publishers == 0 and len(outputs) == 2


def test_statuses_have_the_full_name_of_their_node(graph: Graph) -> None:
    found = graph.collect(graph.node(), DiagnosticArray, topics.DIAGNOSTICS)
    graph.active(("-r", "__ns:=/second"), state_file="none")
    graph.wait(lambda: found, "diagnostics")
    assert {status.hardware_id for status in found[-1].status} == {"second/biodyn"}
    assert "second/biodyn: seat" in {status.name for status in found[-1].status}


def test_the_node_subscribes_only_while_active(graph: Graph) -> None:
    node = graph.live()
    assert node.count_subscribers(topics.INPUT[SEAT]) == 0
    node.trigger_configure()
    assert node.count_subscribers(topics.INPUT[SEAT]) == 0
    node.trigger_activate()
    assert node.count_subscribers(topics.INPUT[SEAT]) == 1
    node.trigger_deactivate()
    assert node.count_subscribers(topics.INPUT[SEAT]) == 0
    node.trigger_activate()
    assert node.count_subscribers(topics.INPUT[SEAT]) == 1
    node.trigger_deactivate()
    node.trigger_cleanup()
    assert node.count_publishers("/biodyn/predicted/head/accel") == 0
    node.trigger_configure()
    assert node.failure is None
    node.trigger_shutdown()


def test_a_timer_that_was_due_when_the_node_was_deactivated_does_nothing(graph: Graph, capfd) -> None:
    """The executor calls it once more: its event waited in the queue."""
    node = graph.active(state_file="none")
    due = [timer.callback for timer in node.timers]
    for transition in (node.trigger_deactivate, node.trigger_cleanup):
        transition()
        for callback in due:
            callback()
    assert len(due) == 8
    assert "timer: " not in capfd.readouterr().err


def test_an_unreadable_subject_fails_the_transition_in_one_line(graph: Graph) -> None:
    node = graph.live(subject_file="nobody")
    node.trigger_configure()
    assert node.failure is not None
    assert "no subject file nobody" in node.failure
    assert "\n" not in node.failure
    assert node.count_publishers("/biodyn/predicted/head/accel") == 0


@pytest.mark.parametrize(
    ("given", "phrase"),
    [
        ({"cutof_hz": 100.0}, "parameter cutof_hz is unknown; did you mean cutoff_hz?"),
        ({"cutoff_hz": 3.0}, "parameter cutoff_hz"),
        ({"queue_depth": 10}, "parameter queue_depth"),
        ({"qos_overrides./imu/seat/data.publisher.depth": 10}, "overrides nothing: only history, depth"),
        ({"qos_overrides./biodyn/exposure/dri.publisher.depth": 10}, "overrides nothing"),
    ],
)
def test_a_parameter_that_does_not_fit_is_named_at_the_start(graph: Graph, given: dict[str, Any], phrase: str) -> None:
    with pytest.raises(InputError, match=phrase):
        graph.live(**given)


def test_a_parameter_of_the_wrong_type_is_named(graph: Graph) -> None:
    node = graph.live(window_s="long")
    node.trigger_configure()
    assert "parameter window_s is 'long', expected a number" in (node.failure or "")


def test_parameters_can_be_corrected_after_a_failed_configure(graph: Graph, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    node = graph.live(state_file=str(tmp_path / "file" / "state.json"))
    node.trigger_configure()
    assert "the directory cannot be created" in (node.failure or "")
    (result,) = node.set_parameters([Parameter("state_file", value=str(tmp_path / "state.json"))])
    assert result.successful, result.reason
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS


def test_a_parameter_change_after_configure_is_refused(graph: Graph) -> None:
    node = graph.active()
    (result,) = node.set_parameters([Parameter("cutoff_hz", value=50.0)])
    assert not result.successful
    assert "cutoff_hz is read on configure" in result.reason
    node.trigger_deactivate()
    node.trigger_cleanup()
    (result,) = node.set_parameters([Parameter("cutoff_hz", value=50.0)])
    assert result.successful
    node.trigger_configure()
    assert filter_delay_s(node.pipeline) == pytest.approx(2.0 * filter_delay_s(Pipeline(subject())), rel=0.02)


def filter_delay_s(pipeline: Pipeline) -> float:
    """The low-pass's delay, which halving its cut-off doubles."""
    seat = noisy_streams()[0]
    pipeline.push(seat.sensor, seat.stamps_ns, seat.accel_mps2)
    return pipeline.status(seat.sensor).filter_delay_s


def test_whole_numbers_are_accepted_for_real_ones(graph: Graph) -> None:
    node = graph.active(window_s=20, exposure_rate_hz=5)
    assert node.pipeline.settings.window_s == 20.0
    assert isinstance(params.read(node, LiveSettings).exposure_rate_hz, float)


def test_every_parameter_has_a_description_and_the_shipped_file_holds_the_defaults(graph: Graph) -> None:
    node = graph.live(("--params-file", str(config_file("live.yaml"))))
    plain = graph_defaults()
    for name, default in plain.items():
        assert node.describe_parameter(name).description
        value = node.get_parameter(name).value
        assert value == default or (default is None and np.isnan(value)), name
    # This command makes the file: python -m biodyn_ros.node.parameters_yaml
    assert config_file("live.yaml").read_text(encoding="utf-8") == parameters_yaml()


def graph_defaults() -> dict[str, Any]:
    """Every setting's default, as the code has it."""
    return {name: field.default for kind in SETTINGS for name, field in kind.__dataclass_fields__.items()}


class other_participant:  # noqa: N801 - used as a with-statement's word
    """A node in a context of its own, in the graph's domain."""

    def __init__(self, graph: Graph) -> None:
        self._domain = graph.context.get_domain_id()

    def __enter__(self) -> Any:
        import rclpy

        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self._domain)
        self._node = rclpy.create_node("stranger", context=self._context)
        return self._node

    def __exit__(self, *error: object) -> None:
        import rclpy

        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)


def test_a_page_that_cannot_be_served_does_not_stop_the_node(graph) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        diagnostics = Diagnostics(graph, graph.node())
        graph.active(dashboard=True, page_port=port)
        phrase = f"the page is not served: biodyn page: the page cannot be served at 127.0.0.1:{port}"
        graph.wait(lambda: diagnostics.says("page", WARN, phrase), "the reason in the diagnostics")
        assert diagnostics.says("prediction", ERROR, "has sent nothing"), "the node runs"


def test_an_activation_that_fails_leaves_nothing_running_and_a_retry_receives_each_sample_once(graph) -> None:
    node = graph.live(dashboard=True, page_host="192.0.2.1", page_port=0)  # no interface has this address
    sensors = Sensors(graph, SENSORS)
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() == TransitionCallbackReturn.FAILURE
    assert "192.0.2.1: the address cannot be used" in node.failure
    assert {node.count_subscribers(topic) for topic in topics.INPUT.values()} == {0}
    assert list(node.timers) == []
    node._serving = ServingSettings(page_port=0)  # as if the interface were up
    assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
    assert {node.count_subscribers(topic) for topic in topics.INPUT.values()} == {1}
    graph.wait(sensors.matched, "six inputs matched")
    sent = sensors.send(6 * 1000)
    health = node._sensors.health
    graph.wait(lambda: sum(one.messages for one in health.values()) >= sent, "every message")
    graph.spin(0.3)
    assert sum(one.messages for one in health.values()) == sent
    assert {node.pipeline.status(name).late + node.pipeline.status(name).duplicate for name in SENSORS} == {0}


def test_an_activation_that_fails_at_the_last_sensor_leaves_no_subscription(graph) -> None:
    node = graph.live(("-p", f"qos_overrides./imu/{SENSORS[-1]}/data.subscription.reliability:=nonsense"))
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() == TransitionCallbackReturn.FAILURE
    assert {node.count_subscribers(topic) for topic in topics.INPUT.values()} == {0}


def test_a_configuration_that_fails_leaves_no_topic_and_no_service(graph, monkeypatch: pytest.MonkeyPatch) -> None:
    """The publisher of the head comes after that of the pelvis."""
    node = graph.live(("-p", "qos_overrides./biodyn/predicted/head/accel.publisher.reliability:=nonsense"))
    before = list(node.publishers), list(node.services)
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    assert (list(node.publishers), list(node.services)) == before
    node = graph.live(("-r", "__node:=other"))
    before = list(node.publishers), list(node.services)
    with monkeypatch.context() as patched:
        patched.setattr(topics, "MARK", "no topic")  # the last service
        assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    assert (list(node.publishers), list(node.services)) == before
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
    assert node.count_publishers("/other/predicted/pelvis/accel") == 1
    node.trigger_cleanup()
    assert (list(node.publishers), list(node.services)) == before


def test_an_invalid_page_host_is_refused_on_configure(graph) -> None:
    node = graph.live(dashboard=True, page_host="everywhere")
    node.trigger_configure()
    assert node.failure == "page_host is 'everywhere', an address is needed: 127.0.0.1, ::1, 0.0.0.0"


def test_an_executor_that_serves_all_subscriptions_changes_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BiodynNode, "subscriptions", Node.subscriptions)
    with ros_graph() as graph:
        node = graph.active(wait_s=10.0)
        streams = first(1500)
        sensors = Sensors(graph, SENSORS, streams)
        graph.wait(sensors.matched, "six inputs matched")
        sensors.send()
        exposure = offline(streams)[2].exposure()
        graph.wait(lambda: node.pipeline.exposure().sensors == exposure.sensors, "the figures of the pipeline alone")
