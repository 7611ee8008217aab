"""Statuses tell of now: what is wrong while it is, settling behind a gap, and then that all is well."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from streams import RATE_HZ, noisy_streams, subject

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.conditioning.conditioner import ConditioningSettings
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.signals.weighting import CURVES
from biodyn_ros.node.health import (
    CAUSES,
    ERROR,
    OK,
    SETTLING_S,
    WARN,
    HealthMonitor,
    SensorHealth,
    Status,
)

LOOK_SAMPLES = round(0.5 * RATE_HZ)


class Node:
    """The pipeline fed half a second at a time, with a look behind each, as live has them."""

    def __init__(self, streams) -> None:
        self.pipeline, self.streams, self.at = Pipeline(subject()), streams, 0
        self.health = {name: SensorHealth(publishers=1) for name in SENSORS}
        self.watch = HealthMonitor(self.pipeline, self.health)
        self.statuses: dict[str, Status] = {}

    def look(self, looks: int = 1) -> None:
        """Half a second more, and a look."""
        for _ in range(looks):
            for one in self.streams:
                part = slice(self.at, self.at + LOOK_SAMPLES)
                self.pipeline.push(one.sensor, one.stamps_ns[part], one.accel_mps2[part])
                self.health[one.sensor].arrived(LOOK_SAMPLES)
            self.at += LOOK_SAMPLES
            self.judge()

    def judge(self) -> None:
        """A look, without anything having come."""
        self.statuses = {status.of: status for status in self.watch.look()}

    def says(self, name: str) -> tuple[int, str]:
        """Level and message of a sensor, or of `prediction`."""
        return self.statuses[name].level, self.statuses[name].message

    def predicts(self) -> tuple[int, str]:
        """Level and message of the model."""
        return self.says("prediction")


def faulty(sensor: str, spoil) -> tuple:
    """Streams of which one is spoilt by a function of its stamps and samples, from the third second on."""
    found = []
    for one in noisy_streams(6.0):
        stamps_ns, accel = one.stamps_ns.copy(), one.accel_mps2.copy()
        if one.sensor == sensor:
            spoil(stamps_ns, accel, slice(6 * LOOK_SAMPLES, 6 * LOOK_SAMPLES + 100))
        found.append(dataclasses.replace(one, stamps_ns=stamps_ns, accel_mps2=accel))
    return tuple(found)


def nan(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    accel[here.start : here.start + 20] = np.nan


def clipped(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    accel[here, 2] = 157.0


def unset(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    stamps_ns[here] = 0


@pytest.mark.parametrize("sensor", [SEAT, "head"])
@pytest.mark.parametrize(("spoil", "said"), [(nan, "no numbers"), (clipped, "clipped"), (unset, "never set")])
def test_a_cause_is_named_while_it_lasts_and_is_no_alarm_two_seconds_later(sensor: str, spoil, said: str) -> None:
    node = Node(faulty(sensor, spoil))
    node.look(6)
    assert node.says(sensor) == (OK, "streaming")
    node.look()
    level, message = node.says(sensor)
    assert level == WARN and said in message
    assert all(node.says(name) == (OK, "streaming") for name in SENSORS if name != sensor)
    node.look(4)
    assert node.says(sensor) == (OK, "streaming") and node.predicts() == (OK, "predicting")
    values = node.statuses[sensor].values
    assert values["lower_bound"] == "true" and values["settling"] == "false"


def test_an_engine_that_idles_is_named_within_seconds_with_the_parameter_that_helps() -> None:
    streams = [
        dataclasses.replace(one, accel_mps2=one.accel_mps2 + 0.42 * np.sqrt(2.0) * engine(len(one.stamps_ns)))
        for one in noisy_streams(6.0, "road")
    ]
    node = Node(streams)
    node.look(3)
    level, message = node.says(SEAT)
    assert level == WARN and "moves by 0.4" in message and "set rest_rms_mps2 above 0.4" in message
    assert "after 10 s (rest_patience_s) motion is averaged, 1." in message
    assert node.predicts() == (WARN, f"seat: {message}")
    # What it names does help.
    above = float(message.split("rest_rms_mps2 above ")[1].split(";")[0]) + 0.05
    pipeline = Pipeline(subject(), ConditioningSettings(rest_rms_mps2=above))
    (seat,) = (one for one in streams if one.sensor == SEAT)
    pipeline.push(SEAT, seat.stamps_ns[:2000], seat.accel_mps2[:2000])
    assert pipeline.status(SEAT).waiting is None


def engine(count: int) -> np.ndarray:
    """A vertical vibration of 25 Hz and unit amplitude, (n, 3)."""
    return np.sin(2.0 * np.pi * 25.0 * np.arange(count) / RATE_HZ)[:, None] * [0.0, 0.0, 1.0]


def test_what_begins_anew_behind_a_gap_is_settling_and_then_is_not() -> None:
    node = Node(faulty(SEAT, unset))  # 100 samples without a stamp are a gap
    node.look(7)
    assert node.statuses[SEAT].values["settling"] == "true"
    node.look()
    assert node.predicts() == (OK, "settling behind a gap of the seat")
    node.look(2)
    assert node.predicts() == (OK, "predicting")


def test_settling_takes_as_long_as_the_slowest_filter_of_what_is_shown_at_once() -> None:
    time_constant_s = 1.0 / (2.0 * np.pi * CURVES["Wk"].f1_hz * np.sqrt(0.5))
    assert pytest.approx(2.5 * time_constant_s, rel=0.02) == SETTLING_S


def test_a_model_that_leaves_its_range_is_an_error_while_it_does() -> None:
    node = Node(noisy_streams(6.0))
    node.look(6)
    node.pipeline._seat.divergences += 3
    node.look()
    assert node.predicts() == (
        ERROR,
        "the model left its range at 3 samples, none of them predicted: it began at rest",
    )
    node.look(2)
    assert node.predicts() == (OK, "predicting")


def test_two_publishers_and_a_clock_set_anew_are_said() -> None:
    node = Node(noisy_streams(6.0))
    node.look(4)
    node.health["neck"].publishers = 2
    node.judge()
    assert node.says("neck") == (WARN, "2 publishers send to it: whose are the samples?")

    def set_ahead(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
        stamps_ns[here.start :] += 3600 * 10**9

    node = Node(faulty("head", set_ahead))
    node.look(11)
    level, message = node.says("head")
    assert level == WARN and message.startswith("its clock was set +3600.") and "not compared" in message


def test_stamps_that_lie_off_the_seat_s_are_warned_of() -> None:
    node = Node(noisy_streams(6.0))
    node.look(6)
    for ahead_ms, level in ((19, OK), (-21, WARN)):
        for name, late_ms in ((SEAT, 30), ("head", 30 - ahead_ms)):
            node.health[name] = arriving(late_ms)
        node.judge()
        assert node.says("head")[0] == level
        assert float(node.statuses["head"].values["clock_off_ms"]) == pytest.approx(ahead_ms, abs=0.01)
    told = "its stamps lie -21 ms off the seat's, by clock or transport: its residual tells of that"
    assert node.says("head") == (WARN, told)
    # A simulated clock times no arrival.
    assert next(status for status in node.watch.look(arrivals_tell=False) if status.of == "head").level == OK


def arriving(late_ms: int) -> SensorHealth:
    """The health of a sensor whose messages have arrived so late for a minute, the last of them just now."""
    health = SensorHealth(publishers=1)
    for number in range(60):
        health.timed(number * 10**9, number * 10**9 + late_ms * 10**6, window_s=10.0)
    health.compare_clock()
    health.arrived()
    return health


def test_the_offset_of_a_clock_that_drifts_is_that_of_now() -> None:
    health, second = SensorHealth(), 10**9
    for number in range(60):
        stamp = number * second
        arrived = stamp + 5_000_000 - round(stamp * 100e-6)  # its clock gains 100 us in every second
        health.clock.push(np.array([stamp]), np.array([arrived]))
    assert health.offset_s is None
    health.compare_clock()
    assert health.offset_s == pytest.approx(0.005 - 59 * 100e-6, abs=1e-4)


def test_every_cause_is_counted_somewhere() -> None:
    counted = {"lost", "errors"} | set(vars(Pipeline(subject()).status(SEAT)))
    assert set(CAUSES) <= counted


def test_numbers_that_are_missing_are_lost_and_another_publisher_begins_its_own() -> None:
    health = SensorHealth()
    for number, received in ((7, 1), (9, 3), (14, 6), (2, 7), (3, 8)):  # 2 comes from another one
        health.numbered(number, received)
    assert health.lost == 2
    health.forget_numbers()
    health.numbered(900, 9)
    assert health.lost == 2


def test_a_count_that_grew_is_reported_for_two_updates() -> None:
    node = Node(noisy_streams(6.0))
    node.look(6)
    node.health["head"].lost += 3
    levels = []
    for _ in range(3):
        node.look()
        levels.append(node.says("head")[0])
    assert levels == [WARN, WARN, OK]


@pytest.mark.parametrize(("name", "level"), [(SEAT, ERROR), ("head", WARN)])
def test_a_sensor_is_silent_after_half_a_second(name: str, level: int) -> None:
    node, clock = Node(noisy_streams(6.0)), [0.0]
    node.health[name].now = lambda: clock[0]
    node.look(6)
    clock[0] = 0.5
    node.judge()
    assert node.says(name)[0] == OK
    clock[0] = 0.6
    node.judge()
    assert node.says(name) == (level, "silent for 0.6 s")
