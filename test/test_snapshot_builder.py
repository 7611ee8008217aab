"""Snapshots of the live page: figures as the pipeline counts them, and no green verdict in doubt."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from provenances import with_spread
from streams import START_NS, noisy_streams, subject

from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.exposure.figure_spread import interval
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_ros.base import topics
from biodyn_ros.node.health import HealthMonitor, SensorHealth, seat_fault, silences_s
from biodyn_ros.node.snapshot_builder import LEAST_SEAT_MPS2, ROWS, SnapshotBuilder
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import exposure_report

GENTLE = {"case": "road", "seconds": 6.0, "seed": 3}


class Ride:
    """A pipeline driven as the node drives it, with the health of its sensors and the page's snapshots."""

    def __init__(self, person=None, **pipeline):
        self.pipeline, self.builder = Pipeline(person or subject(), **pipeline), SnapshotBuilder(5.0)
        self.clock_s = 0.0
        self.health = {name: SensorHealth(now=lambda: self.clock_s) for name in SENSORS}
        self.monitor = HealthMonitor(self.pipeline, self.health)
        self.snapshots = []

    def drive(self, streams, block=280, without=(), behind=None):
        """Push the streams in turn, some so many samples behind, with four snapshots a second."""
        length = max(stream.stamps_ns.size for stream in streams)
        for at in range(0, length, block):
            self.clock_s += block / 1129.3
            for stream in streams:
                if stream.sensor not in without:
                    begin = at - (behind or {}).get(stream.sensor, 0)
                    part = slice(max(0, begin), max(0, begin + block))
                    if part.stop == 0:
                        continue
                    self.builder.add(self.pipeline.push(stream.sensor, stream.stamps_ns[part], stream.accel_mps2[part]))
                    self.health[stream.sensor].arrived()
            self.snapshot()
        return self

    def snapshot(self):
        """Add a snapshot, through JSON as for the page."""
        self.builder.update()
        snapshot = self.builder.snapshot(self.pipeline, self.monitor.check(), self.monitor.marks)
        self.snapshots.append(json.loads(json.dumps(snapshot, allow_nan=False)))
        return self.snapshots[-1]


@cache
def gentle():
    """A gentle ride that nothing is added to."""
    return Ride().drive(noisy_streams(**GENTLE))


def changed(streams, sensor, change):
    return [change(stream) if stream.sensor == sensor else stream for stream in streams]


def test_the_rows_are_the_rolling_figures_and_their_ratios():
    ride = gentle()
    shown, rolling = ride.snapshots[-1], ride.pipeline.exposure(rolling=True)
    rows = {row["name"]: row for row in shown["rows"]}
    assert list(rows) == [name.replace("_", " ") for name in ROWS]
    measured, predicted, seat = (dose.aw_mps2 for dose in rolling.compared["head"])
    assert rows["head"]["measured_mps2"] == measured == rolling.measured_low_passed["head"].aw_mps2
    assert rows["head"]["predicted_mps2"] == predicted
    assert rows["head"]["measured_ratio"] == pytest.approx(measured / seat)
    assert rows["head"]["residual_mps2"] == rolling.residual["head"][0]
    assert (rows["central torso"]["measured_mps2"], rows["central torso"]["sensor"]) == (None, None)
    alone = rolling.compared["central_torso"]
    assert rows["central torso"]["predicted_ratio"] == alone.predicted.aw_mps2 / alone.seat.aw_mps2
    assert rows["seat"]["predicted_mps2"] is None
    force = rolling.joint_forces["lower_torso"]
    assert (rows["lower torso"]["compression_n"], rows["lower torso"]["tension_n"]) == (
        force.compression_n,
        force.tension_n,
    )
    assert rows["seat"]["compression_n"] is None


def test_peaks_of_force_are_lower_bounds_as_in_the_document():
    """Missing samples of the seat lower a peak, not a mean."""
    streams = noisy_streams(**GENTLE)
    kept = np.ones(streams[0].stamps_ns.size, dtype=bool)
    kept[4000:4300] = False
    gap = [replace(one, stamps_ns=one.stamps_ns[kept], accel_mps2=one.accel_mps2[kept]) for one in streams]
    for sent, lower in ((streams, False), (gap, True)):
        ride = Ride().drive(sent)
        joint = exposure_document(exposure_report(ride.pipeline))["joint_forces"]["head"]
        head = ride.snapshots[-1]["rows"][0]
        assert head["force_lower_bound"] == joint["lower_bound"] == lower
        assert not head["predicted_lower_bound"]


def test_whether_the_model_fits_is_unknown_until_enough_motion_was_compared():
    ride = Ride(with_spread(subject()))
    assert ride.drive(noisy_streams(**GENTLE), without=SENSORS[1:]).snapshots[-1]["fit"] == {
        "fits": None, "misfits": [], "unknown": "no whole second in motion was compared, 15 s are needed",
        "tested": " (tested: none)",
    }  # fmt: skip
    ride = Ride(with_spread(subject()))
    assert ride.drive(noisy_streams(20.0, "road")).snapshots[-1]["fit"] == {
        "fits": True, "misfits": [], "unknown": "", "tested": "",
    }  # fmt: skip


def test_every_bin_of_the_strip_is_sent_once():
    shown = gentle().snapshots
    begins = [begin for one in shown for begin in one["strip"]["measured"]["begin_s"]]
    assert begins == sorted(set(begins))
    assert np.diff(begins) == pytest.approx(0.1, abs=1e-3)
    assert 0.0 <= begins[0] - 1e-9 * START_NS < 2.0


def test_predictions_have_their_intervals_and_each_second_of_the_error_is_sent_once():
    ride = Ride(with_spread(subject())).drive(noisy_streams(**GENTLE))
    shown, rolling = ride.snapshots[-1], ride.pipeline.exposure(rolling=True)
    head, spread = shown["rows"][0], rolling.spreads["head"]
    assert head["predicted_interval_mps2"] == [*interval(head["predicted_mps2"], spread.accel.of_means)]
    assert head["compression_interval_n"] == [*interval(head["compression_n"], spread.force.of_compression)]
    assert shown["rows"][-1]["predicted_interval_mps2"] is None
    assert shown["no_interval"] is None
    sent = [one["strip"]["error"] for one in ride.snapshots if "error" in one["strip"]]
    assert len(sent) > 3
    recent = ride.pipeline.predictor.intervals.recent
    assert [begin for one in sent for begin in one["begin_s"]] == [1e-9 * one.begin_ns for one in recent]
    half = np.concatenate([one["high"] for one in sent])
    np.testing.assert_allclose(half, [NORMAL_95 * one.accel_mps2 for one in recent], atol=5e-4)
    np.testing.assert_array_equal(np.concatenate([one["low"] for one in sent]), -half)


def test_seconds_whose_stamps_jump_back_are_sent_too():
    ride, streams = Ride(with_spread(subject())), noisy_streams(**GENTLE)
    for shift_s in (0.0, -3.0):
        ride.drive([replace(stream, stamps_ns=stream.stamps_ns + round(1e9 * shift_s)) for stream in streams])
    begins = [begin for one in ride.snapshots for begin in one["strip"].get("error", {}).get("begin_s", [])]
    assert min(np.diff(begins)) < 0.0
    assert begins[-1] == 1e-9 * ride.pipeline.predictor.intervals.recent[-1].begin_ns


def test_a_subject_without_a_fit_has_no_intervals_and_the_reason_is_sent():
    shown = gentle().snapshots[-1]
    assert "covariance" in shown["no_interval"]
    assert "error" not in shown["strip"]
    assert {row["predicted_interval_mps2"] for row in shown["rows"]} == {None}
    assert {row["compression_interval_n"] for row in shown["rows"]} == {None}


def test_a_gentle_ride_with_a_yaw_is_green():
    shown = Ride(settings=PipelineSettings(yaw_deg=0.0)).drive(noisy_streams(**GENTLE)).snapshots[-1]
    assert shown["verdict"]["tone"] == "good", shown["verdict"]


def clipped(stream):
    accel = stream.accel_mps2.copy()
    accel[4000:4003, 2] = 160.0
    return replace(stream, accel_mps2=accel)


def vertical_only(stream):
    up = np.array([0.0, 0.0, 1.0])
    return replace(stream, accel_mps2=np.outer(np.linalg.norm(stream.accel_mps2, axis=1), up))


def stuck(stream):
    accel = stream.accel_mps2.copy()
    accel[3000:] = accel[3000]
    return replace(stream, accel_mps2=accel)


@pytest.mark.parametrize("spoil", [clipped, vertical_only, stuck])
def test_a_seat_that_is_clipped_vertical_only_or_stuck_is_not_green(spoil):
    shown = Ride().drive(changed(noisy_streams(**GENTLE), SEAT, spoil)).snapshots[-1]
    assert shown["verdict"]["tone"] == "none"
    assert shown["verdict"]["reasons"]


def test_a_silent_seat_is_not_green_when_all_sensors_are_silent():
    ride = Ride().drive(noisy_streams(**GENTLE))
    assert ride.snapshots[-1]["verdict"]["tone"] == "good"
    ride.clock_s += 0.8
    shown = ride.snapshot()
    assert shown["verdict"]["tone"] == "none"
    assert "silent for 0.8 s" in shown["verdict"]["reasons"][0]
    assert "left" in ride.snapshots[-2]["seat"]["left"]["action"]
    assert shown["seat"]["left"] == {"action": "withheld", "limit": "withheld"}, "no time left is shown"


def test_without_an_axis_no_topic_gives_a_time_left():
    seat = gentle().pipeline.seat()
    assert set(topics.seat_values(seat)) == {
        f"{topics.EXPOSURE}/seat/{name}" for name in ("a8", "time_to_action_value", "time_to_limit_value")
    }
    dead = replace(seat, projected_lower_bound=True)
    assert topics.seat_values(dead) == {f"{topics.EXPOSURE}/seat/a8": seat.a8_so_far_mps2}


def test_the_rolling_window_ends_now_when_all_sensors_are_silent():
    ride = gentle()
    seconds = ride.pipeline.settings.window_s
    whole, later = (ride.pipeline.exposure(True, {SEAT: s}).sensors[SEAT].seconds for s in (0.0, seconds - 1.0))
    assert later == pytest.approx(min(whole, 1.0), abs=0.2) and later < whole


def test_when_all_sensors_are_silent_no_topic_gives_a_time_left_or_a_figure_of_the_window():
    ride = Ride().drive(noisy_streams(**GENTLE))

    def published():
        statuses = {status.of: status for status in ride.monitor.check()}
        return set(topics.scalar_values(ride.pipeline, silences_s(statuses), bool(seat_fault(statuses))))

    sending = published()
    times = {f"{topics.EXPOSURE}/seat/time_to_{kind}_value" for kind in ("action", "limit")}
    rolling = {name for name in sending if name.startswith(topics.ROLLING)} | set(topics.RESIDUAL.values())
    assert times < sending and f"{topics.ROLLING}/seat/aw" in rolling < sending
    ride.clock_s += 0.8
    assert published() == sending - times
    ride.clock_s += 10.0
    assert published() == sending - times - rolling
    rows = ride.snapshot()["rows"]
    assert {row[figure] for row in rows for figure in ("measured_mps2", "predicted_mps2", "residual_mps2")} == {None}


def not_finite(stream):
    accel = stream.accel_mps2.copy()
    accel[4000:] = np.nan
    return replace(stream, accel_mps2=accel)


def unset(stream):
    stamps_ns = stream.stamps_ns.copy()
    stamps_ns[4000:] = 0
    return replace(stream, stamps_ns=stamps_ns)


def frozen(stream):
    stamps_ns = stream.stamps_ns.copy()
    stamps_ns[4000:] = stamps_ns[4000]
    return replace(stream, stamps_ns=stamps_ns)


@pytest.mark.parametrize("spoil", [not_finite, unset, frozen])
@pytest.mark.parametrize("sensors", [(SEAT,), SENSORS])
def test_a_seat_that_sends_only_unusable_samples_is_not_green(spoil, sensors):
    ride = Ride().drive([spoil(stream) for stream in noisy_streams(**GENTLE) if stream.sensor in sensors])
    tones = [shown["verdict"]["tone"] for shown in ride.snapshots]
    fault = 4000 // 280
    assert tones[fault - 1] == "good" and set(tones[fault + 1 :]) == {"none"}, "grey from the next snapshot on"
    shown = ride.snapshots[-1]
    assert "no usable sample for" in shown["verdict"]["reasons"][0]
    assert shown["seat"]["left"] == {"action": "withheld", "limit": "withheld"}
    lost_s = (len(noisy_streams(**GENTLE)[0].stamps_ns) - 4000) / 1129.3
    assert shown["seat"]["missing_s"] == pytest.approx(lost_s, abs=0.02) and shown["seat"]["lower_bound"]
    assert shown["prediction"]["message"].startswith("predictions stopped: seat has no usable sample")


def test_two_publishers_on_the_seat_are_not_green():
    ride = Ride().drive(noisy_streams(**GENTLE))
    ride.health[SEAT].publishers = 2
    assert ride.snapshot()["verdict"]["tone"] == "none"


def test_with_the_seat_alone_missing_measurements_are_not_zero():
    streams = noisy_streams(**GENTLE)
    shown = Ride().drive(streams, without=set(SENSORS) - {SEAT}).snapshots[-1]
    head = shown["rows"][0]
    assert head["measured_mps2"] is None
    assert head["residual_mps2"] is None
    assert head["predicted_mps2"] > 0.1
    assert head["sensor"]["message"] == "no message yet"


def test_before_the_first_sample_the_page_waits():
    shown = Ride().snapshot()
    assert (shown["seat"], shown["dri"], shown["shocks"]) == (None, None, [])
    assert shown["verdict"]["tone"] == "none"
    assert "no message yet" in shown["verdict"]["reasons"][0]


def test_a_seat_at_rest_has_no_transmissibility():
    still = [at_rest(stream) for stream in noisy_streams(**GENTLE)]
    head = Ride().drive(still).snapshots[-1]["rows"][0]
    assert head["measured_mps2"] < LEAST_SEAT_MPS2
    assert (head["measured_ratio"], head["predicted_ratio"]) == (None, None)


def at_rest(stream):
    noise = np.random.default_rng(SENSORS.index(stream.sensor)).normal(0.0, 0.01, (4000, 3))
    return replace(stream, stamps_ns=stream.stamps_ns[:4000], accel_mps2=stream.accel_mps2[:600].mean(axis=0) + noise)


def test_shocks_are_listed_with_seat_and_head():
    streams = noisy_streams(3.0)
    shown = Ride().drive(streams).snapshots[-1]
    assert shown["shocks"]
    seat = next(stream for stream in streams if stream.sensor == SEAT).accel_mps2
    strongest = max(shock["seat_mps2"] for shock in shown["shocks"])
    # Low-passed at 100 Hz and along the vertical: not more than the raw reading, and most of it.
    raw = np.abs(np.linalg.norm(seat, axis=1) - 9.81).max()
    assert 0.6 * raw < strongest < 1.1 * raw


@pytest.mark.parametrize("leap_s", [-6.0, 1.0])
def test_leaps_and_a_dead_sensor_leave_finite_numbers(leap_s):
    ride, streams = Ride(), noisy_streams(**GENTLE)
    for lap in range(3):
        shift_ns = round(1e9 * lap * (6.0 + leap_s))
        shifted = [replace(stream, stamps_ns=stream.stamps_ns + shift_ns) for stream in streams]
        ride.drive(shifted, without={"head"} if lap == 2 else ())
    assert ride.snapshots[-1]["seat"]["counted_s"] > 15.0
    assert ride.pipeline.losses("head").missing_s > 3.0
    json.dumps(exposure_document(exposure_report(ride.pipeline)), allow_nan=False)


def test_a_clipped_sensor_is_a_lower_bound_in_rows_and_shocks():
    shown = Ride().drive(changed(noisy_streams(), "head", clipped)).snapshots[-1]
    rows = {row["name"]: row for row in shown["rows"]}
    assert rows["head"]["measured_lower_bound"] and not rows["neck"]["measured_lower_bound"]
    assert not rows["head"]["predicted_lower_bound"]
    assert shown["shocks"] and all(
        shock["head_lower_bound"] and not shock["seat_lower_bound"] for shock in shown["shocks"]
    )


def test_after_a_reset_earlier_shocks_and_the_window_stay_lower_bounds():
    """Both show samples from before the reset, and a new shock has the losses since then alone."""
    ride = Ride().drive(changed(noisy_streams(), "head", clipped))
    ride.pipeline.reset()
    shown = ride.snapshot()
    assert shown["rows"][0]["measured_lower_bound"] and not shown["rows"][-1]["measured_lower_bound"]
    assert shown["shocks"] and all(shock["head_lower_bound"] for shock in shown["shocks"])
    later = [replace(one, stamps_ns=one.stamps_ns + 6 * 10**9) for one in noisy_streams()]
    for _ in range(2):
        ride.drive(later, block=560)
        later = [replace(one, stamps_ns=one.stamps_ns + 6 * 10**9) for one in later]
    shown = ride.snapshots[-1]
    assert not shown["rows"][0]["measured_lower_bound"], "the window lies after the reset"
    bounds = [shock["head_lower_bound"] for shock in shown["shocks"]]
    assert bounds == [shock["at_s"] < 1e-9 * START_NS + 5.5 for shock in shown["shocks"]] and len(set(bounds)) == 2


def test_another_publisher_s_type_stops_no_prediction_and_a_silent_sensor_has_no_rate():
    ride = Ride().drive(noisy_streams(**GENTLE), without=("head",))
    ride.health[SEAT].wrong_type = "a publisher sends std_msgs/msg/String"
    shown = ride.snapshot()
    assert shown["prediction"]["message"] == "predicting"
    rows = {row["name"]: row for row in shown["rows"]}
    assert rows["seat"]["sensor"]["level"] == 2 and rows["seat"]["sensor"]["rate_hz"] > 1000.0
    ride.clock_s += 1.0
    shown = ride.snapshot()
    assert "std_msgs/msg/String" in shown["prediction"]["message"]
    assert all(row["sensor"]["rate_hz"] is None for row in shown["rows"] if row["sensor"])
