"""Timelines: stamps that leap and return, clocks that are set, and pauses: comparison, missing time, offsets."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pytest
from streams import RATE_HZ, noisy_streams, subject

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.body.synthesis import ImuStream
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros.reports.exposure_report import sensor_warnings

HOUR_NS = 3600 * 10**9
SECONDS = 8.0
BLOCK = 140


def pushed(streams: Iterable[ImuStream]) -> tuple[Pipeline, np.ndarray, np.ndarray]:
    """The pipeline behind the streams in turns by their place in the record, measured frames and their stamps."""
    pipeline, frames = Pipeline(subject()), []
    longest = max(len(stream.stamps_ns) for stream in streams)
    for at in range(0, longest, BLOCK):
        for one in streams:
            part = slice(at, at + BLOCK)
            frames.append(pipeline.push(one.sensor, one.stamps_ns[part], one.accel_mps2[part]).measured)
    frames.append(pipeline.finish().measured)
    return pipeline, *(np.concatenate([frame[i] for frame in frames]) for i in (1, 0))


def leapt(streams: Iterable[ImuStream], sensors: Iterable[str], by_ns: int, begin_s: float, end_s: float) -> list:
    """The streams with the stamps of some sensors away by so much from one instant up to another."""
    found = []
    for one in streams:
        stamps_ns = one.stamps_ns.copy()
        if one.sensor in sensors:
            stamps_ns[int(begin_s * RATE_HZ) : int(end_s * RATE_HZ)] += by_ns
        found.append(dataclasses.replace(one, stamps_ns=stamps_ns))
    return found


def without(streams: Iterable[ImuStream], sensors: Iterable[str], begin_s: float, end_s: float) -> list:
    """The streams without some sensors' samples of a stretch; later samples are unchanged."""
    found = []
    for one in streams:
        kept = np.ones(len(one.stamps_ns), dtype=bool)
        if one.sensor in sensors:
            kept[int(begin_s * RATE_HZ) : int(end_s * RATE_HZ)] = False
        # A stamp of zero was never set: it holds the place, and counts for nothing.
        found.append(dataclasses.replace(one, stamps_ns=np.where(kept, one.stamps_ns, 0)))
    return found


@pytest.mark.parametrize("by_ns", [HOUR_NS, -HOUR_NS])
@pytest.mark.parametrize("sensor", [SEAT, "head"])
def test_comparisons_continue_when_leapt_stamps_return(sensor: str, by_ns: int) -> None:
    streams = noisy_streams(SECONDS)
    pipeline, measured, _ = pushed(leapt(streams, [sensor], by_ns, 3.0, 4.0))
    whole, same, _ = pushed(streams)
    late = slice(-int(2.0 * RATE_HZ), -50)
    assert np.isfinite(measured[late]).all()
    np.testing.assert_allclose(measured[late], same[late], atol=2e-3)  # the clock is tracked again, so not to the bit
    assert pipeline.timelines.offset_s(sensor) == 0.0
    for name in SENSORS:
        assert pipeline.losses(name).missing_s == pytest.approx(whole.losses(name).missing_s, abs=0.05), name


@pytest.mark.parametrize("by_ns", [HOUR_NS, -HOUR_NS])
@pytest.mark.parametrize("sensor", [SEAT, "head"])
def test_a_set_clock_loses_only_the_silence(sensor: str, by_ns: int) -> None:
    streams = without(noisy_streams(SECONDS), [sensor], 3.0, 4.0)
    pipeline, *_ = pushed(leapt(streams, [sensor], by_ns, 4.0, 99.0))
    assert pipeline.timelines.offset_s(sensor) == pytest.approx(by_ns * 1e-9, abs=0.3)
    assert pipeline.losses(sensor).missing_s == pytest.approx(1.0, abs=0.3)
    for name in SENSORS:
        if name != sensor:
            assert pipeline.losses(name).missing_s == 0.0 and pipeline.timelines.offset_s(name) == 0.0


def test_a_common_leap_is_a_missing_pause() -> None:
    pipeline, measured, _ = pushed(leapt(noisy_streams(SECONDS), SENSORS, HOUR_NS, 4.0, 99.0))
    for name in SENSORS:
        assert pipeline.timelines.offset_s(name) == 0.0
        assert pipeline.losses(name).missing_s == pytest.approx(3600.0, abs=0.1)
    assert np.isfinite(measured[-2000:-50]).all()


def test_the_time_of_others_is_missing_for_a_sensor_that_returns_by_its_own_clock() -> None:
    pipeline, *_ = pushed(without(noisy_streams(SECONDS), ["head"], 3.0, 6.0))
    assert pipeline.timelines.offset_s("head") == 0.0
    assert pipeline.losses("head").missing_s == pytest.approx(3.0, abs=0.05)


def test_silence_after_a_set_clock_is_reported() -> None:
    streams = leapt(noisy_streams(SECONDS), ["head"], HOUR_NS, 3.0, 99.0)
    pipeline, *_ = pushed(without(streams, ["head"], 5.0, 99.0))
    assert pipeline.losses("head").missing_s == pytest.approx(len(streams[0].stamps_ns) / RATE_HZ - 5.0, abs=0.3)
    assert pipeline.losses(SEAT).missing_s == 0.0


def test_a_leap_of_the_last_sensor_left_is_a_pause() -> None:
    """No other sensor shows whether its clock was set, so its gap counts: the figures are lower bounds."""
    streams = leapt(noisy_streams(SECONDS), [SEAT], HOUR_NS, 6.0, 99.0)
    pipeline, *_ = pushed(without(streams, [name for name in SENSORS if name != SEAT], 2.0, 99.0))
    assert pipeline.losses(SEAT).missing_s == pytest.approx(3600.0, abs=0.1)


def test_sensors_whose_clocks_are_hours_apart_from_the_start_are_neither_late_nor_silent() -> None:
    pipeline, *_ = pushed(leapt(noisy_streams(SECONDS), ["neck"], HOUR_NS, 0.0, 99.0))
    assert pipeline.timelines.offset_s("neck") == pytest.approx(3600.0, abs=0.3)
    for name in SENSORS:
        assert pipeline.losses(name).missing_s == 0.0, name


def test_clocks_that_drift_apart_for_hours_are_no_silence() -> None:
    """Two seconds in eight, as 50 ppm do in eleven hours; behind it a sensor that does fall silent is."""
    streams = []
    for one in noisy_streams(SECONDS):
        slow_ns = np.rint((one.stamps_ns - one.stamps_ns[0]) * (0.2 if one.sensor == "head" else 0.0)).astype(np.int64)
        streams.append(dataclasses.replace(one, stamps_ns=one.stamps_ns - slow_ns))
    pipeline, *_ = pushed(streams)
    assert [pipeline.losses(name).missing_s for name in SENSORS] == [0.0] * 6
    pipeline, *_ = pushed(without(streams, ["head"], 6.0, 99.0))
    assert pipeline.losses("head").missing_s == pytest.approx(len(streams[0].stamps_ns) / RATE_HZ - 6.0, abs=0.3)


def test_a_dead_sensor_of_a_looping_bag_stays_missing() -> None:
    one = noisy_streams(4.0)
    dead = without(one, ["neck"], 2.0, 99.0)
    two = [
        dataclasses.replace(
            a, stamps_ns=np.concatenate([a.stamps_ns, b.stamps_ns * (b.sensor != "neck")]),
            accel_mps2=np.concatenate([a.accel_mps2, b.accel_mps2]),
        )
        for a, b in zip(dead, one, strict=True)
    ]  # fmt: skip
    pipeline, *_ = pushed(two)
    assert pipeline.losses("neck").missing_s == pytest.approx(2.0 * len(one[0].stamps_ns) / RATE_HZ - 2.0, abs=0.3)
    assert pipeline.losses(SEAT).missing_s == pytest.approx(0.0, abs=0.05)


def test_a_clock_that_is_half_a_minute_behind_makes_no_other_sensor_late() -> None:
    pipeline, *_ = pushed(leapt(noisy_streams(SECONDS), ["neck"], -30 * 10**9, 0.0, 99.0))
    assert [pipeline.losses(name).missing_s for name in SENSORS] == [0.0] * 6


def test_a_sensor_that_joins_behind_a_reset_is_late_since_then() -> None:
    rng, pipeline = np.random.default_rng(3), Pipeline(subject())
    streams = without(noisy_streams(SECONDS), ["neck"], 0.0, 5.5)
    still = 0.01 * rng.standard_normal((len(streams[0].stamps_ns), 3)) + [0.0, 0.0, 9.81]
    streams = [dataclasses.replace(one, accel_mps2=still) if one.sensor == "neck" else one for one in streams]
    for at in range(0, len(streams[0].stamps_ns), BLOCK):
        if at == 28 * BLOCK:
            pipeline.reset()
        for one in streams:
            part = slice(at, at + BLOCK)
            pipeline.push(one.sensor, one.stamps_ns[part], one.accel_mps2[part])
    assert pipeline.losses("neck").missing_s == pytest.approx(5.5 - 28 * BLOCK / RATE_HZ, abs=0.02)


@pytest.mark.parametrize("sensor", [SEAT, "head"])
def test_a_sensor_that_is_silent_for_longer_than_the_window_has_no_rolling_figures(sensor: str) -> None:
    streams = noisy_streams(16.0)
    pipeline, *_ = pushed(without(streams, [sensor], 4.0, 99.0))
    rolling, since = pipeline.exposure(rolling=True), pipeline.exposure()
    assert sensor in since.sensors and sensor not in rolling.sensors
    assert (rolling.dri is None) == (rolling.predicted == {}) == (rolling.residual == {}) == (sensor == SEAT)
    assert (rolling.hic15 is None) == (sensor == "head")
    shorter, *_ = pushed(without(streams, [sensor], 10.0, 99.0))
    assert sensor in shorter.exposure(rolling=True).sensors


@pytest.mark.parametrize("back_s", [0.1, 0.5, 0.9])
def test_a_clock_set_back_by_less_than_a_second_loses_the_repeated_time(back_s: float) -> None:
    """Stamps have no gap there, but samples of that time are in no figure."""
    pipeline, *_ = pushed(leapt(noisy_streams(SECONDS), [SEAT], -round(1e9 * back_s), 4.0, 99.0))
    lost, status = pipeline.losses(SEAT), pipeline.status(SEAT)
    assert lost.missing_s == pytest.approx(back_s, abs=0.01) and lost.lower_bound
    assert status.runs == 2 and not status.warnings
    assert any("seat: its stamps jumped back by" in line for line in sensor_warnings(pipeline, SENSORS))
    for name in SENSORS:
        if name != SEAT:
            assert pipeline.losses(name).missing_s == 0.0, name


def test_delayed_samples_are_no_clock_set_back() -> None:
    streams = []
    for one in noisy_streams(SECONDS):
        order = np.arange(len(one.stamps_ns))
        order[5000:5070] = np.r_[5035:5070, 5000:5035]
        streams.append(dataclasses.replace(one, stamps_ns=one.stamps_ns[order], accel_mps2=one.accel_mps2[order]))
    pipeline, *_ = pushed(streams)
    for name in SENSORS:
        assert pipeline.status(name).set_back_s == 0.0
        assert pipeline.losses(name).missing_s == pytest.approx(35 / RATE_HZ, abs=0.003), name
