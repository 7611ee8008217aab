"""A bag played in a loop by a player to a node: no gap between laps, and the figures of the whole record."""

from __future__ import annotations

import dataclasses
import threading
from pathlib import Path

import numpy as np
import pytest
from ros import Graph, ros_graph
from sensor_msgs.msg import Imu
from streams import START_NS, subject, write_bag

from biodyn_core.base.segments import MEASURED_SEGMENTS, SENSORS
from biodyn_core.body.synthesis import ImuStream, SensorSettings, imu_streams, load_case
from biodyn_core.exposure.meters import Dose
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.bag.cdr import decode_imu
from biodyn_ros.base import topics
from biodyn_ros.node.live import BiodynNode
from biodyn_ros.play.playback import Played
from biodyn_ros.play.player import Player
from biodyn_ros.play.player_settings import PlayerSettings

RATE_HZ = 300.0
LAPS = 2.6
SPEED = 3.0
DEEP = 50_000
BLOCK = 100
WAIT_S = 10.0
"""A busy machine may delay a sensor by more than the default second of stamps, a third of a second at this speed."""


def streams() -> list[ImuStream]:
    """Two seconds of road between seconds of rest, every sensor with a clock of its own."""
    rng = np.random.default_rng(8)
    return imu_streams(subject(), load_case("road", 2.0, rng), rng, SensorSettings(rate_hz=RATE_HZ), START_NS)


def repeated(one: ImuStream, lap_ns: int, count: int) -> ImuStream:
    """The first `count` samples of a stream that begins again every `lap_ns`."""
    lap, place = np.divmod(np.arange(count), one.stamps_ns.size)
    return ImuStream(one.sensor, one.stamps_ns[place] + lap * lap_ns, one.accel_mps2[place], one.gyro_radps[place])


def looped(graph: Graph, bag: Path, wanted: int) -> tuple[dict[str, np.ndarray], BiodynNode]:
    """Play in a loop until every sensor sent so many samples: all stamps sent, and the node once it has taken them."""
    reliable = [f"qos_overrides./{topic}.subscription" for topic in topics.INPUT.values()]
    given = {f"{one}.reliability": "reliable" for one in reliable} | {f"{one}.depth": DEEP for one in reliable}
    node = graph.active(state_file="none", wait_s=WAIT_S, **given)
    tester = graph.node()
    got = {sensor: graph.collect(tester, Imu, topic, raw=True) for sensor, topic in topics.INPUT.items()}
    player = graph.add(Player(bag, PlayerSettings(loop=True, rate=SPEED, depth=DEEP), context=graph.context))
    played: list[Played] = []
    thread = threading.Thread(
        target=lambda: played.append(player.play(lambda: any(len(one) < wanted for one in got.values())))
    )
    player.wait_for_subscribers()
    thread.start()
    graph.wait(lambda: played, "the laps are played", 60.0)
    thread.join()
    sent = {sensor: played[0].messages[topic] for sensor, topic in topics.INPUT.items()}
    graph.wait(lambda: all(len(got[sensor]) == sent[sensor] for sensor in SENSORS), "all messages")
    assert node.pipeline is not None
    status = node.pipeline.status
    taken = dict.fromkeys(SENSORS, -1)

    def settled() -> bool:
        nonlocal taken
        before, taken = taken, {sensor: status(sensor).accepted for sensor in SENSORS}
        return before == taken

    graph.wait(lambda: graph.spin(0.2) or settled(), "all samples are taken")  # sensors are drained in turn
    return {sensor: decode_imu(messages).stamps_ns for sensor, messages in got.items()}, node


def test_a_looped_bag_is_one_record_without_a_gap(tmp_path: Path) -> None:
    recorded = {one.sensor: one for one in streams()}
    lap = {name: one.stamps_ns.size for name, one in recorded.items()}
    with ros_graph() as graph:
        sent, node = looped(graph, write_bag(tmp_path / "lap.mcap", recorded.values()), round(LAPS * max(lap.values())))
        live, statuses = node.pipeline.exposure(), {name: node.pipeline.status(name) for name in SENSORS}
    moved_ns = int(sent["seat"][0] - recorded["seat"].stamps_ns[0])
    lap_ns = int(sent["seat"][lap["seat"]] - sent["seat"][0])
    record = {name: repeated(one, lap_ns, sent[name].size) for name, one in recorded.items()}
    for name, one in record.items():
        np.testing.assert_array_equal(sent[name], one.stamps_ns + moved_ns, err_msg="sensors keep their distances")
        seams = np.arange(lap[name], sent[name].size, lap[name])
        periods = np.diff(sent[name])[seams - 1] * 1e-9 * RATE_HZ
        assert seams.size >= 2
        assert (periods > 0.9).all() and (periods < 2.0).all(), name
        assert (statuses[name].runs, statuses[name].filled, statuses[name].gap_s) == (1, 0, 0.0), name
    offline = Pipeline(subject(), settings=PipelineSettings(wait_s=WAIT_S))
    for at in range(0, max(one.stamps_ns.size for one in record.values()), BLOCK):
        for name, one in record.items():
            offline.push(name, one.stamps_ns[at : at + BLOCK] + moved_ns, one.accel_mps2[at : at + BLOCK])
    whole = offline.exposure()
    for name in SENSORS:
        same(live.sensors[name], whole.sensors[name])
    for name in MEASURED_SEGMENTS:
        assert live.residual[name] == pytest.approx(whole.residual[name], rel=1e-9)
        for ours, theirs in zip(live.compared[name], whole.compared[name], strict=True):
            same(ours, theirs)


def same(ours: Dose | None, theirs: Dose | None) -> None:
    assert ours is not None and theirs is not None
    assert dataclasses.astuple(ours) == pytest.approx(dataclasses.astuple(theirs), rel=1e-9)
