"""Statuses are about the present: a fault while it lasts, settling behind a gap, and then no fault."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from provenances import with_spread
from streams import RATE_HZ, noisy_streams, subject

from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SENSORS
from biodyn_core.body.usual_residual import PROVENANCE, UsualResidual
from biodyn_core.conditioning.conditioner import ConditioningSettings
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.signals.octaves import N_BANDS
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

CHECK_SAMPLES = round(0.5 * RATE_HZ)


class Node:
    """The pipeline, pushed half a second at a time, with a check after each, as live."""

    def __init__(self, streams, of=None) -> None:
        self.pipeline, self.streams, self.at = Pipeline(of or subject()), streams, 0
        self.health = {name: SensorHealth(publishers=1) for name in SENSORS}
        self.monitor = HealthMonitor(self.pipeline, self.health)
        self.statuses: dict[str, Status] = {}

    def advance(self, checks: int = 1) -> None:
        """Push half a second and check, so many times."""
        for _ in range(checks):
            for one in self.streams:
                part = slice(self.at, self.at + CHECK_SAMPLES)
                self.pipeline.push(one.sensor, one.stamps_ns[part], one.accel_mps2[part])
                self.health[one.sensor].arrived(CHECK_SAMPLES)
            self.at += CHECK_SAMPLES
            self.check()

    def check(self) -> None:
        """Check without new samples."""
        self.statuses = {status.of: status for status in self.monitor.check()}

    def status(self, name: str) -> tuple[int, str]:
        """Level and message of a sensor, or of `prediction`."""
        return self.statuses[name].level, self.statuses[name].message

    def prediction(self) -> tuple[int, str]:
        """Level and message of the model."""
        return self.status("prediction")


def faulty(sensor: str, spoil) -> tuple:
    """Streams, one of them changed by a function of its stamps and samples from the third second on."""
    found = []
    for one in noisy_streams(6.0):
        stamps_ns, accel = one.stamps_ns.copy(), one.accel_mps2.copy()
        if one.sensor == sensor:
            spoil(stamps_ns, accel, slice(6 * CHECK_SAMPLES, 6 * CHECK_SAMPLES + 100))
        found.append(dataclasses.replace(one, stamps_ns=stamps_ns, accel_mps2=accel))
    return tuple(found)


def nan(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    accel[here.start : here.start + 20] = np.nan


def clipped(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    accel[here, 2] = 157.0


def unset(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    stamps_ns[here] = 0


TWO_SECONDS = 4 * CHECK_SAMPLES


def nan_for(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    accel[here.start : here.start + TWO_SECONDS] = np.nan


def unset_for(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    stamps_ns[here.start : here.start + TWO_SECONDS] = 0


def frozen_for(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
    stamps_ns[here.start : here.start + TWO_SECONDS] = stamps_ns[here.start - 1]


@pytest.mark.parametrize("sensor", [SEAT, "head"])
@pytest.mark.parametrize(("spoil", "expected"), [(nan, "no numbers"), (clipped, "clipped"), (unset, "never set")])
def test_a_fault_is_a_warning_while_it_lasts_and_not_two_seconds_later(sensor: str, spoil, expected: str) -> None:
    node = Node(faulty(sensor, spoil))
    node.advance(6)
    assert node.status(sensor) == (OK, "streaming")
    node.advance()
    level, message = node.status(sensor)
    assert level == WARN and expected in message
    assert all(node.status(name) == (OK, "streaming") for name in SENSORS if name != sensor)
    node.advance(4)
    assert node.status(sensor) == (OK, "streaming") and node.prediction() == (OK, "predicting")
    values = node.statuses[sensor].values
    assert values["lower_bound"] == "true" and values["settling"] == "false"


def test_unusable_samples_are_a_warning_before_gravity_is_known() -> None:
    streams = list(noisy_streams(6.0))
    at = next(i for i, one in enumerate(streams) if one.sensor == SEAT)
    accel = streams[at].accel_mps2.copy()
    accel[50:CHECK_SAMPLES] = np.nan
    streams[at] = dataclasses.replace(streams[at], accel_mps2=accel)
    node = Node(tuple(streams))
    node.advance()
    level, message = node.status(SEAT)
    assert level == WARN and f"{CHECK_SAMPLES - 50} readings that are no numbers" in message


def test_an_idling_engine_is_reported_with_the_parameter_to_set() -> None:
    streams = [
        dataclasses.replace(one, accel_mps2=one.accel_mps2 + 0.42 * np.sqrt(2.0) * engine(len(one.stamps_ns)))
        for one in noisy_streams(6.0, "road")
    ]
    node = Node(streams)
    node.advance(3)
    level, message = node.status(SEAT)
    assert level == WARN and "moves by 0.4" in message and "set rest_rms_mps2 above 0.4" in message
    assert "after 10 s (rest_patience_s) motion is averaged, 1." in message
    assert node.prediction() == (WARN, f"seat: {message}")
    # The named value helps.
    above = float(message.split("rest_rms_mps2 above ")[1].split(";")[0]) + 0.05
    pipeline = Pipeline(subject(), ConditioningSettings(rest_rms_mps2=above))
    (seat,) = (one for one in streams if one.sensor == SEAT)
    pipeline.push(SEAT, seat.stamps_ns[:2000], seat.accel_mps2[:2000])
    assert pipeline.status(SEAT).waiting is None


def engine(count: int) -> np.ndarray:
    """A vertical vibration of 25 Hz and unit amplitude, (n, 3)."""
    return np.sin(2.0 * np.pi * 25.0 * np.arange(count) / RATE_HZ)[:, None] * [0.0, 0.0, 1.0]


def test_filters_settle_behind_a_gap() -> None:
    node = Node(faulty(SEAT, unset))  # 100 samples without a stamp are a gap
    node.advance(7)
    assert node.statuses[SEAT].values["settling"] == "true"
    node.advance()
    assert node.prediction() == (OK, "settling behind a gap of the seat")
    node.advance(2)
    assert node.prediction() == (OK, "predicting")


def test_the_settling_time_is_that_of_the_slowest_filter() -> None:
    time_constant_s = 1.0 / (2.0 * np.pi * CURVES["Wk"].f1_hz * np.sqrt(0.5))
    assert pytest.approx(2.5 * time_constant_s, rel=0.02) == SETTLING_S


def test_a_diverging_model_is_an_error_while_it_diverges() -> None:
    node = Node(noisy_streams(6.0))
    node.advance(6)
    node.pipeline.predictor.divergences += 3
    node.advance()
    assert node.prediction() == (
        ERROR,
        "the model left its range at 3 samples: no prediction there, restarted at rest",
    )
    node.advance(2)
    assert node.prediction() == (OK, "predicting")


def test_two_publishers_and_a_set_clock_are_reported() -> None:
    node = Node(noisy_streams(6.0))
    node.advance(4)
    node.health["neck"].publishers = 2
    node.check()
    assert node.status("neck") == (WARN, "2 publishers on its topic, one is allowed")

    def set_ahead(stamps_ns: np.ndarray, accel: np.ndarray, here: slice) -> None:
        stamps_ns[here.start :] += 3600 * 10**9

    node = Node(faulty("head", set_ahead))
    node.advance(11)
    level, message = node.status("head")
    assert level == WARN and message.startswith("its clock was set +3600.") and "not compared" in message


def test_an_offset_from_the_seat_s_stamps_is_a_warning() -> None:
    node = Node(noisy_streams(6.0))
    node.advance(6)
    for ahead_ms, level in ((19, OK), (-21, WARN)):
        for name, late_ms in ((SEAT, 30), ("head", 30 - ahead_ms)):
            node.health[name] = arriving(late_ms)
        node.check()
        assert node.status("head")[0] == level
        assert float(node.statuses["head"].values["clock_off_ms"]) == pytest.approx(ahead_ms, abs=0.01)
    warning = "its stamps differ by -21 ms from the seat's, by clock or transport: its residual contains that"
    assert node.status("head") == (WARN, warning)
    # A simulated clock is too coarse for arrivals.
    assert next(status for status in node.monitor.check(compare_clocks=False) if status.of == "head").level == OK


def arriving(late_ms: int) -> SensorHealth:
    """The health of a sensor whose messages have arrived so late for a minute, the last of them just now."""
    health = SensorHealth(publishers=1)
    for number in range(60):
        health.timed(number * 10**9, number * 10**9 + late_ms * 10**6, window_s=10.0)
    health.compare_clock()
    health.arrived()
    return health


def test_the_offset_of_a_drifting_clock_is_the_present_one() -> None:
    health, second = SensorHealth(), 10**9
    for number in range(60):
        stamp = number * second
        arrived = stamp + 5_000_000 - round(stamp * 100e-6)  # its clock gains 100 us in every second
        health.clock.push(np.array([stamp]), np.array([arrived]))
    assert health.offset_s is None
    health.compare_clock()
    assert health.offset_s == pytest.approx(0.005 - 59 * 100e-6, abs=1e-4)


def test_every_cause_has_a_count() -> None:
    counted = {"lost", "errors"} | set(vars(Pipeline(subject()).status(SEAT)))
    assert set(CAUSES) <= counted


def test_missing_sequence_numbers_are_losses_and_each_publisher_has_its_own() -> None:
    health = SensorHealth()
    for number, received in ((7, 1), (9, 3), (14, 6), (2, 7), (3, 8)):  # 2 comes from another one
        health.numbered(number, received)
    assert health.lost == 2
    health.forget_numbers()
    health.numbered(900, 9)
    assert health.lost == 2


def test_a_count_that_grew_is_reported_for_two_updates() -> None:
    node = Node(noisy_streams(6.0))
    node.advance(6)
    node.health["head"].lost += 3
    levels = []
    for _ in range(3):
        node.check()
        levels.append(node.status("head")[0])
    assert levels == [WARN, WARN, OK]


@pytest.mark.parametrize(("name", "level"), [(SEAT, ERROR), ("head", WARN)])
def test_a_sensor_is_silent_after_half_a_second(name: str, level: int) -> None:
    node, clock = Node(noisy_streams(6.0)), [0.0]
    node.health[name].now = lambda: clock[0]
    node.advance(6)
    clock[0] = 0.5
    node.check()
    assert node.status(name)[0] == OK
    clock[0] = 0.6
    node.check()
    assert node.status(name) == (level, "silent for 0.6 s")


@pytest.mark.parametrize(("name", "level"), [(SEAT, ERROR), ("head", WARN)])
@pytest.mark.parametrize(
    ("spoil", "cause"), [(nan_for, "readings that are no numbers"), (unset_for, "never set"), (frozen_for, "too late")]
)
def test_a_sensor_that_sends_only_unusable_samples_is_at_fault(name: str, level: int, spoil, cause: str) -> None:
    node, clock = Node(faulty(name, spoil)), [0.0]
    for one in node.health.values():
        one.now = lambda: clock[0]

    def advance(checks: int) -> None:
        for _ in range(checks):
            clock[0] += 0.5
            node.advance()

    advance(6)
    assert node.status(name)[0] == OK and node.prediction() == (OK, "predicting")
    advance(3)
    found, message = node.status(name)
    assert found == level and message.startswith("no usable sample for 1.5 s: ") and cause in message
    if name == SEAT:
        assert node.prediction() == (ERROR, f"predictions stopped: seat has {message}")
    else:
        assert node.prediction() == (OK, "predicting")
    advance(3)  # the samples can be used again after two seconds
    assert "no usable sample" not in node.status(name)[1] and node.prediction()[0] != ERROR


def test_messages_that_are_refused_are_no_usable_samples() -> None:
    node, clock = Node(noisy_streams(6.0)), [0.0]
    for one in node.health.values():
        one.now = lambda: clock[0]
    node.advance(6)
    for _ in range(3):
        clock[0] += 0.5
        node.health[SEAT].arrived()
        node.health[SEAT].refused("cut off")
        node.check()
    assert node.status(SEAT) == (ERROR, "no usable sample for 1.5 s: 3 messages refused: cut off")


def test_a_return_from_silence_is_no_fault_of_the_samples() -> None:
    node, clock = Node(noisy_streams(6.0)), [0.0]
    for one in node.health.values():
        one.now = lambda: clock[0]
    node.advance(6)
    clock[0] = 3.0
    node.health[SEAT].arrived()  # the first messages are not processed yet
    node.check()
    assert node.status(SEAT) == (OK, "streaming")


def test_a_segment_that_does_not_fit_is_a_warning_and_a_mark_until_it_fits_again() -> None:
    """The head reads twice its motion from the fifth to the twentieth second."""
    law = UsualResidual((0.02,) * N_BANDS, (0.05,) * N_BANDS, 50).to_dict()
    fitted = dataclasses.replace(subject(), provenance={PROVENANCE: dict.fromkeys(MEASURED_SEGMENTS, law)})
    streams = []
    for one in noisy_streams(50.0, "road"):
        accel = one.accel_mps2.copy()
        if one.sensor == "head":
            here = slice(round(5 * RATE_HZ), round(20 * RATE_HZ))
            accel[here] += accel[here] - accel.mean(axis=0)
        streams.append(dataclasses.replace(one, accel_mps2=accel))
    node = Node(tuple(streams), fitted)
    seen = []
    for _ in range(98):
        node.advance()
        seen += [(mark.name, mark.at_s) for mark in node.monitor.misfit_marks()]
        if len(seen) == 1:
            level, message = node.prediction()
            assert level == WARN and message.startswith("head: does not fit since ") and "what is usual" in message
            assert node.statuses["prediction"].values["fits"] == "false"
    begin_s = 1e-9 * streams[0].stamps_ns[0]
    (first, at_s), (last, end_s) = seen
    assert (first, last) == ("head: does not fit", "head: fits again")
    assert 3.0 <= at_s - begin_s <= 7.0 and 18.0 <= end_s - begin_s <= 35.0
    assert node.prediction() == (OK, "predicting") and node.statuses["prediction"].values["fits"] == "true"
    assert not node.monitor.marks  # these are the user's


def test_whether_the_model_fits_is_unknown_before_enough_seconds_in_motion() -> None:
    still = tuple(
        dataclasses.replace(one, accel_mps2=np.zeros_like(one.accel_mps2) + one.accel_mps2.mean(axis=0))
        for one in noisy_streams(6.0)
    )
    drive, needed = noisy_streams(20.0, "road"), "15 s are needed"
    for streams, checks, fits, tested in (
        (drive, 2, f"unknown: no whole second in motion was compared, {needed}", "none"),
        (still, 10, f"unknown: no whole second in motion was compared, {needed}", "none"),
        (drive, 16, f"unknown: only 7 s in motion were compared, {needed}", "none"),
        (drive, 38, "true", "pelvis, lower torso, upper torso, neck, head"),
    ):
        node = Node(streams, with_spread(subject()))
        node.advance(checks)
        values = node.statuses["prediction"].values
        assert (values["fits"], values["fit_tested"]) == (fits, tested)


def test_whether_the_model_fits_is_unknown_for_a_subject_without_a_usual_residual() -> None:
    unknown = Node(noisy_streams())
    unknown.advance(4)
    assert unknown.statuses["prediction"].values["fits"].startswith("unknown: its file has no residual")
    assert unknown.statuses["prediction"].values["intervals"].startswith("none: its file has no covariance")
    sure = Node(noisy_streams(), with_spread(subject()))
    sure.advance(4)
    assert sure.statuses["prediction"].values["intervals"] == "95 %"


def test_stamps_that_jump_back_are_no_lag() -> None:
    """A looped bag: its stamps begin again, and each message arrives as promptly as before."""
    clock_s = [0.0]
    health = SensorHealth(now=lambda: clock_s[0])
    for number in range(80):
        clock_s[0] = 0.1 * number
        health.timed(round(1e9 * (0.1 * (number % 40))), round(1e9 * clock_s[0]), window_s=10.0)
        assert health.lag_s == pytest.approx(0.0, abs=1e-6), number
