"""Exposure that outlives its process: two runs with a break are one run with a gap, and what passed is missing."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from streams import RATE_HZ, in_turn, noisy_streams, run, subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.exposure.exposure_store import ExposureCheckpoint, digest
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings

BELONGS = {"subject": "a", "sensors": "b"}
ALSO = PipelineSettings(also_weighted="Wb", yaw_deg=0.0)


def parted(begin: int, end: int, held_out: tuple[str, ...] = ()) -> tuple[Pipeline, Pipeline]:
    """The same ride twice: in one pipeline with a gap, and in two with exposure kept as text in between."""
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    before = [cut for cut in cuts if cut[1] < begin]
    after = [cut for cut in cuts if cut[1] >= end and cut[0] not in held_out]
    whole = run(streams, before + after, finish=False, pipeline=Pipeline(subject(), settings=ALSO)).pipeline
    first = run(streams, before, finish=False, pipeline=Pipeline(subject(), settings=ALSO)).pipeline
    text = json.dumps(first.kept(BELONGS).to_dict())
    second = Pipeline(subject(), settings=ALSO)
    second.resume(ExposureCheckpoint.from_dict(json.loads(text)))
    return whole, run(streams, after, finish=False, pipeline=second).pipeline


def test_a_run_that_goes_on_is_one_run_with_a_gap() -> None:
    whole, second = parted(40 * 140, 48 * 140)
    one, other = whole.exposure(), second.exposure()
    for name in SENSORS:
        assert other.sensors[name].vdv_mps175 == pytest.approx(one.sensors[name].vdv_mps175, rel=2e-3)
        assert other.sensors[name].aw_mps2 == pytest.approx(one.sensors[name].aw_mps2, rel=2e-3)
        assert other.sensors[name].seconds == pytest.approx(one.sensors[name].seconds, abs=0.01)
        lost = second.lost(name)
        assert lost.missing_s == pytest.approx(whole.lost(name).missing_s, abs=0.01) and lost.lower_bound
        assert lost.missing_s == pytest.approx(8 * 140 / RATE_HZ, abs=0.01)
        assert other.also["Wb"][name].vdv_mps175 == pytest.approx(one.also["Wb"][name].vdv_mps175, rel=2e-3)
    for name, dose in one.predicted.items():
        assert other.predicted[name].vdv_mps175 == pytest.approx(dose.vdv_mps175, rel=5e-3), name
    for name, (rms, _) in one.residual.items():
        assert other.residual[name][0] == pytest.approx(rms, rel=0.02), name
    assert (other.dri.compression, other.dri.as_printed) == pytest.approx(
        (one.dri.compression, one.dri.as_printed), rel=1e-3
    )
    assert other.dri.time_s == pytest.approx(one.dri.time_s, abs=0.01)
    assert other.hic15.vertical == pytest.approx(one.hic15.vertical, rel=1e-3)
    seat, twin = second.seat(), whole.seat()
    assert seat.vdv_weighted_mps175 == pytest.approx(twin.vdv_weighted_mps175, rel=5e-3)
    assert seat.lower_bound and seat.time_to_action_value_s is None  # more than 1 % is missing


def test_a_prediction_stays_extrapolated_and_what_was_not_predicted_missing_behind_a_restart() -> None:
    """The seat has moved harder than in the fit before it, and rests since."""
    streams = noisy_streams(8.0)
    rest = tuple(
        dataclasses.replace(s, stamps_ns=s.stamps_ns[:1100] + 12 * 10**9, accel_mps2=s.accel_mps2[:1100])
        for s in streams
    )
    fitted = dataclasses.replace(subject(), provenance={"seat_peak_mps2": 1.0})
    first = run(streams, in_turn(streams, 140), finish=False, pipeline=Pipeline(fitted)).pipeline
    assert first.is_extrapolating
    first._seat.unpredicted = 140  # as if the model had left its range
    for resumes in (True, False):
        second = Pipeline(fitted)
        if resumes:
            second.resume(ExposureCheckpoint.from_dict(json.loads(json.dumps(first.kept(BELONGS).to_dict()))))
        run(rest, in_turn(rest, 140), finish=False, pipeline=second)
        assert second.exposure().predicted and second.is_extrapolating == resumes
        assert second.unpredicted_s == pytest.approx(140 / RATE_HZ if resumes else 0.0, rel=1e-3)
    second.reset()
    assert not second.is_extrapolating


def test_gravity_is_known_behind_a_restart_and_counting_goes_on_at_once() -> None:
    """It restarts in the middle of the ride, where nothing rests."""
    _, second = parted(40 * 140, 41 * 140)
    for name in SENSORS:
        status = second.status(name)
        assert status.uncounted_s == status.unrested_s == 0.0 and not status.warnings


def test_after_a_minute_rest_is_looked_for_anew() -> None:
    streams = noisy_streams(8.0)
    first = run(streams, in_turn(streams, 140), finish=False).pipeline
    late = [(one.sensor, one.stamps_ns + 70 * 10**9 + 10**10, one.accel_mps2) for one in streams]
    second = Pipeline(subject())
    second.resume(first.kept(BELONGS))
    for at in range(0, 8000, 140):
        for sensor, stamps_ns, accel in late:
            second.push(sensor, stamps_ns[at : at + 140], accel[at : at + 140])
    assert second.status(SEAT).uncounted_s == pytest.approx(0.8, abs=0.01)
    assert second.lost(SEAT).missing_s == pytest.approx(70.0 + 10.0 - len(streams[0].stamps_ns) / RATE_HZ, abs=0.05)


def test_a_sensor_that_does_not_come_back_keeps_its_figures_and_is_missing() -> None:
    whole, second = parted(40 * 140, 48 * 140, ("neck",))
    one, other = whole.exposure().sensors["neck"], second.exposure().sensors["neck"]
    assert other.vdv_mps175 == pytest.approx(one.vdv_mps175, rel=1e-9)
    assert second.lost("neck").missing_s == pytest.approx(whole.lost("neck").missing_s, abs=0.01)
    # And the next run but one knows it still.
    again = second.kept(BELONGS).sensors["neck"]
    np.testing.assert_allclose(again.meters["vertical"], whole.kept(BELONGS).sensors["neck"].meters["vertical"])


def test_reset_forgets_what_was_before_the_restart_too() -> None:
    _, second = parted(40 * 140, 48 * 140)
    second.reset()
    assert second.lost(SEAT).missing_s == 0.0 and second.exposure().sensors[SEAT].seconds == 0.0
    waiting = Pipeline(subject())
    waiting.resume(second.kept(BELONGS))
    waiting.reset()
    assert waiting.exposure().sensors == {} and waiting.kept(BELONGS) is None


def passed_on(first: Pipeline) -> Pipeline:
    """A pipeline that goes on from what another kept, as text."""
    second = Pipeline(subject())
    second.resume(ExposureCheckpoint.from_dict(json.loads(json.dumps(first.kept(BELONGS).to_dict()))))
    return second


def test_a_sensor_that_was_silent_before_the_restart_misses_those_seconds_once() -> None:
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    silent = [cut for cut in cuts if cut[1] < 40 * 140 and not (cut[0] == "neck" and cut[1] >= 20 * 140)]
    back = [cut for cut in cuts if cut[1] >= 44 * 140]
    second = passed_on(run(streams, silent, finish=False).pipeline)
    run(streams, back, finish=False, pipeline=second)
    assert second.lost("neck").missing_s == pytest.approx(24 * 140 / RATE_HZ, abs=0.02)
    assert second.lost(SEAT).missing_s == pytest.approx(4 * 140 / RATE_HZ, abs=0.02)


def test_a_sensor_that_comes_back_after_the_others_misses_those_seconds_once() -> None:
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    second = passed_on(run(streams, [cut for cut in cuts if cut[1] < 30 * 140], finish=False).pipeline)
    after = [cut for cut in cuts if cut[1] >= (48 if cut[0] == "neck" else 34) * 140]
    run(streams, after, finish=False, pipeline=second)
    assert second.lost("neck").missing_s == pytest.approx(18 * 140 / RATE_HZ, abs=0.02)


@pytest.mark.parametrize("rate_hz", [500.0, 1129.3])
def test_a_sensor_that_comes_back_at_another_rate_looks_for_rest_and_is_read_at_its_own(rate_hz: float) -> None:
    """The README: a sensor that changes its rate needs a restart."""
    before = run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline
    at_s = np.arange(round(2.0 * rate_hz)) / rate_hz
    stamps_ns = noisy_streams()[0].stamps_ns[-1] + 10**9 + np.rint(1e9 * at_s).astype(np.int64)
    accel = np.tile([0.0, 0.0, 9.8], (at_s.size, 1)) + 1e-3 * np.sin(at_s)[:, None]
    second = passed_on(before)
    for at in range(0, at_s.size, 7):
        second.push(SEAT, stamps_ns[at : at + 7], accel[at : at + 7])
    status = second.status(SEAT)
    assert status.rate_hz == pytest.approx(rate_hz, rel=1e-3) and status.late == status.filled == 0
    assert (status.uncounted_s > 0.5) == (rate_hz == 500.0)


def test_what_a_sensor_sent_too_little_of_to_be_known_again_is_taken_at_the_end() -> None:
    streams = noisy_streams(8.0)
    second = passed_on(run(streams, [(s.sensor, 0, 4000) for s in streams], finish=False).pipeline)
    seconds = second.exposure().sensors[SEAT].seconds
    second.push(SEAT, streams[0].stamps_ns[4100:4140], streams[0].accel_mps2[4100:4140])
    assert second.exposure().sensors[SEAT].seconds == seconds
    second.finish()
    assert second.exposure().sensors[SEAT].seconds == pytest.approx(seconds + 40 / RATE_HZ, rel=1e-6)


@pytest.mark.parametrize("lean", [(0.02, 0.0), (0.0, 0.02), (0.02, 0.02)])
def test_horizontal_doses_of_two_runs_add_up_along_the_sensor_s_own_axes(lean: tuple[float, float]) -> None:
    """Upside down, and parked on another slope: the smallest rotation upright turns the plane by up to half a turn."""
    at_s = np.arange(round(20.0 * RATE_HZ)) / RATE_HZ
    moving = np.where(at_s > 2.0, 2.0 * np.sin(2.0 * np.pi * 1.5 * at_s), 0.0)

    def ride(pipeline: Pipeline, up: np.ndarray, start_s: float) -> None:
        accel = 9.81 * up / np.linalg.norm(up) + np.outer(moving, [1.0, 0.0, 0.0])
        stamps_ns = np.rint(1e9 * (start_s + at_s)).astype(np.int64)
        for at in range(0, at_s.size, 200):
            pipeline.push(SEAT, stamps_ns[at : at + 200], accel[at : at + 200])

    first = Pipeline(subject(), settings=ALSO)
    ride(first, np.array([0.02, 0.0, -1.0]), 1e6)
    second = Pipeline(subject(), settings=ALSO)
    second.resume(first.kept(BELONGS))
    ride(second, np.array([*lean, -1.0]), 1e6 + 3600.0)
    once, twice = first.seat(), second.seat()
    assert once.vdv_weighted_mps175["x"] > 50.0 * once.vdv_weighted_mps175["y"]
    assert twice.vdv_weighted_mps175["x"] == pytest.approx(2.0**0.25 * once.vdv_weighted_mps175["x"], rel=2e-3)
    assert twice.aw_weighted_mps2["x"] == pytest.approx(once.aw_weighted_mps2["x"], rel=2e-3)


def test_behind_a_restart_a_sensor_that_has_not_come_back_has_no_rolling_figures() -> None:
    _, second = parted(40 * 140, 48 * 140, ("neck",))
    rolling = second.exposure(rolling=True)
    assert "neck" not in rolling.sensors and "neck" not in rolling.also["Wb"] and "neck" in second.exposure().sensors
    assert set(rolling.sensors) == set(SENSORS) - {"neck"}


def test_before_anything_counts_there_is_nothing_to_keep() -> None:
    assert Pipeline(subject()).kept(BELONGS) is None


def test_what_tells_two_exposures_apart_is_named() -> None:
    kept = run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline.kept(BELONGS)
    assert kept.foreign_to(BELONGS) == ""
    assert kept.foreign_to({"subject": "a", "sensors": "c"}) == "sensors"
    assert digest({"x": 1, "y": [1.5]}) == digest({"y": [1.5], "x": 1}) != digest({"x": 1, "y": [1.6]})


def spoilt() -> dict:
    """Documents that `to_dict` never wrote."""
    good = run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline.kept(BELONGS).to_dict()

    def with_(*path: str, value: object) -> dict:
        document = json.loads(json.dumps(good))
        where = document
        for key in path[:-1]:
            where = where[key]
        where[path[-1]] = value
        return document

    seat = ("sensors", "seat")
    return {
        "a list": [],
        "nothing": {},
        "no sensors": with_("sensors", value={}),
        "a knee": with_("sensors", value={"knee": good["sensors"]["seat"]}),
        "not a number": with_(*seat, "meters", "vertical", value=[[float("nan")] * 5]),
        "a text": with_(*seat, "meters", "vertical", value="x"),
        "an endless number": with_(*seat, "lost", value=[0, 1e999, 0]),
        "too few": with_(*seat, "lost", value=[0]),
        "a stamp that is none": with_(*seat, "newest_ns", value=-1),
        "told before it was measured": with_(*seat, "told_ns", value=1),
        "a period of zero": with_(*seat, "rest", value=good["sensors"]["seat"]["rest"] | {"period_s": 0.0}),
        "a rest of another kind": with_(*seat, "rest", value={"x": 1}),
    }


@pytest.mark.parametrize("name", spoilt())
def test_what_was_never_kept_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match="no exposure that was kept") as caught:
        ExposureCheckpoint.from_dict(spoilt()[name])
    assert "\n" not in str(caught.value)


def test_rows_of_another_meter_are_refused() -> None:
    document = run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline.kept(BELONGS).to_dict()
    document["sensors"]["seat"]["meters"]["plane"] = [[1.0, 2.0]]
    with pytest.raises(InputError, match=r"plane: kept as \(1, 2\), \(1, 9\) are needed"):
        Pipeline(subject()).resume(ExposureCheckpoint.from_dict(document))


def test_sums_of_powers_below_zero_are_refused_before_the_ride() -> None:
    document = run(noisy_streams(), in_turn(noisy_streams()), finish=False).pipeline.kept(BELONGS).to_dict()
    assert min(document["sensors"]["seat"]["meters"]["plane"][0]) < 0.0  # a mixed moment may be
    Pipeline(subject()).resume(ExposureCheckpoint.from_dict(document))
    document["sensors"]["head"]["meters"]["vertical"][0][0] *= -1.0
    with pytest.raises(InputError, match="vertical: kept with a sum of powers below zero"):
        Pipeline(subject()).resume(ExposureCheckpoint.from_dict(document))
