"""Suspect samples: a loss within strong motion never raises a figure that is a lower bound, and decides no zone."""

from __future__ import annotations

import json
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
from biodyn_core.conditioning.conditioned import Block
from biodyn_core.exposure.checkpoint import ExposureCheckpoint
from biodyn_core.exposure.sensor_meters import SensorMeters
from biodyn_core.exposure.suspect import NEAR_S, SETTLING_S, SHORTEST_LOSS_S, STRONG_MPS2, SuspectSamples
from biodyn_core.pipeline.continued_exposure import ContinuedExposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.signals.weighting import weighting_sections

WINDOW_S = 60.0
G = naive.GRAVITY
SHOCK_BEGIN_S, SHOCK_S = 3.0, 0.02


def rows_of(seconds: float) -> int:
    """The number of samples in a time."""
    return round(seconds * RATE_HZ)


def block_of(rows: np.ndarray, filled: np.ndarray | None = None, begins_run: bool = False, gap_s: float = 0.0) -> Block:
    """Levelled samples (n, 3) as a block."""
    none = np.empty(0)
    return Block(none.astype(np.int64), none, rows, none, begins_run, gap_s, 0, RATE_HZ, 100.0, filled)


# --- flags -----------------------------------------------------------------------------------------------------------


def flagged(rows: np.ndarray, filled: np.ndarray, follows_loss: bool) -> np.ndarray:
    """The flags by their definition, with a look at all rows for each one."""
    near, lasting, shortest = (
        round(NEAR_S * RATE_HZ),
        round(SETTLING_S * RATE_HZ),
        int(np.ceil(SHORTEST_LOSS_S * RATE_HZ)),
    )
    strong = np.flatnonzero((np.abs(rows) > STRONG_MPS2).any(axis=1))
    at = np.arange(len(rows))
    lost = np.flatnonzero([n >= shortest - 1 and filled[n - shortest + 1 : n + 1].all() for n in at])
    begins = [n for n in lost if ((strong <= n) & (strong >= n - near)).any()]
    losses = np.append(lost, 0) if follows_loss else lost
    begins += [n for n in strong if ((losses <= n) & (losses >= n - near)).any()]
    suspect = np.zeros(len(rows), dtype=bool)
    for n in begins:
        suspect[n : n + lasting] = True
    return suspect


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    follows_loss=st.booleans(),
    cuts=st.lists(st.integers(0, 6000), max_size=6).map(sorted),
)
def test_flags_are_those_of_the_definition_for_any_cut(seed, follows_loss, cuts):
    rng = np.random.default_rng(seed)
    rows, filled = rng.uniform(-2.9, 2.9, (6000, 3)), np.zeros(6000, dtype=bool)
    for at in rng.integers(0, 6000, rng.integers(0, 4)):
        rows[at, rng.integers(3)] = rng.choice([-3.1, 40.0])
        near = int(at) + int(rng.integers(-80, 80))
        filled[max(near, 0) : max(near, 0) + rng.integers(1, 57)] = True
    samples = SuspectSamples(RATE_HZ)
    samples.begin_run(follows_loss)
    parts = zip(np.split(rows, cuts), np.split(filled, cuts), strict=True)
    found = np.concatenate([samples.flags(part, of_them) for part, of_them in parts])
    np.testing.assert_array_equal(found, flagged(rows, filled, follows_loss))


@pytest.mark.parametrize("mode", ["causal", "zero_phase"])
@pytest.mark.parametrize("cuts", [(), range(1, 4000), (1500, 2290, 2300)])
def test_blocks_have_the_interpolated_samples(mode, cuts):
    times, samples = stamps(4000), raw(np.zeros((4000, 3)) + 0.1 * np.sin(np.arange(4000.0))[:, None])
    kept = np.r_[0:2285, 2310:3000, 3001:3990]
    found = Conditioned(times[kept], samples[kept], [cut for cut in cuts if cut < len(kept)], mode=mode)
    flags = np.concatenate([block.filled_flags for block in found.blocks])
    first = 4000 - 10 - len(flags)  # conditioned samples begin after the rest
    np.testing.assert_array_equal(np.flatnonzero(flags) + first, [*range(2285, 2310), 3000])
    assert [block.filled_flags.tolist() for block in found.blocks] == [
        block.part(0, len(block.time_s)).filled_flags.tolist() for block in found.blocks
    ]


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


def with_a_loss(accel: np.ndarray, rng: np.random.Generator) -> list[Block]:
    """The motion on all axes as blocks: a line over up to 50 ms, or a gap of up to 0.4 s."""
    at, rows = rows_of(rng.uniform(2.9, 4.2)), np.tile(accel[:, None], (1, 3))
    if rng.random() < 0.7:
        end = at + int(rng.integers(1, 56))
        filled = (np.arange(len(rows)) >= at) & (np.arange(len(rows)) < end)
        rows[filled] = np.interp(np.arange(at, end), [at - 1, end], accel[[at - 1, end]])[:, None]
        return [block_of(rows, filled, begins_run=True)]
    end = at + int(rng.integers(60, 450))
    return [block_of(rows[:at], begins_run=True), block_of(rows[end:], begins_run=True, gap_s=(end - at) / RATE_HZ)]


def doses(meters: SensorMeters, suspect: bool) -> np.ndarray:
    """VDV and root of the squared integral by Wk and along x by Wd, (4,)."""
    up = meters.vertical_with_suspect() if suspect else meters.vertical()
    aw, vdv = meters.plane().along([0.0], suspect=suspect)
    return np.array([up.vdv_mps175, up.aw_mps2 * up.seconds**0.5, vdv[0], aw[0] * up.seconds**0.5])


def true_doses(accel: np.ndarray) -> np.ndarray:
    """The same of the complete motion, by scipy."""
    found = []
    for name in ("Wk", "Wd"):
        weighted = signal.sosfilt(weighting_sections(name, RATE_HZ), accel)
        found += [np.sum(weighted**4) ** 0.25 / RATE_HZ**0.25, np.sum(weighted**2) ** 0.5 / RATE_HZ**0.5]
    return np.array(found)


@cache
def excess() -> tuple[np.ndarray, np.ndarray]:
    """Doses over the true ones, without and with suspect samples, of 200 motions with a loss, (200, 4) each."""
    rng = np.random.default_rng(21)
    without, with_them = [], []
    for _ in range(200):
        accel = motion(rng)
        meters, true = SensorMeters("seat", RATE_HZ, WINDOW_S), true_doses(accel)
        for block in with_a_loss(accel, rng):
            meters.push(block)
        without.append(doses(meters, False) - 1.04 * true)
        with_them.append(doses(meters, True) - 1.04 * true)
    return np.array(without), np.array(with_them)


def test_no_loss_raises_a_dose_above_the_true_one():
    without, with_them = excess()
    assert without.max() < 0.01
    assert (with_them.max(axis=0) > 0.3).all()  # the losses are such that could


def test_a_loss_in_calm_motion_leaves_every_sample():
    rng = np.random.default_rng(3)
    accel = 0.6 * rng.standard_normal((rows_of(6.0), 3)).clip(-4.0, 4.0)
    filled = np.arange(len(accel)) % 600 < 50
    meters, whole = SensorMeters("seat", RATE_HZ, WINDOW_S), SensorMeters("seat", RATE_HZ, WINDOW_S)
    meters.push(block_of(accel, filled))
    whole.push(block_of(accel))
    assert meters.suspect_s() == 0.0 and meters.vertical() == whole.vertical()


def test_a_single_lost_sample_in_a_shock_leaves_every_sample():
    accel = np.tile(naive.half_sine(4.0 * G, SHOCK_S, 3.0, RATE_HZ)[:, None], (1, 3))
    filled = np.arange(len(accel)) == rows_of(0.03)
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S)
    meters.push(block_of(accel, filled))
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


def test_a_shock_with_a_loss_does_not_reach_the_action_value():
    true, found = ridden(None).seat(), ridden(PEAK_LOST).seat()
    assert true.vdv_so_far_mps175 == pytest.approx(7.0, abs=0.1) and true.zone != "above_action_value"
    assert found.zone == "undecided" and found.vdv_so_far_mps175 < true.vdv_so_far_mps175
    assert "VDV is 9.47 m/s^1.75 (action value 9.1) with the 2.04 s after losses" in found.zone_reason
    assert found.lower_bound and found.withheld and found.time_to_action_value_s is None
    assert found.a8_projected_8h_mps2 is None


def test_a_shock_with_a_loss_raises_neither_dri_nor_a_prediction():
    true, found = (one.exposure() for one in (ridden(None), ridden(PEAK_LOST)))
    assert found.dri.compression < true.dri.compression and found.dri.as_printed < true.dri.as_printed
    for name, dose in found.predicted.items():
        assert dose.vdv_mps175 < true.predicted[name].vdv_mps175
    for name, force in found.joint_forces.items():
        assert force.compression_n < true.joint_forces[name].compression_n
    assert ridden(PEAK_LOST).run_status().unpredicted_s == pytest.approx(SETTLING_S + 0.04, abs=0.01)


def test_hic_does_not_contain_the_line_over_a_loss():
    rows = np.zeros((rows_of(6.0), 3))
    rows[:, 2] = naive.half_sine(40.0 * G, SHOCK_S, 6.0, RATE_HZ)
    true, meters = SensorMeters("head", RATE_HZ, WINDOW_S), SensorMeters("head", RATE_HZ, WINDOW_S)
    true.push(block_of(rows))
    at, end = rows_of(0.03), rows_of(0.075)  # from the peak on
    filled = (np.arange(len(rows)) >= at) & (np.arange(len(rows)) < end)
    rows[filled] = np.interp(np.arange(at, end), [at - 1, end], rows[[at - 1, end], 2])[:, None] * [0.0, 0.0, 1.0]
    meters.push(block_of(rows, filled))
    assert meters.hic("hic36", rolling=False).resultant < true.hic("hic36", rolling=False).resultant
    assert meters._hics["hic36"].with_suspect().resultant > true.hic("hic36", rolling=False).resultant


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
    assert pipeline.losses("seat").suspect_s == pytest.approx(SETTLING_S + 0.04, abs=0.01)
    pipeline.reset()
    assert pipeline.losses("seat").suspect_s == 0.0 and not pipeline.losses("seat").lower_bound


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
    assert ended.zone == "undecided" and "VDV is 9.4" in ended.zone_reason
    assert ended.vdv_so_far_mps175 < 7.0


def test_stored_totals_of_suspect_samples_that_do_not_fit_are_refused():
    meters = SensorMeters("seat", RATE_HZ, WINDOW_S)
    with pytest.raises(InputError, match="suspect totals have shape"):
        meters.resume({"vertical (suspect)": np.zeros((3, 3))}, 0.0)
