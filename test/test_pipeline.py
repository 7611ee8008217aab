"""The pipeline: the same frames and figures for any cut and interleaving, and correct ones with faulty sensors."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from streams import PERFECT, RATE_HZ, START_NS, Run, in_turn, independent_streams, noisy_streams, run, subject

from biodyn_core import kernels
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SENSORS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.synthesis import ImuStream, SeatMotion, imu_streams, load_case
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.exposure.meters import DoseMeter
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_core.pipeline.prediction import MAX_STRETCH_M
from biodyn_ros.node.warmup import warm_up
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import exposure_report, sensor_warnings


@cache
def uncut() -> Run:
    """The noisy streams in blocks of the default size; read-only."""
    return run(noisy_streams(), in_turn(noisy_streams()))


@st.composite
def orders(draw: st.DrawFn) -> list[tuple[str, int, int]]:
    """Random cuts of every sensor, interleaved at random within the bound of the wait (1000 samples are 0.9 s)."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    limit = draw(st.sampled_from([1, 40, 300, 500]))
    position = dict.fromkeys(SENSORS, 0)
    length = {stream.sensor: len(stream.stamps_ns) for stream in noisy_streams()}
    order = []
    while unfinished := [name for name in SENSORS if position[name] < length[name]]:
        slowest = min(position[name] for name in unfinished)
        near = [name for name in unfinished if position[name] <= slowest + 500]
        name = near[rng.integers(len(near))]
        size = int(rng.integers(1, limit + 1))
        order.append((name, position[name], position[name] + size))
        position[name] += size
    return order


@settings(max_examples=4)
@given(order=orders())
def test_any_cut_and_any_interleaving_gives_the_same_frames_and_figures(order: list[tuple[str, int, int]]) -> None:
    reference = uncut()
    other = run(noisy_streams(), order)
    for field in ("predicted_ns", "predicted", "motion", "measured_ns", "measured"):
        np.testing.assert_array_equal(getattr(other, field), getattr(reference, field), err_msg=field)
    assert other.exposure == reference.exposure
    assert other.pipeline.seat() == reference.pipeline.seat()


def test_predictions_need_the_seat_alone() -> None:
    together = uncut()
    alone = run(noisy_streams(), [cut for cut in in_turn(noisy_streams()) if cut[0] == SEAT])
    np.testing.assert_array_equal(alone.predicted, together.predicted)
    assert np.isnan(alone.measured[:, 1:]).all()
    assert not np.isnan(alone.measured[:, 0]).any()
    assert alone.exposure.residual == {}


def test_prediction_agrees_with_another_integrator_and_the_residual_is_zero() -> None:
    streams = independent_streams()
    result = run(streams, in_turn(streams))
    assert set(result.exposure.residual) == set(MEASURED_SEGMENTS)
    for name, (_, percent) in result.exposure.residual.items():
        # The prediction answers the low-passed seat, the measurement is the low-passed answer: a nonlinear chain keeps
        # a small difference between the two. The alignment and the start-up of the filters are inside it too.
        assert percent < 0.1, name


def test_doses_of_prediction_and_low_passed_measurement_agree_on_perfect_data() -> None:
    streams = independent_streams()
    exposure = run(streams, in_turn(streams)).exposure
    for name in MEASURED_SEGMENTS:
        predicted = exposure.predicted[name].vdv_mps175
        # The measurement's last few instants have no later neighbours to be read from, in the midst of the motion.
        assert exposure.measured_low_passed[name].vdv_mps175 == pytest.approx(predicted, rel=2e-3)
        # Below 10 Hz the 100 Hz low-pass takes nothing away.
        assert exposure.sensors[name].vdv_mps175 == pytest.approx(predicted, rel=2e-3)


def test_a_prediction_carries_its_input_stamp_less_the_filter_delay() -> None:
    streams = noisy_streams()
    result = run(streams, in_turn(streams))
    seat = next(stream for stream in streams if stream.sensor == SEAT)
    delay_s = result.pipeline.status(SEAT).filter_delay_s
    assert delay_s == pytest.approx(4.051e-3, abs=2e-6)
    tail = seat.stamps_ns[len(seat.stamps_ns) - len(result.predicted_ns) :]
    np.testing.assert_array_equal(result.predicted_ns, tail - round(delay_s * 1e9))


def test_a_dead_sensor_leaves_nan_and_nothing_else_changes() -> None:
    streams = noisy_streams()
    whole = run(streams, in_turn(streams))
    dead = run(streams, [cut for cut in in_turn(streams) if cut[0] != "neck" or cut[2] < 2000])
    np.testing.assert_array_equal(dead.predicted, whole.predicted)
    np.testing.assert_array_equal(dead.measured_ns, whole.measured_ns)
    others = [column for column, name in enumerate(SENSORS) if name != "neck"]
    np.testing.assert_array_equal(dead.measured[:, others], whole.measured[:, others])
    # Unrecorded time is missing although no later sample of the sensor shows the gap.
    missing_s = (len(streams[4].stamps_ns) - 1960) / 1129.3
    assert dead.pipeline.losses("neck").missing_s == pytest.approx(missing_s, abs=0.01)
    assert dead.pipeline.losses("neck").lower_bound
    assert whole.pipeline.losses("neck").missing_s == 0.0
    neck = dead.measured[:, SENSORS.index("neck")]
    assert np.isnan(neck[1500:]).all()
    assert not np.isnan(neck[10:800]).any()


def test_predictions_beyond_the_fitted_range_are_extrapolated() -> None:
    streams = noisy_streams(8.0)
    peak = float(np.nanmax(np.abs(run(streams, in_turn(streams)).measured[:, SENSORS.index(SEAT)])))
    for fitted_mps2, status in ((1.01 * peak, "not_validated"), (0.99 * peak, "extrapolated"), (None, "not_validated")):
        provenance = {} if fitted_mps2 is None else {"seat_peak_mps2": fitted_mps2}
        pipeline = Pipeline(dataclasses.replace(subject(), provenance=provenance))
        run(streams, in_turn(streams), pipeline=pipeline)
        predicted = exposure_document(exposure_report(pipeline))["predicted"]
        assert {each["status"] for each in predicted.values()} == {status}
        pipeline.reset()
        assert not pipeline.run_status().is_extrapolating


def test_comparison_waits_for_a_late_sensor_up_to_a_bound() -> None:
    streams = noisy_streams()
    cuts = in_turn(streams, 100)
    head = [cut for cut in cuts if cut[0] == "head"]

    def delayed(blocks: int) -> list[tuple[str, int, int]]:
        order, late = [], list(head)
        for number, cut in enumerate(cut for cut in cuts if cut[0] != "head"):
            order.append(cut)
            if number % 5 == 4 and number // 5 >= blocks:
                order.append(late.pop(0))
        return order + late

    whole = run(streams, cuts)
    within = run(streams, delayed(6))
    np.testing.assert_array_equal(within.measured, whole.measured)
    beyond = run(streams, delayed(20))
    assert np.isnan(beyond.measured[:, SENSORS.index("head")]).any()
    np.testing.assert_array_equal(beyond.predicted, whole.predicted)


@pytest.mark.parametrize("backlog", [SENSORS[1:], SENSORS[:0:-1]])
def test_only_the_seat_s_samples_give_up_instants(backlog: tuple[str, ...]) -> None:
    streams = noisy_streams()
    by_name = {stream.sensor: stream for stream in streams}
    pipeline, first, measured = Pipeline(subject()), 2000, []

    def push(name: str, begin: int, end: int) -> None:
        pushed = pipeline.push(name, by_name[name].stamps_ns[begin:end], by_name[name].accel_mps2[begin:end])
        measured.append(pushed.measured)

    for name in SENSORS:
        push(name, 0, first)
    at = first
    while not pipeline.overdue:
        push(SEAT, at, at + 1)
        at += 1
    assert at - first == pytest.approx(1.1 * RATE_HZ, rel=0.02)
    for name in backlog:
        push(name, first, at)
    push(SEAT, at, at + 1)
    assert not pipeline.overdue
    rows = np.concatenate([one.accel_mps2 for one in measured])
    assert not np.isnan(rows[20:]).any()
    assert len(rows) > at - 1000  # all but rest and look-ahead


def test_a_gap_of_the_seat_restarts_the_model_and_is_missing() -> None:
    streams = noisy_streams()
    cuts = [cut for cut in in_turn(streams, 100) if cut[0] != SEAT or not 2000 <= cut[1] < 2300]
    result = run(streams, cuts)
    gap = np.flatnonzero(np.diff(result.predicted_ns) > 10_000_000)
    assert len(gap) == 1
    # The chain starts from rest behind the gap: its first answer is no acceleration at all.
    np.testing.assert_array_equal(result.predicted[gap[0] + 1], np.zeros(6))
    assert result.pipeline.losses(SEAT).missing_s == pytest.approx(300 / 1129.3, abs=2e-3)
    assert result.pipeline.losses(SEAT).lower_bound
    assert result.pipeline.seat().time_to_action_value_s is None


def not_finite(stream: ImuStream, at: int) -> ImuStream:
    """A stream whose readings are no numbers from a sample on."""
    accel = stream.accel_mps2.copy()
    accel[at:] = np.nan
    return dataclasses.replace(stream, accel_mps2=accel)


def unset(stream: ImuStream, at: int) -> ImuStream:
    """A stream whose stamps are never set from a sample on."""
    stamps_ns = stream.stamps_ns.copy()
    stamps_ns[at:] = 0
    return dataclasses.replace(stream, stamps_ns=stamps_ns)


def frozen(stream: ImuStream, at: int) -> ImuStream:
    """A stream whose stamps stand still from a sample on."""
    stamps_ns = stream.stamps_ns.copy()
    stamps_ns[at:] = stamps_ns[at]
    return dataclasses.replace(stream, stamps_ns=stamps_ns)


@pytest.mark.parametrize("spoil", [not_finite, unset, frozen])
@pytest.mark.parametrize("sensors", [(SEAT,), SENSORS])
def test_a_seat_that_sends_only_unusable_samples_has_no_assessment(sensors: tuple[str, ...], spoil) -> None:
    good = [stream for stream in noisy_streams(6.0, "road", 3) if stream.sensor in sensors]
    usable = run(good, in_turn(good)).pipeline.seat()
    assert usable.zone == "below_action_value" and usable.time_to_action_value_s is not None
    bad = [spoil(stream, 4000) for stream in good]
    pipeline = run(bad, in_turn(bad)).pipeline
    lost_s = (len(good[0].stamps_ns) - 4000) / RATE_HZ
    for name in sensors:
        assert pipeline.losses(name).missing_s == pytest.approx(lost_s, abs=0.02)
    seat = pipeline.seat()
    assert seat.zone == "undecided" and "samples are unusable" in seat.zone_reason
    assert seat.lower_bound and seat.time_to_action_value_s is None and "unusable" in seat.withheld


def test_a_return_from_unusable_samples_counts_their_time_once() -> None:
    (seat,) = (stream for stream in noisy_streams(6.0, "road", 3) if stream.sensor == SEAT)
    accel = seat.accel_mps2.copy()
    accel[3000:5000] = np.nan
    pipeline = Pipeline(subject())
    lost_s = []
    for part in np.split(np.arange(len(accel)), [3000, 3020, 4000, 4500]):
        pipeline.push(SEAT, seat.stamps_ns[part], accel[part])
        lost_s.append(pipeline.losses(SEAT).missing_s)
    assert lost_s[:2] == [0.0, 0.0]  # too short for a gap
    assert lost_s[2:] == pytest.approx([1000 / RATE_HZ, 1500 / RATE_HZ, 2000 / RATE_HZ], abs=2e-3)


def test_a_reset_during_unusable_samples_hides_no_later_loss() -> None:
    (seat,) = (stream for stream in noisy_streams(6.0, "road", 3) if stream.sensor == SEAT)
    stamps_ns = seat.stamps_ns.copy()
    stamps_ns[3500:] -= stamps_ns[3500] - stamps_ns[3000]  # the clock stands still for 500 samples, and goes on
    stamps_ns[3000:3500] = stamps_ns[2999]
    pipeline = Pipeline(subject())
    pipeline.push(SEAT, stamps_ns[:3500], seat.accel_mps2[:3500])
    assert pipeline.losses(SEAT).missing_s == pytest.approx(500 / RATE_HZ, abs=2e-3)
    pipeline.reset()
    for part in (slice(3500, 4500), slice(4800, None)):
        pipeline.push(SEAT, stamps_ns[part], seat.accel_mps2[part])
    assert pipeline.losses(SEAT).missing_s == pytest.approx(300 / RATE_HZ, abs=2e-3)


def test_a_looping_bag_continues_counting_and_restarts_the_model() -> None:
    streams = noisy_streams()
    once = run(streams, in_turn(streams), finish=False)
    twice = run(streams, in_turn(streams) * 2)
    assert len(twice.predicted_ns) > 1.9 * len(once.predicted_ns)
    assert twice.exposure.sensors[SEAT].seconds > 1.9 * once.exposure.sensors[SEAT].seconds
    # Twice the same exposure: VDV grows by the fourth root of two, less the first second, which counts the second time.
    ratio = twice.exposure.sensors[SEAT].vdv_mps175 / once.exposure.sensors[SEAT].vdv_mps175
    assert ratio == pytest.approx(2**0.25, rel=2e-3)
    later = twice.measured[-2000:]
    assert np.isnan(later).mean() < 0.05


def test_reset_sets_sums_to_zero_and_keeps_filters_and_window() -> None:
    streams = noisy_streams()
    cuts = in_turn(streams)
    half = len(cuts) // 2
    by_name = {stream.sensor: stream for stream in streams}
    pipeline = Pipeline(subject(), settings=PipelineSettings(window_s=60.0))
    for number, (name, a, b) in enumerate(cuts):
        if number == half:
            before = pipeline.exposure().sensors[SEAT]
            pipeline.reset()
            assert pipeline.exposure().sensors[SEAT].vdv_mps175 == 0.0
        pipeline.push(name, by_name[name].stamps_ns[a:b], by_name[name].accel_mps2[a:b])
    after = pipeline.exposure().sensors[SEAT]
    whole = run(streams, cuts).exposure.sensors[SEAT]
    assert before.vdv_mps175**4 + after.vdv_mps175**4 == pytest.approx(whole.vdv_mps175**4, rel=1e-9)
    assert pipeline.exposure(rolling=True).sensors[SEAT].vdv_mps175 == pytest.approx(whole.vdv_mps175, rel=1e-9)


def test_reset_sets_the_prediction_s_figures_to_zero() -> None:
    streams = noisy_streams()
    by_name = {stream.sensor: stream for stream in streams}
    pipeline = Pipeline(subject())
    for name, a, b in in_turn(streams, 50)[: 6 * 70]:  # no multiple of the meters' batch
        pipeline.push(name, by_name[name].stamps_ns[a:b], by_name[name].accel_mps2[a:b])
    pipeline.reset()
    exposure = pipeline.exposure()
    assert not exposure.predicted and not exposure.measured_low_passed
    assert {dose.seconds for dose in exposure.sensors.values()} == {0.0}


@pytest.mark.parametrize("silent", [(), ("head",)], ids=["complete", "head-silent"])
def test_no_figure_after_a_reset_contains_a_shock_before_it(silent: tuple[str, ...]) -> None:
    """With a silent sensor the shock still waits for it at the reset; the window keeps the shock."""
    quiet, shaken = noisy_streams(8.0, "road", 3), []
    for stream in quiet:
        accel, since_s = stream.accel_mps2.copy(), (stream.stamps_ns - START_NS) * 1e-9
        accel[(since_s > 4.0) & (since_s < 4.1)] += 40.0
        shaken.append(dataclasses.replace(stream, accel_mps2=accel))

    def after_reset(streams: list[ImuStream]) -> Pipeline:
        by_name, pipeline = {stream.sensor: stream for stream in streams}, Pipeline(subject())
        for name, a, b in in_turn(streams, 100):
            if (name, a) == (SEAT, 5100):  # 4.5 s
                pipeline.reset()
            if name not in silent:
                pipeline.push(name, by_name[name].stamps_ns[a:b], by_name[name].accel_mps2[a:b])
        return pipeline

    found, expected = after_reset(shaken).exposure(), after_reset(list(quiet)).exposure()
    for kind in ("measured_low_passed", "compared"):
        assert getattr(found, kind).keys() == getattr(expected, kind).keys() != set()
    for name, dose in found.measured_low_passed.items():
        assert dose.vdv_mps175 < 1.5 * expected.measured_low_passed[name].vdv_mps175, name
        assert dose.seconds == pytest.approx(expected.measured_low_passed[name].seconds, abs=1e-9)
    for name, (rms_mps2, _) in found.residual.items():
        assert rms_mps2 < 0.5, name  # the model still swings a little
    rolling = after_reset(shaken).exposure(rolling=True).measured_low_passed[SEAT]
    assert rolling.vdv_mps175 > 3.0 * found.measured_low_passed[SEAT].vdv_mps175


def test_reset_sets_losses_to_zero() -> None:
    streams = noisy_streams()
    by_name = {stream.sensor: stream for stream in streams}
    seat = by_name[SEAT].accel_mps2.copy()
    seat[1900] = 160.0
    cuts = [cut for cut in in_turn(streams, 100) if cut[0] != SEAT or not 2000 <= cut[1] < 2300]
    pipeline = Pipeline(subject())
    for name, a, b in cuts:
        if (name, a) == (SEAT, 2800):
            assert pipeline.losses(SEAT).lower_bound and pipeline.losses(SEAT).clipped == 1
            assert pipeline.losses(SEAT).missing_s == pytest.approx(300 / 1129.3, abs=2e-3)
            pipeline.reset()
        accel = seat if name == SEAT else by_name[name].accel_mps2
        pipeline.push(name, by_name[name].stamps_ns[a:b], accel[a:b])
    assert not pipeline.losses(SEAT).lower_bound
    assert (pipeline.losses(SEAT).clipped, pipeline.losses(SEAT).missing_s) == (0, 0.0)
    assert pipeline.status(SEAT).clipped == 1  # the diagnostics go on counting


@pytest.mark.parametrize("ppm", [-30.0, 30.0])
def test_reset_drops_interpolated_samples_for_any_drift(ppm: float) -> None:
    streams = noisy_streams(8.0)
    jitter = np.random.default_rng(2).normal(0.0, 3e4, streams[0].stamps_ns.size).astype(np.int64)
    seat = streams[0]
    drifted = START_NS + np.rint((seat.stamps_ns - START_NS) * (1.0 + 1e-6 * ppm)).astype(np.int64) + jitter
    left = ~np.isin(np.arange(seat.stamps_ns.size), np.arange(3000, 3020))
    pipeline = Pipeline(subject())
    pipeline.push(SEAT, drifted[left][:5000], seat.accel_mps2[left][:5000])
    assert pipeline.status(SEAT).filled == 20 and pipeline.losses(SEAT).lower_bound
    pipeline.reset()
    pipeline.push(SEAT, drifted[left][5000:], seat.accel_mps2[left][5000:])
    assert pipeline.status(SEAT).filled == 20 and not pipeline.losses(SEAT).lower_bound


def test_the_time_before_a_late_sensor_is_missing() -> None:
    streams = noisy_streams()
    cuts = [cut for cut in in_turn(streams, 100) if cut[0] != SEAT or cut[1] >= 1400]
    pipeline = run(streams, cuts).pipeline
    # It began after the others and in motion: the time until its rest is missing too.
    moving_s = pipeline.status(SEAT).unrested_s
    assert moving_s > 0.5 and pipeline.status("head").unrested_s == 0.0
    assert pipeline.losses(SEAT).missing_s == pytest.approx(1400 / 1129.3 + moving_s, abs=0.01)
    assert pipeline.losses(SEAT).lower_bound
    assert pipeline.losses("head").missing_s == 0.0
    assert pipeline.run_status().seconds == pytest.approx(len(streams[1].stamps_ns) / 1129.3, abs=2e-3)


def test_a_stray_stamp_does_not_lengthen_the_record() -> None:
    streams = list(noisy_streams())
    stamps = streams[0].stamps_ns.copy()
    stamps[2500] += 3600 * 10**9
    streams[0] = dataclasses.replace(streams[0], stamps_ns=stamps)
    result = run(tuple(streams), in_turn(tuple(streams)))
    assert result.pipeline.run_status().seconds == pytest.approx(len(stamps) / 1129.3, abs=2e-3)
    assert result.pipeline.status(SEAT).stray == 1
    assert result.pipeline.losses(SEAT).missing_s == pytest.approx(1 / 1129.3, rel=1e-3)  # one sample, interpolated


def test_zero_phase_is_the_paper_s_filter_without_delay_for_any_cut() -> None:
    streams = independent_streams()
    whole = run(streams, in_turn(streams), pipeline=Pipeline(subject(), mode="zero_phase"))
    sample = run(streams, in_turn(streams, 77), pipeline=Pipeline(subject(), mode="zero_phase"))
    np.testing.assert_array_equal(whole.predicted, sample.predicted)
    np.testing.assert_array_equal(whole.measured, sample.measured)
    assert set(whole.predicted_ns) <= set(streams[0].stamps_ns)  # no delay on the stamps
    seat = streams[0].accel_mps2[:, 2] - streams[0].accel_mps2[0, 2]
    first = len(seat) - len(whole.measured)
    sos = signal.butter(4, 100.0, fs=1129.3, output="sos")
    wanted = signal.sosfiltfilt(sos, seat[first:])
    np.testing.assert_allclose(whole.measured[:, 0], wanted, atol=1e-6)
    # Perfect sensors on the same model, integrated by another method: only what the filter takes away remains.
    assert all(percent < 0.05 for _, percent in whole.exposure.residual.values())


def in_turn_but(streams: tuple[ImuStream, ...], sensor: str, first: int, end: int) -> list[tuple[str, int, int]]:
    """In turn, without these samples of a sensor."""
    return [cut for cut in in_turn(streams, 100) if cut[0] != sensor or not first <= cut[1] < end]


@pytest.mark.parametrize("broken", [SEAT, "head"])
def test_zero_phase_compares_samples_before_a_gap_too(broken: str) -> None:
    streams = noisy_streams(8.0)
    cuts = in_turn_but(streams, broken, 5500, 5900)
    found = run(streams, cuts, pipeline=Pipeline(subject(), mode="zero_phase"))
    head = found.measured[:, SENSORS.index("head")]
    seconds = 1e-9 * (found.measured_ns - found.measured_ns[0])
    early = (seconds > 0.1) & (seconds < 3.5)
    assert early.sum() > 3000 and np.isfinite(head[early]).all()
    assert found.exposure.measured_low_passed["head"].seconds > 7.0


def test_a_comparison_s_dose_is_a_lower_bound_where_the_seat_or_its_clock_fails() -> None:
    def bounds(streams: tuple[ImuStream, ...], cuts: list[tuple[str, int, int]]) -> list[dict]:
        found = exposure_document(exposure_report(run(streams, cuts).pipeline))
        return [found[kind]["head"] for kind in ("sensors", "measured_low_passed")]

    streams = noisy_streams(8.0)
    own, compared = bounds(streams, in_turn(streams))
    assert not own["lower_bound"] and not compared["lower_bound"]
    own, compared = bounds(streams, in_turn_but(streams, SEAT, 5000, 6000))
    assert not own["lower_bound"] and compared["lower_bound"]
    assert compared["missing_s"] == pytest.approx(1000 / RATE_HZ, abs=0.02)
    apart = tuple(
        dataclasses.replace(one, stamps_ns=one.stamps_ns + 3600 * 10**9) if one.sensor == "head" else one
        for one in streams
    )
    found = exposure_document(exposure_report(run(apart, in_turn(apart)).pipeline))
    assert "head" in found["sensors"] and set(found["measured_low_passed"]) == {"seat", *MEASURED_SEGMENTS} - {"head"}


def test_the_low_passed_dose_of_the_seat_does_not_ring_across_its_gap() -> None:
    streams = noisy_streams()
    cuts = [cut for cut in in_turn(streams, 100) if cut[0] != SEAT or not 2000 <= cut[1] < 2300]
    before = run(streams, [cut for cut in cuts if cut[1] < 2000])
    after_ns = streams[0].stamps_ns[2300]
    whole = run(streams, cuts)
    answered = whole.measured_ns >= after_ns - 4_100_000
    fresh = DoseMeter("Wk", 1129.3, 1, 10.0)
    fresh.push(np.ascontiguousarray(whole.measured[answered, :1]))
    parts = before.exposure.measured_low_passed[SEAT].vdv_mps175 ** 4 + fresh.since_reset()[0].vdv_mps175 ** 4
    assert whole.exposure.measured_low_passed[SEAT].vdv_mps175 ** 4 == pytest.approx(parts, rel=0.02)


def test_further_weightings_are_counted_on_request() -> None:
    streams = noisy_streams()
    pipeline = Pipeline(subject(), settings=PipelineSettings(also_weighted="Wj, Wk Wb"))
    exposure = run(streams, in_turn(streams), pipeline=pipeline).exposure
    assert list(exposure.further) == ["Wk", "Wb", "Wj"] or set(exposure.further) == {"Wk", "Wb", "Wj"}
    assert exposure.further["Wk"] == exposure.sensors
    assert exposure.further["Wj"][SEAT].vdv_mps175 > exposure.further["Wk"][SEAT].vdv_mps175  # Wj is 1 where Wk falls
    assert run(streams, in_turn(streams)).exposure.further == {}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"also_weighted": "Wk Wx"}, "also_weighted 'Wx' is no weighting, known are Wk, Wd"),
        ({"vertical": "seat=0,0"}, "vertical 'seat=0,0': expected sensor=x,y,z with a sensor of seat, pelvis"),
        ({"vertical": "knee=0,0,1"}, "vertical 'knee=0,0,1': expected sensor=x,y,z"),
        ({"vertical": "seat=0,0,0"}, "vertical 'seat=0,0,0': expected sensor=x,y,z"),
        ({"vertical": "seat=0,nan,1"}, "vertical 'seat=0,nan,1': expected sensor=x,y,z"),
        ({"vertical": "seat=0,inf,1"}, "vertical 'seat=0,inf,1': expected sensor=x,y,z"),
    ],
)
def test_settings_that_are_lists_are_checked_item_by_item(given: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        PipelineSettings(**given)


def test_a_given_vertical_works_without_gravity() -> None:
    streams = noisy_streams()
    plain = run(streams, in_turn(streams)).exposure
    up = streams[0].accel_mps2[:900].mean(axis=0)
    bare = [dataclasses.replace(s, accel_mps2=s.accel_mps2 - up) if s.sensor == SEAT else s for s in streams]
    refused = run(tuple(bare), in_turn(streams)).pipeline
    assert "without gravity the vertical is unknown" in refused.status(SEAT).fault
    words = "seat=" + ",".join(repr(float(v)) for v in up)
    given = run(tuple(bare), in_turn(streams), pipeline=Pipeline(subject(), settings=PipelineSettings(vertical=words)))
    assert given.pipeline.status(SEAT).gravity_mps2 == pytest.approx(0.0, abs=0.01)
    wanted, found = plain.sensors[SEAT], given.exposure.sensors[SEAT]
    assert found.vdv_mps175 == pytest.approx(wanted.vdv_mps175, rel=1e-3)


def test_the_latency_of_every_output_is_stated() -> None:
    streams = noisy_streams()
    assert Pipeline(subject()).run_status().latency == {}
    latency = run(streams, in_turn(streams)).pipeline.run_status().latency
    assert latency["predicted"] == pytest.approx((4.05e-3, 0.0, 0.0), abs=1e-5)
    assert latency["residual"] == latency["measured"] == pytest.approx((4.05e-3, 4 / 1129.3, 1.0), abs=1e-5)
    assert latency["exposure"] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "up",
    [(0.0, 0.0, 1.0), (0.5, -0.5, 0.7), (-0.6, -0.6, 0.5), (0.3, 0.2, -0.9), (0.1, 0.9, -0.3), (0.95, 0.0, 0.31)],
)
@pytest.mark.parametrize("turned_deg", [0.0, 70.0, -150.0])
def test_a_yaw_is_of_the_sensor_s_first_axis_for_any_tilt(up, turned_deg) -> None:
    # From scratch: three unit vectors of the sensor in the vehicle's axes, some way to see up so, turned about it.
    z = np.array(up) / np.linalg.norm(up)
    x = np.cross([0.0, 1.0, 0.0], z)
    axes = np.column_stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z])  # the vehicle's, by sensor's
    turn = np.radians(turned_deg)
    mount = axes @ np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    first = mount[0]  # the sensor's first axis in the vehicle's
    pipeline = Pipeline(subject(), settings=PipelineSettings(yaw_deg=float(np.degrees(np.arctan2(first[1], first[0])))))
    time = np.arange(round(8.0 * RATE_HZ)) / RATE_HZ
    shake = np.clip(time - 2.0, 0.0, 1.0)
    vehicle = np.column_stack(
        [
            1.5 * shake * np.sin(2.0 * np.pi * 2.0 * time),
            0.5 * shake * np.sin(2.0 * np.pi * 3.1 * time),
            STANDARD_GRAVITY_MPS2 + 0.2 * shake * np.sin(2.0 * np.pi * 5.0 * time),
        ]
    )
    pipeline.push(SEAT, START_NS + np.rint(1e9 * time).astype(np.int64), vehicle @ mount.T)
    pipeline.finish()
    flat = Pipeline(subject(), settings=PipelineSettings(yaw_deg=0.0))
    flat.push(SEAT, START_NS + np.rint(1e9 * time).astype(np.int64), vehicle)
    flat.finish()
    found, wanted = pipeline.seat(), flat.seat()
    assert found is not None and wanted is not None and found.horizontal == "yaw_given"
    assert found.aw_weighted_mps2 == pytest.approx(wanted.aw_weighted_mps2, rel=1e-6)
    assert found.aw_weighted_mps2["x"] > 2.0 * found.aw_weighted_mps2["y"]


@pytest.mark.parametrize("axis", range(3))
def test_a_tilted_seat_with_one_dead_axis_is_never_below_a_value(axis: int) -> None:
    """Levelling mixes the axes, so that no figure is zero; they are only too low."""
    time = np.arange(round(8.0 * RATE_HZ)) / RATE_HZ
    shake = np.clip(time - 2.0, 0.0, 1.0)[:, None]
    vehicle = [0.0, 0.0, STANDARD_GRAVITY_MPS2] + shake * np.sin(2.0 * np.pi * time[:, None] * [4.0, 5.0, 6.0])
    lean = np.radians(4.0)
    mount = np.array([[np.cos(lean), 0.0, -np.sin(lean)], [0.0, 1.0, 0.0], [np.sin(lean), 0.0, np.cos(lean)]])
    samples = vehicle @ mount.T
    whole, spoilt = Pipeline(subject()), Pipeline(subject())
    stamps = START_NS + np.rint(1e9 * time).astype(np.int64)
    whole.push(SEAT, stamps, samples)
    samples[:, axis] = samples[0, axis] + 0.02
    spoilt.push(SEAT, stamps, samples)
    right, seat = whole.seat(), spoilt.seat()
    assert right is not None and right.zone == "below_action_value" and not right.lower_bound
    assert seat is not None and seat.zone == "undecided" and seat.lower_bound


def test_without_a_seat_memory_is_bounded() -> None:
    stamps = START_NS + np.rint(np.arange(60_000) * (1e9 / 1129.3)).astype(np.int64)
    samples = np.random.default_rng(1).normal((0.0, 0.0, 9.81), 0.01, (60_000, 3))
    pipeline = Pipeline(subject())
    for at in range(0, 60_000, 500):
        pipeline.push("head", stamps[at : at + 500], samples[at : at + 500])
    assert sum(block.time_s.size for block in pipeline._early.blocks["head"]) < 3 * 1129


class _Fragile(Stepper):
    """A chain that leaves the finite numbers at a few samples of its own choosing, and stays there until reset."""

    broken = False

    def reset(self) -> None:
        super().reset()
        self.broken = False

    def push(self, seat_mps2: np.ndarray, motion: np.ndarray | None = None) -> np.ndarray:
        accel = super().push(seat_mps2, motion)
        bad = np.flatnonzero(np.round(seat_mps2 * 1e4).astype(int) % 997 == 0)
        if self.broken or bad.size:
            accel[0 if self.broken else bad[0] :] = np.nan
            self.broken = True
        return accel


def test_a_diverging_model_predicts_nan_and_restarts_for_any_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("biodyn_core.pipeline.prediction.Stepper", _Fragile)
    runs = [run(noisy_streams(), in_turn(noisy_streams(), size)) for size in (37, 280)]
    assert runs[0].pipeline.run_status().divergences >= 2
    assert 2 <= np.isnan(runs[0].predicted).all(axis=1).sum() == runs[0].pipeline.run_status().divergences
    for other in runs[1:]:
        assert other.pipeline.run_status().divergences == runs[0].pipeline.run_status().divergences
        np.testing.assert_array_equal(other.predicted, runs[0].predicted)
        assert other.exposure == runs[0].exposure
    alone = run(noisy_streams(), [cut for cut in in_turn(noisy_streams(), 1) if cut[0] == SEAT])
    np.testing.assert_array_equal(alone.predicted, runs[0].predicted)


@cache
def _whole_rail() -> Run:
    streams = _rail()
    return run(streams, in_turn(streams))


@cache
def _rail() -> tuple[ImuStream, ...]:
    rng = np.random.default_rng(4)
    return tuple(imu_streams(subject(), load_case("rail", 10.0, rng), rng, PERFECT, START_NS))


@pytest.mark.parametrize("at_s", [3.0, 4.1, 5.2, 6.3])
def test_figures_are_of_a_chain_that_has_settled_after_a_gap(at_s: float) -> None:
    """The unbroken record has the largest forces and peaks; behind a gap the chain, at rest, swings beyond them."""
    streams, whole = _rail(), _whole_rail()
    since_s = 1e-9 * (streams[0].stamps_ns - START_NS)
    there = (since_s < at_s) | (since_s > at_s + 0.06)
    seat = ImuStream(
        SEAT, *(rows[there] for rows in (streams[0].stamps_ns, streams[0].accel_mps2, streams[0].gyro_radps))
    )
    broken = (seat, *streams[1:])
    runs = [run(broken, in_turn(broken, size)) for size in (123, 900)]
    assert runs[0].pipeline.run_status().unpredicted_s == pytest.approx(2.0, abs=2e-3)
    for name, force in runs[0].exposure.joint_forces.items():
        most = whole.exposure.joint_forces[name]
        assert force.compression_n <= 1.001 * most.compression_n and force.tension_n <= 1.001 * most.tension_n
        assert runs[0].exposure.predicted[name].peak_mps2 <= 1.001 * whole.exposure.predicted[name].peak_mps2
    for name, (_, percent) in runs[0].exposure.residual.items():
        assert percent < whole.exposure.residual[name][1] + 0.3, name
    assert runs[1].exposure == runs[0].exposure


def test_a_model_beyond_its_range_predicts_nan_and_restarts() -> None:
    """A seat that shakes as no vehicle does: finite all along, and wrong."""
    streams, t = [], np.arange(3 * 1130) / RATE_HZ
    shaken = np.where(t > 1.2, 150.0 * np.sin(2.0 * np.pi * 5.0 * (t - 1.2)), 0.0)
    for sensor in SENSORS:
        accel = np.zeros((t.size, 3))
        accel[:, 2] = STANDARD_GRAVITY_MPS2 + shaken
        stamps = START_NS + np.rint(t * 1e9).astype(np.int64)
        streams.append(ImuStream(sensor, stamps, accel, np.zeros_like(accel)))
    runs = [run(tuple(streams), in_turn(tuple(streams), size)) for size in (900, 37)]
    runs.append(run(tuple(streams[:1]), in_turn(tuple(streams[:1]), 1)))
    lost = np.isnan(runs[0].predicted).all(axis=1)
    assert runs[0].pipeline.run_status().divergences == lost.sum() > 0
    # The chain begins from rest after each, so nothing counts from the first one to the end of the record.
    uncounted = lost.size - int(np.argmax(lost))
    assert runs[0].pipeline.run_status().unpredicted_s == pytest.approx(uncounted / RATE_HZ, rel=1e-3)
    document = exposure_document(exposure_report(runs[0].pipeline))
    assert all(one["lower_bound"] and one["missing_s"] > 0.0 for one in document["predicted"].values())
    # Where it is first lost, another integration of the whole chain has a joint beyond the range, and not before.
    block = Chain.of(subject()).simulate(_low_passed(streams[0]), RATE_HZ)
    stretch = np.abs(np.diff(block.displacement_m, axis=1, prepend=0.0)).max(axis=1)
    assert abs(int(np.argmax(lost)) - int(np.argmax(stretch > MAX_STRETCH_M))) <= 1
    for other in runs[1:]:
        np.testing.assert_array_equal(other.predicted, runs[0].predicted)
        assert other.exposure.predicted == runs[0].exposure.predicted
    assert runs[1].exposure == runs[0].exposure


def _low_passed(stream: ImuStream) -> np.ndarray:
    conditioner = Conditioner(SEAT)
    blocks = [*conditioner.push(stream.stamps_ns, stream.accel_mps2), *conditioner.finish()]
    return np.concatenate([block.low_passed_mps2 for block in blocks])


def test_gravity_at_the_start_never_counts() -> None:
    # A record that begins with 1 g and nothing else: taken for motion it would be a VDV of 3.5.
    streams = imu_streams(subject(), _still(), np.random.default_rng(1), PERFECT, START_NS)
    result = run(tuple(streams), in_turn(tuple(streams)))
    for dose in result.exposure.sensors.values():
        assert dose.vdv_mps175 < 0.01
    assert result.exposure.dri.compression < 0.01


def _still() -> SeatMotion:
    rng = np.random.default_rng(0)
    motion = load_case("road", 2.0, rng)
    return dataclasses.replace(motion, accel_mps2=0 * motion.accel_mps2, pitch_rate_radps=0 * motion.pitch_rate_radps)


def test_an_impossible_reading_never_reaches_the_model() -> None:
    streams = []
    for stream in noisy_streams():
        accel = stream.accel_mps2.copy()
        accel[2000] = np.nan
        accel[2100, 1] = np.inf
        accel[2200, 2] = 1e300
        streams.append(dataclasses.replace(stream, accel_mps2=accel))
    result = run(tuple(streams), in_turn(tuple(streams)))
    assert np.isfinite(result.predicted).all()
    assert result.pipeline.status(SEAT).non_finite == 3
    assert result.pipeline.status(SEAT).filled == 3
    assert result.pipeline.run_status().divergences == 0
    np.testing.assert_allclose(result.predicted, uncut().predicted, atol=0.2)


def test_an_unknown_sensor_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="'knee' is unknown, known are seat, pelvis"):
        Pipeline(subject()).push("knee", np.zeros(1, dtype=np.int64), np.zeros((1, 3)))


@pytest.mark.skipif(not kernels.COMPILED, reason="without numba nothing is compiled")
def test_nothing_is_compiled_after_the_warm_up() -> None:
    warm_up(subject())
    compiled = [getattr(kernels, name) for name in kernels.__all__ if hasattr(getattr(kernels, name), "signatures")]
    before = [list(kernel.signatures) for kernel in compiled]
    assert len(compiled) >= 10 and kernels.end_loss.signatures
    run(noisy_streams(), in_turn(noisy_streams(), 1)[:15000])
    ridden = run(noisy_streams(), in_turn(noisy_streams(), 333)).pipeline
    assert ridden.seat() is not None and ridden.exposure(rolling=True).sensors
    assert [list(kernel.signatures) for kernel in compiled] == before


@pytest.mark.parametrize(("step", "told"), [(2, []), (4, [f"{SEAT}: 282 Hz is slow"])])
def test_a_slow_seat_is_reported(step: int, told: list[str]) -> None:
    streams = [
        dataclasses.replace(
            one, stamps_ns=one.stamps_ns[::step], accel_mps2=one.accel_mps2[::step], gyro_radps=one.gyro_radps[::step]
        )
        for one in independent_streams()
    ]
    pipeline = run(streams, in_turn(streams)).pipeline
    lines = sensor_warnings(pipeline, SENSORS)
    assert [line.rpartition(":")[0] for line in lines if "is slow" in line] == told
