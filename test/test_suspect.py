"""Suspect samples: a loss within strong motion never raises a figure that is a lower bound, and decides no zone."""

from __future__ import annotations

import json
import math
from functools import cache

import naive
import numpy as np
import pytest
from conditioned import RATE_HZ, Conditioned, raw, stamps
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from streams import subject

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SENSORS
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.conditioning.gravity import Gravity
from biodyn_core.exposure.checkpoint import ExposureCheckpoint
from biodyn_core.exposure.hidden_motion import HiddenMotion
from biodyn_core.exposure.sensor_meters import SensorMeters
from biodyn_core.exposure.suspect import (
    LEVEL_S,
    LONGEST_SETTLING_S,
    NEAR_S,
    SETTLING,
    SHORTEST_LOSS_S,
    STRONG_MPS2,
    SuspectSamples,
)
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.pipeline_settings import PipelineSettings
from biodyn_core.signals.weighting import weighting_sections
from biodyn_ros.node.health import HealthMonitor, SensorHealth
from biodyn_ros.node.snapshot_builder import SnapshotBuilder
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import exposure_report

WINDOW_S = 60.0
G = naive.GRAVITY
G_STANDARD = 9.80665
SHOCK_BEGIN_S, SHOCK_S = 3.0, 0.02


def rows_of(seconds: float) -> int:
    """The number of samples in a time."""
    return round(seconds * RATE_HZ)


def block_of(rows: np.ndarray, lost: np.ndarray | None = None, begins_run: bool = False, gap_s: float = 0.0) -> Block:
    """Levelled samples (n, 3) as a block."""
    none = np.empty(0)
    return Block(none.astype(np.int64), none, rows, none, begins_run, gap_s, 0, RATE_HZ, 100.0, lost)


def lost_at(count: int, begin: int, end: int) -> np.ndarray:
    """`Block.lost` of one loss among so many samples."""
    return np.where((np.arange(count) >= begin) & (np.arange(count) < end), end - begin, 0)


# --- flags -----------------------------------------------------------------------------------------------------------


def flagged(rows: np.ndarray, lost: np.ndarray, follows_loss: bool) -> np.ndarray:
    """The flags by their definition, with a look at all rows for each one."""
    near, longest, shortest = rows_of(NEAR_S), rows_of(LONGEST_SETTLING_S), math.ceil(SHORTEST_LOSS_S * RATE_HZ)
    follow = 1.0 - math.exp(-1.0 / (LEVEL_S * RATE_HZ))
    levels = signal.lfilter([follow], [1.0, follow - 1.0], rows.clip(-G_STANDARD, G_STANDARD), axis=0)
    strong = np.flatnonzero((np.abs(rows - np.vstack([np.zeros(3), levels[:-1]])) > STRONG_MPS2).any(axis=1))
    losses = [(0, longest)] * follows_loss
    for n in np.flatnonzero(lost >= shortest):  # the longest of losses close to each other
        before = losses[-1] if losses and n - losses[-1][0] <= near + 1 else (0, 0)
        losses.append((int(n), max(int(lost[n]), before[1])))
    suspect = np.zeros(len(rows), dtype=bool)
    for n, length in losses:
        if ((strong <= n) & (strong >= n - near)).any() and lost[n]:
            suspect[n : n + min(SETTLING * length, longest)] = True
    for n in strong:
        before = [(at, length) for at, length in losses if n - near <= at <= n]
        if before:
            suspect[n : n + min(SETTLING * before[-1][1], longest)] = True
    return suspect


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    follows_loss=st.booleans(),
    cuts=st.lists(st.integers(0, 6000), max_size=6).map(sorted),
)
def test_flags_are_those_of_the_definition_for_any_cut(seed, follows_loss, cuts):
    rng = np.random.default_rng(seed)
    rows, lost = rng.uniform(-2.8, 2.8, (6000, 3)), np.zeros(6000, dtype=np.int64)
    places = rng.integers(0, 6000, rng.integers(0, 4))
    near = (places[:1] + rng.integers(0, 120)).clip(max=5999)  # two of them close to each other
    for at in np.append(places, near):
        rows[at, rng.integers(3)] = rng.choice([-3.3, 40.0])
        begin = max(int(at) + int(rng.integers(-80, 80)), 0)
        end = begin + int(rng.integers(1, 57))
        if not lost[max(begin - 1, 0) : end + 1].any():
            lost[begin:end] = len(lost[begin:end])
    samples = SuspectSamples(RATE_HZ)
    samples.begin_run(follows_loss)
    parts = zip(np.split(rows, cuts), np.split(lost, cuts), strict=True)
    found = np.concatenate([samples.flags(part, of_them) for part, of_them in parts])
    np.testing.assert_array_equal(found, flagged(rows, lost, follows_loss))


@pytest.mark.parametrize("mode", ["causal", "zero_phase"])
@pytest.mark.parametrize("cuts", [(), range(1, 4000), (1500, 2290, 2300)])
def test_blocks_state_the_length_of_each_loss(mode, cuts):
    times, samples = stamps(4000), raw(np.zeros((4000, 3)) + 0.1 * np.sin(np.arange(4000.0))[:, None])
    kept = np.r_[0:2285, 2310:3000, 3001:3990]
    found = Conditioned(times[kept], samples[kept], [cut for cut in cuts if cut < len(kept)], mode=mode)
    lost = np.concatenate([block.losses for block in found.blocks])
    first = 4000 - 10 - len(lost)  # conditioned samples begin after the rest
    expected = np.zeros(3990, dtype=np.int64)
    expected[2285:2310], expected[3000] = 25, 1
    np.testing.assert_array_equal(lost, expected[first:])
    parts = np.concatenate([block.part(at, at + 1).losses for block in found.blocks for at in range(len(block.time_s))])
    np.testing.assert_array_equal(parts, lost)


def test_a_short_loss_does_not_shorten_the_settling_after_a_long_one():
    samples, rows = SuspectSamples(RATE_HZ), np.zeros((rows_of(4.0), 3))
    rows[130] = 40.0
    lost = lost_at(len(rows), 20, 76) + lost_at(len(rows), 90, 93) + lost_at(len(rows), 110, 114)
    assert samples.flags(rows, lost).sum() == SETTLING * 56
    after_gap = SuspectSamples(RATE_HZ)
    after_gap.begin_run(follows_loss=True)
    assert after_gap.flags(rows, lost_at(len(rows), 40, 44) + lost_at(len(rows), 110, 114)).sum() < rows_of(1.0)
    after_gap.begin_run(follows_loss=True)
    assert after_gap.flags(rows[100:], lost_at(len(rows) - 100, 5, 9)).sum() == rows_of(LONGEST_SETTLING_S)


def test_a_record_that_begins_in_a_shock_has_no_dose_of_its_restart():
    time = np.arange(rows_of(8.0)) / RATE_HZ
    swing = 8.0 * np.exp(-time / 0.5) * np.cos(2.0 * np.pi * 1.5 * time)
    begun, complete = (
        np.tile(swing[:, None], (1, 3)),
        signal.sosfilt(weighting_sections("Wk", RATE_HZ), np.append(np.zeros(10), swing)),
    )
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S, begins_in_motion=True)
    meters.push(block_of(begun, begins_run=True))
    meters.finish()
    assert meters.suspect_s() == pytest.approx(LONGEST_SETTLING_S, abs=0.1)
    assert meters.vertical().peak_mps2 < 0.1 * np.abs(complete).max()


def test_a_tilt_or_a_bend_is_no_strong_motion():
    samples, leaning = SuspectSamples(RATE_HZ), np.tile([0.0, 4.0, -1.0], (rows_of(30.0), 1))
    lost = np.where(np.arange(len(leaning)) % 1700 < 5, 5, 0)
    assert not samples.flags(leaning, lost)[rows_of(2.0 * LEVEL_S) :].any()


# --- figures ---------------------------------------------------------------------------------------------------------


def motion(rng: np.random.Generator) -> np.ndarray:
    """A ride of 8 s (n,) with up to three shocks in the fourth second: half and full sines, decaying ones, steps."""
    time = np.arange(rows_of(8.0)) / RATE_HZ
    band = signal.butter(2, (1.0, 40.0), "bandpass", fs=RATE_HZ, output="sos")
    found = rng.uniform(0.0, 5.0) * signal.sosfilt(band, rng.standard_normal(time.size))
    for _ in range(rng.integers(1, 4)):
        size = np.exp(rng.uniform(np.log(4.0), np.log(80.0))) * rng.choice([-1.0, 1.0])
        lasts_s = np.exp(rng.uniform(np.log(0.004), np.log(0.5)))
        u = np.clip(time - rng.uniform(3.0, 4.0), 0.0, None)
        decaying = np.exp(-u / lasts_s) * np.sin(2.0 * np.pi * u / rng.uniform(0.03, 0.5))
        half, full = (np.where(u < k * lasts_s, np.sin(np.pi * u / lasts_s), 0.0) for k in (1, 2))
        step = ((u > 0.0) & (u < lasts_s)).astype(float)
        found += size * (half, full, decaying, step)[rng.integers(4)]
    return found


def with_a_loss(accel: np.ndarray, rng: np.random.Generator, shortest: int, longest: int) -> list[Block]:
    """The motion on all axes as blocks: a line over so many samples, or a gap of up to 0.4 s."""
    at, rows = rows_of(rng.uniform(2.9, 4.2)), np.tile(accel[:, None], (1, 3))
    if rng.random() < 0.7:
        end = at + int(rng.integers(shortest, longest))
        rows[at:end] = np.interp(np.arange(at, end), [at - 1, end], accel[[at - 1, end]])[:, None]
        return [block_of(rows, lost_at(len(rows), at, end), begins_run=True)]
    end = at + int(rng.integers(60, 450))
    return [block_of(rows[:at], begins_run=True), block_of(rows[end:], begins_run=True, gap_s=(end - at) / RATE_HZ)]


def doses(meters: SensorMeters, suspect: bool) -> np.ndarray:
    """VDV and aw by Wk and along x by Wd, peak and both MTVV by Wk, (7,)."""
    up = meters.vertical_with_suspect() if suspect else meters.vertical()
    aw, vdv = meters.plane().along([0.0], suspect=suspect)
    return np.array(
        [up.vdv_mps175, up.aw_mps2, vdv[0], aw[0], up.peak_mps2, up.mtvv_linear_mps2, up.mtvv_exponential_mps2]
    )


def true_doses(accel: np.ndarray, seconds: float) -> np.ndarray:
    """The same of the complete motion, by scipy; a mean over the counted seconds, because no loss adds to the sum."""
    found = []
    for name in ("Wk", "Wd"):
        weighted = signal.sosfilt(weighting_sections(name, RATE_HZ), accel)
        found += [np.sum(weighted**4) ** 0.25 / RATE_HZ**0.25, np.sqrt(np.sum(weighted**2) / RATE_HZ / seconds)]
        if name == "Wk":
            peaks = [np.abs(weighted).max(), *(run(weighted, RATE_HZ).max() for run in RUNNING)]
    return np.array([*found, *peaks])


RUNNING = (naive.linear_running_rms, naive.running_rms)


@cache
def excess(shortest: int, longest: int) -> tuple[np.ndarray, np.ndarray]:
    """Figures over 1.06 times the true ones, without and with suspect samples, of 150 motions with a loss, (150, 7)."""
    rng = np.random.default_rng(21)
    without, with_them = [], []
    for _ in range(150):
        accel = motion(rng)
        meters = SensorMeters("seat", RATE_HZ, WINDOW_S)
        for block in with_a_loss(accel, rng, shortest, longest):
            meters.push(block)
        true = true_doses(accel, meters.vertical().seconds)
        without.append(doses(meters, False) - 1.06 * true)
        with_them.append(doses(meters, True) - 1.06 * true)
    return np.array(without), np.array(with_them)


@pytest.mark.parametrize(("shortest", "longest"), [(1, 56), (3, 12)])
def test_no_loss_raises_a_figure_above_the_true_one(shortest, longest):
    without, with_them = excess(shortest, longest)
    assert without.max() < 0.01
    if longest > 50:  # the losses are such that could
        assert (with_them.max(axis=0) > 0.1).all()


def test_a_mean_is_a_lower_bound_where_strong_seconds_are_left_out_or_kept():
    # Bursts with a loss at their end, then rest: the rest is left out, so a mean over the others would be too high.
    time = np.arange(rows_of(60.0)) / RATE_HZ
    accel = np.where(time % 3.0 < 0.5, 6.0 * np.sin(2.0 * np.pi * 6.0 * time), 0.0)
    rows, lost = np.tile(accel[:, None], (1, 3)), np.zeros(len(time), dtype=np.int64)
    for burst in range(20):
        at = rows_of(3.0 * burst + 0.46)
        rows[at : at + 45], lost[at : at + 45] = np.linspace(rows[at - 1], rows[at + 45], 45), 45
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S)
    meters.push(block_of(rows, lost))
    true = true_doses(accel, time.size / RATE_HZ)
    assert 30.0 < meters.suspect_s() < 50.0
    assert meters.vertical().seconds == pytest.approx(time.size / RATE_HZ)
    assert meters.vertical().aw_mps2 < true[1] and meters.plane().along([0.0])[0][0] < true[3]


def test_short_losses_on_a_rough_road_hide_little():
    band = signal.butter(2, (2.0, 20.0), "bandpass", fs=RATE_HZ, output="sos")
    accel = signal.sosfilt(band, np.random.default_rng(4).standard_normal(rows_of(60.0)))
    accel *= 7.0 / accel.std()
    rows = np.tile(accel[:, None], (1, 3))
    lost = np.where(np.arange(len(rows)) % rows_of(1.8) < 5, 5, 0)
    meters, whole = SensorMeters("seat", RATE_HZ, WINDOW_S), true_doses(accel, 60.0)
    meters.push(block_of(rows, lost))
    assert 0.95 * whole[0] < meters.vertical().vdv_mps175 < whole[0]
    assert 0.9 * whole[1] < meters.vertical().aw_mps2 < whole[1]


def test_a_loss_in_calm_motion_leaves_every_sample():
    rng = np.random.default_rng(3)
    accel = 0.6 * rng.standard_normal((rows_of(6.0), 3)).clip(-4.0, 4.0)
    lost = np.where(np.arange(len(accel)) % 600 < 50, 50, 0)
    meters, whole = SensorMeters("seat", RATE_HZ, WINDOW_S), SensorMeters("seat", RATE_HZ, WINDOW_S)
    meters.push(block_of(accel, lost))
    whole.push(block_of(accel))
    assert meters.suspect_s() == 0.0 and meters.vertical() == whole.vertical()


def test_a_single_lost_sample_in_a_shock_leaves_every_sample():
    accel = np.tile(naive.half_sine(4.0 * G, SHOCK_S, 3.0, RATE_HZ)[:, None], (1, 3))
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S)
    meters.push(block_of(accel, lost_at(len(accel), rows_of(0.03), rows_of(0.03) + 1)))
    assert meters.suspect_s() == 0.0


# --- one shock with a loss, through the pipeline ---------------------------------------------------------------------


def shock_samples(lost: slice | None, repeats: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and readings of a seat: shocks of 4 g and 20 ms, 4 s apart, with `lost` after the last begins."""
    seconds = SHOCK_BEGIN_S + 4.0 * repeats
    time = np.arange(rows_of(seconds)) / RATE_HZ
    accel = np.zeros((len(time), 3))
    rng = np.random.default_rng(1)
    accel[:] = 0.02 * rng.standard_normal(accel.shape)
    for k in range(repeats):
        u = time - SHOCK_BEGIN_S - 4.0 * k
        accel[:, 2] += np.where((u > 0.0) & (u < SHOCK_S), 4.0 * G * np.sin(np.pi * u / SHOCK_S), 0.0)
    kept = np.ones(len(time), dtype=bool)
    if lost is not None:
        begin = rows_of(seconds - 4.0)
        kept[begin + lost.start : begin + lost.stop] = False
    return stamps(len(time))[kept], raw(accel)[kept]


PEAK_LOST = slice(rows_of(0.01), rows_of(0.055))


def ridden(lost: slice | None, repeats: int = 1, cut: int = 500) -> Pipeline:
    """The seat alone through the pipeline."""
    pipeline = Pipeline(subject())
    times, samples = shock_samples(lost, repeats)
    for at in range(0, len(times), cut):
        pipeline.push("seat", times[at : at + cut], samples[at : at + cut])
    pipeline.finish()
    return pipeline


LOST_S = 40 * (PEAK_LOST.stop - PEAK_LOST.start) / RATE_HZ
"""1.8 s of settling for 45 ms."""


def test_a_shock_with_a_loss_does_not_reach_the_action_value():
    true, found = ridden(None).seat(), ridden(PEAK_LOST).seat()
    assert true.vdv_so_far_mps175 == pytest.approx(7.0, abs=0.1) and true.zone != "above_action_value"
    assert found.zone == "undecided" and found.vdv_so_far_mps175 < true.vdv_so_far_mps175
    assert found.may_be_reached == "action" and found.suspect_s == pytest.approx(LOST_S, abs=0.06)
    assert "VDV is 18.2 m/s^1.75 (action value 9.1) with the 1.85 s after losses" in found.zone_reason
    assert found.lower_bound and found.withheld and found.time_to_action_value_s is None
    assert found.a8_projected_8h_mps2 is None


def test_a_shock_with_a_loss_raises_neither_dri_nor_a_prediction():
    pipeline = ridden(PEAK_LOST)
    true, found = ridden(None).exposure(), pipeline.exposure()
    assert found.dri.compression < true.dri.compression and found.dri.as_printed < true.dri.as_printed
    for name, dose in found.predicted.items():
        assert dose.vdv_mps175 < true.predicted[name].vdv_mps175 and dose.aw_mps2 < true.predicted[name].aw_mps2
        assert dose.seconds == pytest.approx(true.predicted[name].seconds)
    for name, force in found.joint_forces.items():
        assert force.compression_n < true.joint_forces[name].compression_n
        assert force.rms_n < true.joint_forces[name].rms_n
    assert pipeline.predictor.suspect_s() == pytest.approx(LOST_S, abs=0.06)
    assert pipeline.run_status().unpredicted_s == 0.0


def test_a_prediction_does_not_restart_in_the_middle_of_motion():
    # The loss is in a small bump; a large one begins when its two seconds end.
    def bumps(lost: slice | None) -> Pipeline:
        time = np.arange(rows_of(9.0)) / RATE_HZ
        accel = np.zeros((len(time), 3))
        for begin, size in ((3.0, 6.0), (4.93, 20.0)):
            u = time - begin
            accel[:, 2] += np.where((u > 0.0) & (u < 0.2), size * np.sin(2.0 * np.pi * u / 0.2), 0.0)
        kept = np.ones(len(time), dtype=bool)
        if lost:
            kept[lost] = False
        pipeline = Pipeline(subject())
        pipeline.push("seat", stamps(len(time))[kept], raw(accel)[kept])
        pipeline.finish()
        return pipeline

    true, found = bumps(None).exposure(), bumps(slice(rows_of(3.04), rows_of(3.09))).exposure()
    for name, dose in found.predicted.items():
        assert dose.vdv_mps175 < 1.001 * true.predicted[name].vdv_mps175
        assert dose.peak_mps2 < 1.001 * true.predicted[name].peak_mps2


def test_hic_does_not_contain_the_line_over_a_loss():
    rows = np.zeros((rows_of(6.0), 3))
    rows[:, 2] = naive.half_sine(40.0 * G, SHOCK_S, 6.0, RATE_HZ)
    true, meters = SensorMeters("head", RATE_HZ, WINDOW_S), SensorMeters("head", RATE_HZ, WINDOW_S)
    true.push(block_of(rows))
    at, end = rows_of(0.03), rows_of(0.075)  # from the peak on
    rows[at:end, 2] = np.interp(np.arange(at, end), [at - 1, end], rows[[at - 1, end], 2])
    meters.push(block_of(rows, lost_at(len(rows), at, end)))
    assert meters.hic("hic36", rolling=False).resultant < true.hic("hic36", rolling=False).resultant
    assert meters._hics["hic36"].with_suspect().resultant > true.hic("hic36", rolling=False).resultant


# --- what a loss hides, and what restarts ----------------------------------------------------------------------------


def ride(
    accel: np.ndarray,
    lost: slice | None = None,
    of: str = "seat",
    window_s: float = WINDOW_S,
    cut: int = 500,
    reset_at: int | None = None,
) -> Pipeline:
    """Seat and head with the same vertical acceleration (n,), one of them with lost samples."""
    rows = 0.005 * np.random.default_rng(1).standard_normal((len(accel), 3))
    rows[:, 2] += accel
    kept = np.ones(len(rows), dtype=bool)
    if lost is not None:
        kept[lost] = False
    pipeline = Pipeline(subject(), settings=PipelineSettings(window_s=window_s))
    times, readings = stamps(len(rows)), raw(rows)
    for at in range(0, len(rows), cut):
        for name in ("seat", "head"):
            there = kept[at : at + cut] if name == of else np.ones(len(kept[at : at + cut]), dtype=bool)
            if there.any():
                pipeline.push(name, times[at : at + cut][there], readings[at : at + cut][there])
        if reset_at == at + cut:
            pipeline.reset()
    pipeline.finish()
    return pipeline


def ride_with(begin_s: float, lasts_s: float, size_mps2: float, seconds: float = 9.0) -> np.ndarray:
    """Calm motion at 3 Hz with one half-sine, (n,)."""
    time = np.arange(rows_of(seconds)) / RATE_HZ
    u = time - begin_s
    shock = np.where((u > 0.0) & (u < lasts_s), size_mps2 * np.sin(np.pi * u / lasts_s), 0.0)
    return shock + np.where(time > 1.2, 0.3 * np.sin(2.0 * np.pi * 3.0 * time), 0.0)


@pytest.mark.parametrize("lost_s", [0.06, 0.045])
def test_a_shock_whose_peak_is_lost_is_not_called_below_the_action_value(lost_s):
    """A gap or a line hides the peak of 4 g and 100 ms. The counted rest is below the action value."""
    accel = ride_with(5.0, 0.1, 4.0 * G)
    begin = rows_of(5.05 - 0.5 * lost_s)
    true, found = ride(accel).seat(), ride(accel, slice(begin, begin + rows_of(lost_s))).seat(project=True)
    assert true.zone == "above_action_value" and true.vdv_so_far_mps175 == pytest.approx(12.6, abs=0.1)
    assert found.vdv_so_far_mps175 < 9.1 and (found.zone, found.may_be_reached) == ("undecided", "action")
    assert found.vdv_projected_8h_mps175 is None and found.time_to_limit_value_s is None
    assert "with as much in these losses as near them" in found.zone_reason


@pytest.mark.parametrize("lost_s", [(5.02, 5.15), (5.045, 5.13)])
def test_a_gap_to_the_end_of_a_shock_is_not_called_below_the_action_value(lost_s):
    """Nothing after the gap is strong, so nothing is suspect."""
    accel = ride_with(5.0, 0.1, 4.0 * G, 12.0)
    found = ride(accel, slice(*map(rows_of, lost_s))).seat(project=True)
    assert found.suspect_s == 0.0 and found.zone == "undecided" and found.may_be_reached is not None
    assert "with as much in the losses within strong motion as near them" in found.zone_reason
    assert found.time_to_action_value_s is None and found.vdv_projected_8h_mps175 is None


def test_a_loss_that_hides_less_shortens_the_time_left():
    accel = ride_with(5.0, 0.1, 2.8 * G)
    true, found = ride(accel).seat(), ride(accel, slice(rows_of(5.02), rows_of(5.08))).seat(project=True)
    assert true.zone == found.zone == "below_action_value" and true.vdv_so_far_mps175 > 8.5
    assert found.is_estimate and found.time_to_action_value_s < 40.0 and found.vdv_projected_8h_mps175 > 40.0
    assert found.zone_reason.endswith("and with as much in these losses as near them")


def test_a_crest_factor_is_of_the_samples_in_the_figures():
    time = np.arange(rows_of(14.0)) / RATE_HZ
    accel = np.where(time > 1.2, 8.0 * np.sin(2.0 * np.pi * 3.0 * time), 0.0)
    true = ride(accel).exposure().predicted["pelvis"].crest_factor
    found = ride(accel, slice(rows_of(5.0), rows_of(5.1))).exposure().predicted["pelvis"]
    assert found.left_out_s > 1.9 and found.crest_factor == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("lost", [slice(0, 0), slice(3000, 3002), slice(7000, 7060)])
def test_nothing_is_hidden_without_a_loss_in_strong_motion(lost):
    pipeline = ride(ride_with(5.0, 0.1, 4.0 * G), lost)
    meters = pipeline.counter.since_reset()["seat"]
    assert meters.vertical_with_suspect(with_hidden=True) == meters.vertical_with_suspect()


@settings(max_examples=20)
@given(cuts=st.lists(st.integers(0, 3000), max_size=5).map(sorted), seed=st.integers(0, 2**32 - 1))
def test_hidden_motion_is_that_of_its_definition_for_any_cut(cuts, seed):
    rng = np.random.default_rng(seed)
    up, lost = 4.0 * rng.standard_normal(3000), np.zeros(3000, dtype=np.int64)
    near, expected = rows_of(NEAR_S), np.zeros(2)
    for begin in range(200, 2800, 400):
        length = int(rng.integers(1, 60))
        lost[begin : begin + length] = length
        largest = np.abs(up[max(0, begin - near) : begin + length + near]).max()
        if length >= math.ceil(SHORTEST_LOSS_S * RATE_HZ) and largest > STRONG_MPS2:
            expected += length / RATE_HZ * np.array([largest**2, largest**4])
    hidden = HiddenMotion(RATE_HZ)
    for part, of_part in zip(np.split(up, cuts), np.split(lost, cuts), strict=True):
        hidden.push(np.ascontiguousarray(part), of_part)
    assert hidden.powers == pytest.approx(tuple(expected), rel=1e-9)
    other = HiddenMotion(RATE_HZ)
    other.resume(hidden.totals())
    assert other.powers == pytest.approx(hidden.powers)
    hidden.reset()
    assert hidden.powers == (0.0, 0.0)


@pytest.mark.parametrize(
    ("lost_s", "of"), [((3.0, 3.1), "seat"), ((5.12, 5.2), "seat"), ((5.12, 5.18), "head"), ((5.2, 5.3), "head")]
)
def test_no_restart_within_a_shock_raises_a_prediction_or_a_comparison(lost_s, of):
    """A gap 2 s before a shock of 3 g and 0.4 s, so that the prediction settles within it, and gaps within it."""
    accel = ride_with(5.0, 0.4, 3.0 * G)
    true = ride(accel).exposure()
    found = ride(accel, slice(*map(rows_of, lost_s)), of).exposure()
    pairs = [
        *((found.predicted[name], true.predicted[name]) for name in found.predicted),
        *((found.measured_low_passed[name], true.measured_low_passed[name]) for name in found.measured_low_passed),
        *(
            pair
            for name in found.compared
            for pair in zip(found.compared[name], true.compared[name], strict=True)
            if pair[0] is not None
        ),
    ]
    for dose, of_all in pairs:
        assert dose.vdv_mps175 <= 1.01 * of_all.vdv_mps175 and dose.peak_mps2 <= 1.01 * of_all.peak_mps2
        assert dose.mtvv_mps2 <= 1.01 * of_all.mtvv_mps2
    assert found.predicted["pelvis"].seconds > 4.0 and found.measured_low_passed["head"].seconds > 4.0
    left_out = [(dose, of_all) for dose, of_all in pairs if dose.left_out_s > 0.0]
    assert left_out and all(dose.aw_mps2 < of_all.aw_mps2 for dose, of_all in left_out)


@pytest.mark.parametrize("seed", range(8))
def test_no_line_over_a_loss_of_a_body_sensor_raises_its_low_passed_figures(seed):
    """Losses of 4 to 55 samples near the largest shock of `motion`."""
    rng = np.random.default_rng(100 + seed)
    accel = np.concatenate([np.zeros(rows_of(1.5)), motion(rng)])
    count = int(rng.integers(4, 56))
    at = int(np.abs(accel).argmax()) - int(rng.integers(0, count + 20))
    lost = slice(at, at + count)
    found, single = (ride(accel, lost, "head", cut=cut).exposure() for cut in (500, 1 if seed == 0 else 37))
    assert found == single
    true, head = ride(accel).exposure().measured_low_passed["head"], found.measured_low_passed["head"]
    for name in ("vdv_mps175", "aw_mps2", "peak_mps2", "mtvv_linear_mps2", "mtvv_exponential_mps2"):
        assert getattr(head, name) <= 1.02 * getattr(true, name)
    assert head.seconds == pytest.approx(true.seconds, abs=0.01)
    assert 0.1 < head.left_out_s < LONGEST_SETTLING_S + 0.2
    of_head = found.compared["head"]
    assert of_head.measured.left_out_s == of_head.predicted.left_out_s == of_head.seat.left_out_s > 0.0


def test_a_loss_of_a_body_sensor_in_calm_motion_leaves_out_nothing():
    found = ride(ride_with(5.0, 0.1, 2.0), slice(rows_of(5.01), rows_of(5.05)), "head").exposure()
    assert found.measured_low_passed["head"].left_out_s == 0.0


def test_the_seconds_in_which_a_weighting_settles_are_stated():
    pipeline = ride(ride_with(5.0, 0.4, 3.0 * G), slice(rows_of(5.12), rows_of(5.18)), "head")
    head = exposure_document(exposure_report(pipeline))["measured_low_passed"]["head"]
    assert head["aw_lower_bound"] and head["suspect_s"] == pytest.approx(2.0, abs=0.1)
    monitor = HealthMonitor(pipeline, {name: SensorHealth(now=lambda: 0.0) for name in SENSORS})
    rows = SnapshotBuilder(5.0).snapshot(pipeline, monitor.check(), ())["rows"]
    (row,) = (row for row in rows if row["name"] == "head")
    assert row["measured_lower_bound"] and row["predicted_lower_bound"]


def test_a_gap_of_the_seat_raises_no_compared_figure_of_another_sensor():
    """The head moves strongly, the seat weakly: its gap restarts both."""
    accel = ride_with(5.0, 0.4, 3.0 * G)
    weak = 0.05 * accel
    rows = np.zeros((2, len(accel), 3))
    rows[:, :, 2] = weak, accel
    kept = np.ones(len(accel), dtype=bool)
    kept[rows_of(5.12) : rows_of(5.22)] = False
    doses_of_head = []
    for of_seat in (np.ones_like(kept), kept):
        pipeline = Pipeline(subject())
        for at in range(0, len(accel), 500):
            here = slice(at, at + 500)
            if of_seat[here].any():
                pipeline.push("seat", stamps(len(accel))[here][of_seat[here]], raw(rows[0])[here][of_seat[here]])
            pipeline.push("head", stamps(len(accel))[here], raw(rows[1])[here])
        pipeline.finish()
        doses_of_head.append(pipeline.exposure().measured_low_passed["head"])
    true, found = doses_of_head
    assert found.peak_mps2 <= 1.01 * true.peak_mps2 and found.vdv_mps175 <= true.vdv_mps175
    assert found.left_out_s == pytest.approx(2.0, abs=0.1)


def test_a_record_that_begins_in_a_shock_has_no_low_passed_dose_of_its_restart():
    time = np.arange(rows_of(6.0)) / RATE_HZ
    rows = np.tile((5.0 * np.cos(2.0 * np.pi * 3.0 * time) * (time < 3.0))[:, None], (1, 3)) * [0.0, 0.0, 1.0]
    known = Gravity((0.0, 0.0, G_STANDARD), "session")
    pipeline = Pipeline(subject(), gravity={"seat": known})
    pipeline.push("seat", stamps(len(rows)), raw(rows))
    pipeline.finish()
    exposure = pipeline.exposure()
    low_passed, sensor = exposure.measured_low_passed["seat"], exposure.sensors["seat"]
    assert low_passed.vdv_mps175 == pytest.approx(sensor.vdv_mps175, rel=0.05)


def test_channels_of_which_nothing_is_counted_are_absent():
    pipeline = ride(ride_with(5.0, 0.1, 2.0), slice(rows_of(7.0), rows_of(7.2)), window_s=1.0)
    assert "head" in pipeline.exposure().predicted
    assert not pipeline.exposure(rolling=True).predicted and "seat" in pipeline.exposure(rolling=True).sensors
    apart = Pipeline(subject())
    samples = raw(np.zeros((rows_of(4.0), 3)))
    for name, hours in (("seat", 0), ("head", 1)):
        apart.push(name, stamps(len(samples)) + hours * 3_600_000_000_000, samples)
    apart.finish()
    assert "head" not in apart.exposure().measured_low_passed and "head" in apart.exposure().sensors


@pytest.mark.parametrize("cut", [10, 97, 485])
def test_cuts_change_no_rolling_figure_after_a_reset(cut):
    accel = ride_with(6.8, 0.2, 25.0)
    whole, other = (ride(accel, cut=each, reset_at=7760) for each in (970, cut))
    for name, dose in whole.exposure(rolling=True).measured_low_passed.items():
        found = other.exposure(rolling=True).measured_low_passed[name]
        assert found.mtvv_mps2 == pytest.approx(dose.mtvv_mps2, rel=1e-9)


def test_shocks_without_a_loss_reach_the_action_value_all_the_same():
    # Five complete shocks have a VDV of 7.0 times the fourth root of five, 10.5.
    found = ridden(PEAK_LOST, repeats=6).seat()
    assert found.zone == "above_action_value"
    assert found.vdv_so_far_mps175 == pytest.approx(7.0 * 5.0**0.25, rel=0.02)


def test_cuts_change_no_figure_after_a_loss():
    whole, single = ridden(PEAK_LOST), ridden(PEAK_LOST, cut=1)
    assert whole.seat() == single.seat() and whole.exposure() == single.exposure()


def test_the_losses_name_the_suspect_seconds_until_a_reset():
    pipeline = ridden(PEAK_LOST)
    assert pipeline.losses("seat").suspect_s == pytest.approx(LOST_S, abs=0.06)
    pipeline.reset()
    assert pipeline.losses("seat").suspect_s == 0.0 and not pipeline.losses("seat").lower_bound


def test_measured_and_predicted_doses_leave_out_the_same_samples():
    pipeline = ridden(PEAK_LOST)
    measured, predicted = pipeline.exposure().measured_low_passed["seat"], pipeline.exposure().predicted["pelvis"]
    true = ridden(None).exposure().measured_low_passed["seat"]
    assert measured.vdv_mps175 < true.vdv_mps175 and measured.aw_mps2 < true.aw_mps2
    assert measured.seconds == pytest.approx(predicted.seconds, abs=0.05)
    document = exposure_document(exposure_report(pipeline))
    found = document["measured_low_passed"]["seat"]
    assert found["lower_bound"] and found["suspect_s"] == pytest.approx(LOST_S, abs=0.06)


def test_a_segment_without_a_sensor_is_compared_with_the_seat_over_the_same_samples():
    compared = ride(ride_with(5.0, 0.4, 3.0 * G), slice(rows_of(4.0), rows_of(4.1))).exposure().compared
    assert compared["central_torso"].measured is None and compared["head"].measured is not None
    for one in compared.values():
        assert (one.predicted.seconds, one.predicted.left_out_s) == (one.seat.seconds, one.seat.left_out_s)
        assert 5.0 < one.predicted.seconds < 6.5  # of 9 s, without rest, gap and the 2 s after it


def test_rolling_figures_of_suspect_samples_alone_are_absent():
    times, samples = shock_samples(PEAK_LOST)
    pipeline = Pipeline(subject(), settings=PipelineSettings(window_s=0.5))
    end = rows_of(SHOCK_BEGIN_S + 1.0)
    pipeline.push("seat", times[:end], samples[:end])
    rolling, since = pipeline.exposure(rolling=True), pipeline.exposure()
    assert not rolling.sensors and not rolling.predicted and rolling.dri is None
    assert since.sensors["seat"].seconds > 2.0 and since.predicted
    pipeline.push("seat", times[end:], samples[end:])
    assert pipeline.exposure(rolling=True).sensors["seat"].seconds == pytest.approx(0.5, abs=0.11)


def test_rolling_figures_have_no_suspect_samples_either():
    pipeline = ridden(PEAK_LOST)
    rolling, since = pipeline.exposure(rolling=True), pipeline.exposure()
    assert rolling.sensors["seat"].vdv_mps175 == pytest.approx(since.sensors["seat"].vdv_mps175)
    assert rolling.dri.compression == since.dri.compression


@pytest.mark.parametrize("at_s", [3.2, 4.0, 6.0])
def test_a_restart_keeps_sure_and_suspect_exposure_apart(at_s):
    times, samples = shock_samples(PEAK_LOST)
    first, second = ContinuedExposure(Pipeline(subject())), ContinuedExposure(Pipeline(subject()))
    at = rows_of(at_s) - (PEAK_LOST.stop - PEAK_LOST.start)
    first.push("seat", times[:at], samples[:at])
    stored = json.loads(json.dumps(first.checkpoint({"a": "b"}).to_dict()))
    second.resume(ExposureCheckpoint.from_dict(stored))
    before, after = first.pipeline.seat(), second.pipeline.seat()
    assert after.vdv_so_far_mps175 == pytest.approx(before.vdv_so_far_mps175)
    assert second.pipeline.losses("seat").suspect_s == pytest.approx(first.pipeline.losses("seat").suspect_s)
    second.push("seat", times[at:], samples[at:])
    second.finish()
    ended = second.pipeline.seat()
    assert ended.zone == "undecided" and "VDV is 18.2" in ended.zone_reason
    assert ended.vdv_so_far_mps175 < 7.0


@pytest.mark.parametrize(
    ("totals", "message"),
    [
        (np.zeros((3, 3)), r"vertical \(suspect\): the stored totals have shape \(3, 3\), \(1, 7\) is needed"),
        (np.full((1, 7), -1.0), r"vertical \(suspect\): a stored sum of powers is below zero"),
    ],
)
def test_stored_totals_of_suspect_samples_that_do_not_fit_are_refused(totals, message):
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S)
    with pytest.raises(InputError, match=message):
        meters.resume({"vertical (suspect)": totals}, 0.0)
