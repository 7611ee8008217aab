"""Exposure across restarts: two runs with a break equal one run with a gap, and the break is missing."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from streams import RATE_HZ, in_turn, noisy_streams, subject

from biodyn_core.base.digests import digest
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.body.synthesis import ImuStream
from biodyn_core.exposure.checkpoint import ExposureCheckpoint
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings

IDENTITY = {"subject": "a", "sensors": "b"}
SETTINGS = PipelineSettings(also_weighted="Wb", yaw_deg=0.0)


def as_text(exposure: ContinuedExposure) -> ExposureCheckpoint:
    """The checkpoint of an exposure, through a file's text."""
    return ExposureCheckpoint.from_dict(json.loads(json.dumps(exposure.checkpoint(IDENTITY).to_dict())))


def ride(
    streams: tuple[ImuStream, ...], cuts: list[tuple[str, int, int]], exposure: ContinuedExposure | None = None
) -> ContinuedExposure:
    """Push the cuts (sensor, first, end) into an exposure, a new one by default."""
    exposure, by_name = exposure or ContinuedExposure(Pipeline(subject())), {s.sensor: s for s in streams}
    for name, begin, end in cuts:
        exposure.push(name, by_name[name].stamps_ns[begin:end], by_name[name].accel_mps2[begin:end])
    return exposure


def counted() -> ContinuedExposure:
    """An exposure that has counted three seconds."""
    return ride(noisy_streams(), in_turn(noisy_streams()))


def continued(first: ContinuedExposure, settings: PipelineSettings | None = None) -> ContinuedExposure:
    """An exposure that continues the checkpoint of another."""
    second = ContinuedExposure(Pipeline(first.pipeline.subject, settings=settings))
    second.resume(as_text(first))
    return second


def split(begin: int, end: int, held_out: tuple[str, ...] = ()) -> tuple[ContinuedExposure, ContinuedExposure]:
    """The same ride twice: in one run with a gap, and in two runs with a checkpoint in between."""
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    before = [cut for cut in cuts if cut[1] < begin]
    after = [cut for cut in cuts if cut[1] >= end and cut[0] not in held_out]
    whole, first = (ContinuedExposure(Pipeline(subject(), settings=SETTINGS)) for _ in range(2))
    ride(streams, before, first)
    return ride(streams, before + after, whole), ride(streams, after, continued(first, SETTINGS))


def test_a_continued_run_equals_one_run_with_a_gap() -> None:
    whole, second = (exposure.pipeline for exposure in split(40 * 140, 48 * 140))
    one, other = whole.exposure(), second.exposure()
    for name in SENSORS:
        assert other.sensors[name].vdv_mps175 == pytest.approx(one.sensors[name].vdv_mps175, rel=2e-3)
        assert other.sensors[name].aw_mps2 == pytest.approx(one.sensors[name].aw_mps2, rel=2e-3)
        assert other.sensors[name].seconds == pytest.approx(one.sensors[name].seconds, abs=0.01)
        losses = second.losses(name)
        assert losses.missing_s == pytest.approx(whole.losses(name).missing_s, abs=0.01) and losses.lower_bound
        assert losses.missing_s == pytest.approx(8 * 140 / RATE_HZ, abs=0.01)
        assert other.further["Wb"][name].vdv_mps175 == pytest.approx(one.further["Wb"][name].vdv_mps175, rel=2e-3)
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


def test_extrapolation_and_missing_predictions_outlast_a_restart() -> None:
    """Before it, the seat moved harder than in the fit; since then it rests."""
    streams = noisy_streams(8.0)
    rest = tuple(
        dataclasses.replace(s, stamps_ns=s.stamps_ns[:1100] + 12 * 10**9, accel_mps2=s.accel_mps2[:1100])
        for s in streams
    )
    fitted = dataclasses.replace(subject(), provenance={"seat_peak_mps2": 1.0})
    first = ride(streams, in_turn(streams, 140), ContinuedExposure(Pipeline(fitted)))
    assert first.pipeline.run_status().is_extrapolating
    first.pipeline.predictor.unpredicted = 140  # as if the model had left its range
    for resumes in (True, False):
        second = continued(first) if resumes else ContinuedExposure(Pipeline(fitted))
        status = ride(rest, in_turn(rest, 140), second).pipeline.run_status()
        assert second.pipeline.exposure().predicted and status.is_extrapolating == resumes
        # With the stored gravity the run may begin in motion, and the chain settles; a rest of its own needs no time.
        assert status.unpredicted_s == pytest.approx((140 + 1100) / RATE_HZ if resumes else 0.0, rel=1e-3)
    second.reset()
    assert not second.pipeline.run_status().is_extrapolating


def test_gravity_is_known_after_a_restart_and_counting_starts_at_once() -> None:
    """The restart is in the middle of the ride, without any rest."""
    second = split(40 * 140, 41 * 140)[1].pipeline
    for name in SENSORS:
        status = second.status(name)
        assert status.uncounted_s == status.unrested_s == 0.0 and not status.warnings


def test_after_a_minute_a_new_rest_is_needed() -> None:
    streams = noisy_streams(8.0)
    late = tuple(dataclasses.replace(one, stamps_ns=one.stamps_ns + 70 * 10**9 + 10**10) for one in streams)
    second = ride(late, in_turn(late, 140), continued(ride(streams, in_turn(streams)))).pipeline
    assert second.status(SEAT).uncounted_s == pytest.approx(0.8, abs=0.01)
    assert second.losses(SEAT).missing_s == pytest.approx(70.0 + 10.0 - len(streams[0].stamps_ns) / RATE_HZ, abs=0.05)


def test_a_sensor_that_does_not_return_keeps_its_figures_and_is_missing() -> None:
    whole, second = split(40 * 140, 48 * 140, ("neck",))
    one, other = whole.pipeline.exposure().sensors["neck"], second.pipeline.exposure().sensors["neck"]
    assert other.vdv_mps175 == pytest.approx(one.vdv_mps175, rel=1e-9)
    missing_s = whole.pipeline.losses("neck").missing_s
    assert second.pipeline.losses("neck").missing_s == pytest.approx(missing_s, abs=0.01)
    # The next checkpoint contains it too.
    of_whole, of_second = (exposure.checkpoint(IDENTITY).sensors["neck"].totals for exposure in (whole, second))
    np.testing.assert_allclose(of_second["vertical"], of_whole["vertical"])


def test_reset_drops_the_run_before_the_restart_too() -> None:
    _, second = split(40 * 140, 48 * 140)
    second.reset()
    assert second.pipeline.losses(SEAT).missing_s == 0.0
    assert second.pipeline.exposure().sensors[SEAT].seconds == 0.0
    third = continued(second)
    third.reset()
    assert third.pipeline.exposure().sensors == {} and third.checkpoint(IDENTITY) is None


def test_silence_before_the_restart_is_missing_once() -> None:
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    silent = [cut for cut in cuts if cut[1] < 40 * 140 and not (cut[0] == "neck" and cut[1] >= 20 * 140)]
    back = [cut for cut in cuts if cut[1] >= 44 * 140]
    second = ride(streams, back, continued(ride(streams, silent))).pipeline
    assert second.losses("neck").missing_s == pytest.approx(24 * 140 / RATE_HZ, abs=0.02)
    assert second.losses(SEAT).missing_s == pytest.approx(4 * 140 / RATE_HZ, abs=0.02)


def test_the_time_until_a_later_return_is_missing_once() -> None:
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    second = continued(ride(streams, [cut for cut in cuts if cut[1] < 30 * 140]))
    after = [cut for cut in cuts if cut[1] >= (48 if cut[0] == "neck" else 34) * 140]
    missing_s = ride(streams, after, second).pipeline.losses("neck").missing_s
    assert missing_s == pytest.approx(18 * 140 / RATE_HZ, abs=0.02)


@pytest.mark.parametrize("rate_hz", [500.0, 1129.3])
def test_a_sensor_that_returns_at_another_rate_needs_a_new_rest(rate_hz: float) -> None:
    """The README: a sensor that changes its rate needs a restart."""
    at_s = np.arange(round(2.0 * rate_hz)) / rate_hz
    stamps_ns = noisy_streams()[0].stamps_ns[-1] + 10**9 + np.rint(1e9 * at_s).astype(np.int64)
    accel = np.tile([0.0, 0.0, 9.8], (at_s.size, 1)) + 1e-3 * np.sin(at_s)[:, None]
    second = continued(counted())
    for at in range(0, at_s.size, 7):
        second.push(SEAT, stamps_ns[at : at + 7], accel[at : at + 7])
    status = second.pipeline.status(SEAT)
    assert status.rate_hz == pytest.approx(rate_hz, rel=1e-3) and status.late == status.filled == 0
    assert (status.uncounted_s > 0.5) == (rate_hz == 500.0)


def test_the_first_samples_of_a_sensor_are_counted_at_the_end_when_they_are_too_few() -> None:
    streams = noisy_streams(8.0)
    second = continued(ride(streams, [(s.sensor, 0, 4000) for s in streams]))
    seconds = second.pipeline.exposure().sensors[SEAT].seconds
    second.push(SEAT, streams[0].stamps_ns[4100:4140], streams[0].accel_mps2[4100:4140])
    assert second.pipeline.exposure().sensors[SEAT].seconds == seconds
    second.finish()
    assert second.pipeline.exposure().sensors[SEAT].seconds == pytest.approx(seconds + 40 / RATE_HZ, rel=1e-6)


@pytest.mark.parametrize("lean", [(0.02, 0.0), (0.0, 0.02), (0.02, 0.02)])
def test_horizontal_doses_of_two_runs_add_up_along_the_sensor_s_own_axes(lean: tuple[float, float]) -> None:
    """Upside down, and parked on another slope: the smallest rotation upright turns the plane by up to half a turn."""
    at_s = np.arange(round(20.0 * RATE_HZ)) / RATE_HZ
    moving = np.where(at_s > 2.0, 2.0 * np.sin(2.0 * np.pi * 1.5 * at_s), 0.0)

    def push(exposure: ContinuedExposure, up: np.ndarray, start_s: float) -> None:
        accel = 9.81 * up / np.linalg.norm(up) + np.outer(moving, [1.0, 0.0, 0.0])
        stamps_ns = np.rint(1e9 * (start_s + at_s)).astype(np.int64)
        for at in range(0, at_s.size, 200):
            exposure.push(SEAT, stamps_ns[at : at + 200], accel[at : at + 200])

    first = ContinuedExposure(Pipeline(subject(), settings=SETTINGS))
    push(first, np.array([0.02, 0.0, -1.0]), 1e6)
    second = continued(first, SETTINGS)
    once, before = first.pipeline.seat(), second.pipeline.seat()
    assert before.horizontal == "yaw_given"
    assert before.vdv_weighted_mps175 == pytest.approx(once.vdv_weighted_mps175, rel=1e-6)
    push(second, np.array([*lean, -1.0]), 1e6 + 3600.0)
    twice = second.pipeline.seat()
    assert once.vdv_weighted_mps175["x"] > 50.0 * once.vdv_weighted_mps175["y"]
    assert twice.vdv_weighted_mps175["x"] == pytest.approx(2.0**0.25 * once.vdv_weighted_mps175["x"], rel=2e-3)
    assert twice.aw_weighted_mps2["x"] == pytest.approx(once.aw_weighted_mps2["x"], rel=2e-3)


def test_a_restart_in_a_bend_adds_no_dose() -> None:
    at_s = np.arange(round(40.0 * RATE_HZ)) / RATE_HZ
    bend = 2.0 * np.interp(at_s, [8.0, 11.0], [0.0, 1.0])
    accel = np.column_stack([bend, 0.0 * at_s, 9.81 + 0.3 * np.sin(2.0 * np.pi * 5.0 * at_s) * (at_s > 2.0)])
    accel += 0.01 * np.random.default_rng(2).standard_normal(accel.shape)
    stamps_ns = np.rint(1e9 * (1e6 + at_s)).astype(np.int64)

    def push(exposure: ContinuedExposure, begin_s: float, end_s: float) -> ContinuedExposure:
        for at in range(round(begin_s * RATE_HZ), round(end_s * RATE_HZ), 200):
            exposure.push(SEAT, stamps_ns[at : at + 200], accel[at : at + 200])
        return exposure

    whole = push(ContinuedExposure(Pipeline(subject(), settings=SETTINGS)), 0.0, 40.0).pipeline.seat()
    first = push(ContinuedExposure(Pipeline(subject(), settings=SETTINGS)), 0.0, 20.0)
    second = push(continued(first, SETTINGS), 20.5, 40.0).pipeline.seat()
    assert second.vdv_weighted_mps175["x"] == pytest.approx(whole.vdv_weighted_mps175["x"], rel=0.01)
    assert whole.vdv_weighted_mps175["x"] < 0.2  # 0.85 if the filters start from zero


def test_a_sensor_that_has_not_returned_has_no_rolling_figures() -> None:
    second = split(40 * 140, 48 * 140, ("neck",))[1].pipeline
    rolling = second.exposure(rolling=True)
    assert "neck" not in rolling.sensors and "neck" not in rolling.further["Wb"] and "neck" in second.exposure().sensors
    assert set(rolling.sensors) == set(SENSORS) - {"neck"}


def test_without_counted_samples_there_is_no_checkpoint() -> None:
    assert ContinuedExposure(Pipeline(subject())).checkpoint(IDENTITY) is None


def test_the_differences_of_two_identities_are_named() -> None:
    checkpoint = counted().checkpoint(IDENTITY)
    assert checkpoint.differences(IDENTITY) == ""
    assert checkpoint.differences({"subject": "a", "sensors": "c"}) == "sensors"
    assert digest({"x": 1, "y": [1.5]}) == digest({"y": [1.5], "x": 1}) != digest({"x": 1, "y": [1.6]})


def invalid() -> dict:
    """Documents that `to_dict` never writes."""
    good = counted().checkpoint(IDENTITY).to_dict()

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
        "a stamp below zero": with_(*seat, "newest_ns", value=-1),
        "covered before its newest sample": with_(*seat, "told_ns", value=1),
        "a negative time": with_("elapsed_s", value=-1.0),
        "a period of zero": with_(*seat, "rest", value=good["sensors"]["seat"]["rest"] | {"period_s": 0.0}),
        "a rest of another kind": with_(*seat, "rest", value={"x": 1}),
    }


@pytest.mark.parametrize("name", invalid())
def test_an_invalid_checkpoint_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match="not a stored exposure") as caught:
        ExposureCheckpoint.from_dict(invalid()[name])
    assert "\n" not in str(caught.value)


def test_totals_of_another_meter_are_refused() -> None:
    document = counted().checkpoint(IDENTITY).to_dict()
    document["sensors"]["seat"]["meters"]["plane"] = [[1.0, 2.0]]
    with pytest.raises(InputError, match=r"plane: the stored totals have shape \(1, 2\), \(1, 9\) is needed"):
        ContinuedExposure(Pipeline(subject())).resume(ExposureCheckpoint.from_dict(document))


def test_sums_of_powers_below_zero_are_refused_at_once() -> None:
    document = counted().checkpoint(IDENTITY).to_dict()
    assert min(document["sensors"]["seat"]["meters"]["plane"][0]) < 0.0  # a mixed moment may be
    ContinuedExposure(Pipeline(subject())).resume(ExposureCheckpoint.from_dict(document))
    document["sensors"]["head"]["meters"]["vertical"][0][0] *= -1.0
    with pytest.raises(InputError, match="vertical: a stored sum of powers is below zero"):
        ContinuedExposure(Pipeline(subject())).resume(ExposureCheckpoint.from_dict(document))


def test_a_checkpoint_without_the_seat_continues_the_other_sensors() -> None:
    """A sensor that has not rested yet is in no checkpoint."""
    streams = noisy_streams(8.0)
    first = ride(streams, [("head", 0, 3000), (SEAT, 0, 100)])
    checkpoint = first.checkpoint(IDENTITY)
    assert checkpoint is not None and set(checkpoint.sensors) == {"head"}
    second = ride(streams, [("head", 3100, 6000)], continued(first))
    once, twice = (one.pipeline.exposure().sensors["head"] for one in (first, second))
    assert twice.seconds == pytest.approx(once.seconds + 2900 / RATE_HZ, abs=0.01)
    assert second.pipeline.losses("head").missing_s == pytest.approx(100 / RATE_HZ, abs=0.01)
    assert SEAT not in second.pipeline.exposure().sensors


@pytest.mark.parametrize("gap", [0, 6])
@pytest.mark.parametrize("absent", [SEAT, "head"])
def test_a_sensor_that_the_run_before_lacked_has_missed_it_and_the_break(absent: str, gap: int) -> None:
    """In blocks of 140: one sensor counts 30 alone, a break follows, and the absent one joins 2 after it."""
    at_rest = np.tile([0.0, 0.0, 9.81], (len(noisy_streams(8.0)[0].stamps_ns), 1))
    at_rest += 0.01 * np.random.default_rng(3).standard_normal(at_rest.shape)
    streams = tuple(
        dataclasses.replace(one, accel_mps2=at_rest) if one.sensor == absent else one for one in noisy_streams(8.0)
    )
    cuts = [cut for cut in in_turn(streams, 140) if cut[0] in ("pelvis", absent)]
    before = [cut for cut in cuts if cut[0] == "pelvis" and cut[1] < 30 * 140]
    after = [cut for cut in cuts if cut[1] >= (30 + gap + 2 * (cut[0] == absent)) * 140]
    whole, second = ride(streams, before + after).pipeline, ride(streams, after, continued(ride(streams, before)))
    lost = second.pipeline.losses(absent)
    assert lost.lower_bound and lost.absent_s == pytest.approx((32 + gap) * 140 / RATE_HZ, abs=0.03)
    assert lost.absent_s == pytest.approx(whole.losses(absent).absent_s, abs=0.03)
    assert second.pipeline.losses("pelvis").absent_s == pytest.approx(gap * 140 / RATE_HZ, abs=0.01)
    checkpoint = as_text(second)
    assert checkpoint.elapsed_s == pytest.approx(len(at_rest) / RATE_HZ, abs=0.15)
    assert ride(streams, [], continued(second)).checkpoint(IDENTITY).elapsed_s == checkpoint.elapsed_s
    second.reset()
    assert second.pipeline.losses(absent).absent_s == second.pipeline.counter.elapsed_s() == 0.0


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("began_s", [12.3 - 1_767_225_600.0, 1.0, 3600.0])
def test_a_break_in_which_a_clock_was_set_back_is_missing(began_s: float, order: int) -> None:
    """An hour passes; the pelvis counts its seconds from its start, or its clock was set back in the break."""
    at_s = np.arange(3000) / 1000.0
    accel_mps2 = np.tile([0.0, 0.0, 9.81], (3000, 1)) + 0.01 * np.random.default_rng(3).standard_normal((3000, 3))

    def push(exposure: ContinuedExposure, start_s: dict[str, float]) -> None:
        for at in range(0, 3000, 100):
            for name in list(start_s)[::order]:
                stamps_ns = np.rint(1e9 * (1_767_225_600.0 + start_s[name] + at_s)).astype(np.int64)
                exposure.push(name, stamps_ns[at : at + 100], accel_mps2[at : at + 100])

    first = ContinuedExposure(Pipeline(subject()))
    push(first, {SEAT: 0.0, "head": 0.0, "pelvis": 0.0})
    second = continued(first)
    push(second, {SEAT: 3600.0, "pelvis": began_s})
    for name in (SEAT, "pelvis", "head"):
        lost = second.pipeline.losses(name)
        gone_s = 3597.0 + 3.0 * (name == "head")
        assert lost.absent_s == pytest.approx(gone_s, abs=0.1) and lost.lower_bound, name


def test_a_weighting_that_the_checkpoint_lacks_counts_from_the_restart() -> None:
    streams, cuts = noisy_streams(8.0), in_turn(noisy_streams(8.0), 140)
    first = ride(streams, [cut for cut in cuts if cut[1] < 40 * 140])
    second = ride(streams, [cut for cut in cuts if cut[1] >= 40 * 140], continued(first, SETTINGS)).pipeline.exposure()
    before_s, both_s = first.pipeline.exposure().sensors["head"].seconds, second.sensors["head"].seconds
    assert both_s > before_s + 2.0
    assert second.further["Wb"]["head"].seconds == pytest.approx(both_s - before_s, abs=0.01)
