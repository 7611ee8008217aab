"""Timelines: stamps that leap and return, clocks that are set, and pauses: comparison, missing time, offsets."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest
from histories import Sends, found
from streams import RATE_HZ, noisy_streams, subject

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.body.synthesis import ImuStream
from biodyn_core.conditioning.conditioner import Conditioner
from biodyn_core.conditioning.timelines import Timelines
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


@cache
def unchanged() -> tuple[Pipeline, np.ndarray, np.ndarray]:
    """The same of the streams as they are; read-only."""
    return pushed(noisy_streams(SECONDS))


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


def timelines_of(streams: list[ImuStream], block: int) -> tuple[Timelines, dict[str, float]]:
    """Timelines behind the streams in turns, without the rest of the pipeline, and the gaps of each sensor, s."""
    conditioners = {one.sensor: Conditioner(one.sensor, mode="survey") for one in streams}
    timelines = Timelines(conditioners, 1.0)
    for at in range(0, max(len(one.stamps_ns) for one in streams), block):
        for one in streams:
            part = slice(at, at + block)
            conditioners[one.sensor].push(one.stamps_ns[part], one.accel_mps2[part])
            timelines.update(one.sensor)
    return timelines, {name: one.status().gap_s + timelines.gap_s(name) for name, one in conditioners.items()}


def those(streams: Iterable[ImuStream], *sensors: str) -> list:
    """The streams of some sensors."""
    return [one for one in streams if one.sensor in sensors]


def still(streams: Iterable[ImuStream], sensor: str) -> list:
    """The streams with a sensor that does not move, so that its rest is found whenever it begins."""
    noise = 0.01 * np.random.default_rng(3).standard_normal((len(next(iter(streams)).stamps_ns), 3)) + [0.0, 0.0, 9.81]
    return [dataclasses.replace(one, accel_mps2=noise) if one.sensor == sensor else one for one in streams]


@pytest.mark.parametrize("by_ns", [HOUR_NS, -HOUR_NS])
@pytest.mark.parametrize("sensor", [SEAT, "head"])
def test_comparisons_continue_when_leapt_stamps_return(sensor: str, by_ns: int) -> None:
    streams = noisy_streams(SECONDS)
    pipeline, measured, _ = pushed(leapt(streams, [sensor], by_ns, 3.0, 4.0))
    whole, same, _ = unchanged()
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


def test_the_outage_is_missing_for_the_seat_when_it_returns_alone() -> None:
    """The sensors that were taken off meanwhile say nothing about the seat's clock."""
    streams = leapt(those(noisy_streams(SECONDS), SEAT, "pelvis", "head"), SENSORS, 120 * 10**9, 4.0, 99.0)
    pipeline, *_ = pushed(without(streams, ["pelvis", "head"], 4.0, 99.0))
    lost = pipeline.losses(SEAT)
    assert lost.missing_s == pytest.approx(120.0, abs=0.1) and lost.lower_bound
    assert pipeline.timelines.offset_s(SEAT) == 0.0
    assert pipeline.seat().zone != "below_action_value"
    gone_s = 120.0 + len(streams[0].stamps_ns) / RATE_HZ - 4.0
    assert pipeline.losses("head").missing_s == pytest.approx(gone_s, abs=0.3)


def test_the_outage_is_missing_for_two_of_six_sensors_that_return() -> None:
    streams = leapt(noisy_streams(SECONDS), SENSORS, 120 * 10**9, 4.0, 99.0)
    streams = without(streams, [name for name in SENSORS if name not in (SEAT, "pelvis")], 4.0, 99.0)
    _, gaps_s = timelines_of(without(streams, ["pelvis"], 4.0, 4.2), BLOCK)
    assert gaps_s[SEAT] == pytest.approx(120.0, abs=0.1) and gaps_s["pelvis"] == pytest.approx(120.2, abs=0.1)


blocks = pytest.mark.parametrize("block", [70, 900])
orders = pytest.mark.parametrize("order", [1, -1])


@blocks
@orders
@pytest.mark.parametrize("by_s", [10, 3600, -10])
@pytest.mark.parametrize("sensor", [SEAT, "neck"])
def test_the_order_of_arrival_does_not_decide_whether_a_clock_was_set(
    sensor: str, by_s: int, order: int, block: int
) -> None:
    """A clock that was set loses no time, however samples arrive."""
    streams = list(noisy_streams(SECONDS))[::order]
    timelines, gaps_s = timelines_of(leapt(streams, [sensor], by_s * 10**9, 4.0, 99.0), block)
    lag_s = block / RATE_HZ + 0.05
    assert timelines.offset_s(sensor) == pytest.approx(by_s, abs=lag_s)
    assert gaps_s[sensor] == pytest.approx(0.0, abs=lag_s)
    assert {name: gap_s for name, gap_s in gaps_s.items() if gap_s and name != sensor} == {}


@blocks
@orders
@pytest.mark.parametrize("by_s", [10, 3600, -10])
def test_the_order_of_arrival_does_not_decide_whether_all_sensors_paused(by_s: int, order: int, block: int) -> None:
    streams = list(noisy_streams(SECONDS))[::order]
    timelines, gaps_s = timelines_of(leapt(streams, SENSORS, by_s * 10**9, 4.0, 99.0), block)
    assert [timelines.offset_s(name) for name in SENSORS] == [0.0] * 6
    assert list(gaps_s.values()) == pytest.approx([max(0.0, by_s)] * 6, abs=0.1)


@pytest.mark.parametrize("by_s", [-30, 10, 20])
def test_a_sensor_that_joins_behind_a_common_leap_has_the_clock_of_the_others(by_s: int) -> None:
    """All clocks are set back, or all sensors pause: the neck missed what the seat counted or missed until then."""
    streams = leapt(
        still(those(noisy_streams(SECONDS), SEAT, "neck", "head"), "neck"), SENSORS, by_s * 10**9, 3.0, 99.0
    )
    timelines, gaps_s = timelines_of(without(streams, ["neck"], 0.0, 6.0), BLOCK)
    assert [timelines.offset_s(name) for name in (SEAT, "neck", "head")] == [0.0] * 3
    assert timelines.late_s("neck") == pytest.approx(6.0 + max(0, by_s), abs=0.1)
    assert timelines.late_s(SEAT) == timelines.late_s("head") == 0.0
    assert gaps_s["head"] == pytest.approx(max(0.0, by_s), abs=0.1)


def test_clocks_of_all_that_are_set_ahead_and_back_again_lose_nothing() -> None:
    timelines, gaps_s = timelines_of(leapt(noisy_streams(14.0), SENSORS, 10 * 10**9, 2.0, 12.0), BLOCK)
    assert [timelines.offset_s(name) for name in SENSORS] == [0.0] * 6
    assert list(gaps_s.values()) == pytest.approx([0.0] * 6, abs=0.05)


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


def test_a_reset_just_behind_a_set_clock_hides_no_later_loss() -> None:
    pipeline, streams = Pipeline(subject()), leapt(noisy_streams(SECONDS), [SEAT], HOUR_NS, 4.0, 99.0)
    streams = without(streams, [SEAT], 6.8, 7.3)
    for at in range(0, len(streams[0].stamps_ns), BLOCK):
        if at == 37 * BLOCK:
            pipeline.reset()
        for one in streams:
            part = slice(at, at + BLOCK)
            pipeline.push(one.sensor, one.stamps_ns[part], one.accel_mps2[part])
    assert pipeline.losses(SEAT).missing_s == pytest.approx(0.5, abs=0.02)


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


def test_a_lone_seat_that_sends_only_unusable_samples_has_no_rolling_figures() -> None:
    streams = those(without(noisy_streams(16.0), [SEAT], 4.0, 99.0), SEAT)
    rolling, since = (pushed(streams)[0].exposure(rolling) for rolling in (True, False))
    assert SEAT in since.sensors
    assert (rolling.sensors, rolling.dri, rolling.predicted) == ({}, None, {})


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


@pytest.mark.parametrize("unusable", [True, False])
@pytest.mark.parametrize("dropout_first", [True, False])
def test_a_dropout_near_a_clock_set_back_by_the_same_time_is_missing(dropout_first: bool, unusable: bool) -> None:
    """Stamps alone look like a clock that is set and returns; the others, and samples that came, show the time."""
    back_at_s, lost_s = (5.5, (3.0, 4.5)) if dropout_first else (3.0, (4.5, 6.0))
    streams = leapt(noisy_streams(SECONDS), [SEAT], -1_500_000_000, back_at_s, 99.0)
    if unusable:
        streams = those(without(streams, [SEAT], *lost_s), SEAT)
    else:
        kept = np.ones(len(streams[0].stamps_ns), dtype=bool)
        kept[int(lost_s[0] * RATE_HZ) : int(lost_s[1] * RATE_HZ)] = False
    pipeline = Pipeline(subject())
    for at in range(0, len(streams[0].stamps_ns), BLOCK):
        for one in streams:
            sent = np.arange(len(one.stamps_ns))[at : at + BLOCK]
            sent = sent[kept[sent]] if one.sensor == SEAT and not unusable else sent
            pipeline.push(one.sensor, one.stamps_ns[sent], one.accel_mps2[sent])
    assert pipeline.losses(SEAT).absent_s == pytest.approx(1.5, abs=0.15)


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


SOME = (SEAT, "head", "neck", "pelvis")


@pytest.mark.parametrize("set_s", [3600.0, -50.0])
def test_a_sensor_that_paused_alone_shows_the_next_one_that_its_clock_was_set(set_s: float) -> None:
    """No other sensor ever decides the pause of the seat."""
    sends = {SEAT: Sends(((0, 60), (70, 220))), "head": Sends(((0, 40), (200, 220)), ((150, set_s),))}
    for seed in range(3):
        one = found(sends, seed)
        assert one[SEAT] == pytest.approx((10.0, 0.0), abs=1.0), seed
        assert one["head"] == pytest.approx((160.0, set_s), abs=1.0), seed


@pytest.mark.parametrize("ahead_s", [4.0, 10.0, -10.0])
@pytest.mark.parametrize("drifts", [True, False])
@pytest.mark.parametrize("sensor", [SEAT, "head"])
def test_a_common_pause_is_missing_when_one_clock_leads_the_others(sensor: str, drifts: bool, ahead_s: float) -> None:
    """A clock that leads from the start makes a sensor late too, in one order of arrival."""
    sends = dict.fromkeys(SOME, Sends(((0, 100), (200, 230))))
    drift_s = tuple((at, 0.01 * ahead_s) for at in range(100))
    sends[sensor] = Sends(((0, 100), (200, 230)), *((drift_s, 0.0) if drifts else ((), ahead_s)))
    late_s = 0.0 if drifts else abs(ahead_s)
    for seed in range(3):
        for name, one in found(sends, seed).items():
            assert 97.0 < one.missing_s < 103.0 + late_s, (name, seed)
            assert one.offset_s == 0.0, (name, seed)


@pytest.mark.parametrize("back_s", [50.0, 100.0, 150.0])
@pytest.mark.parametrize("later_s", [-3.0, -1.5, 0.0, 1.5, 3.0])
def test_a_common_pause_is_missing_for_a_clock_that_was_set_back_in_it(later_s: float, back_s: float) -> None:
    """Set back by as much as the pause lasts: the clock stood still."""
    sends = dict.fromkeys(SOME, Sends(((0, 30), (130, 160))))
    sends["neck"] = Sends(((0, 30), (130 + later_s, 160)), ((80, -back_s),))
    for seed in range(3):
        one = found(sends, seed)
        assert one["neck"] == pytest.approx((100.0 + later_s, -back_s), abs=1.5), seed
        for name in (SEAT, "head", "pelvis"):
            assert one[name].missing_s == pytest.approx(100.0, abs=3.5) and one[name].offset_s == 0.0, (name, seed)


def test_a_reset_between_a_set_clock_and_the_next_block_of_others_hides_no_later_loss_of_theirs() -> None:
    pipeline, streams = Pipeline(subject()), leapt(noisy_streams(SECONDS), ["head"], HOUR_NS, 4.0, 99.0)
    streams = those(without(streams, [SEAT], 6.0, 7.0), "head", SEAT)[::-1]
    is_reset = False
    for at in range(0, len(streams[0].stamps_ns), BLOCK):
        for one in streams:
            part = slice(at, at + BLOCK)
            pipeline.push(one.sensor, one.stamps_ns[part], one.accel_mps2[part])
            if not is_reset and pipeline.timelines.silent_s(SEAT) > 3000.0:
                pipeline.reset()
                is_reset = True
    lost = pipeline.losses(SEAT)
    assert is_reset and lost.missing_s == pytest.approx(1.0, abs=0.02) and lost.lower_bound


@pytest.mark.parametrize("behind_s", [30.0, 20.0])
def test_a_sensor_that_joins_late_with_a_clock_behind_the_others_is_late(behind_s: float) -> None:
    sends = dict.fromkeys((SEAT, "head"), Sends(((0, 50),)))
    one = found(sends | {"neck": Sends(((30, 50),), (), -behind_s)})
    assert one["neck"].missing_s == pytest.approx(30.0, abs=1.0)
    assert one[SEAT].missing_s == one["head"].missing_s == 0.0
