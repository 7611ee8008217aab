"""Dual range: interpolation, comparison and merging, against pulses and sines in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from trident import HIGH_HZ, LOW_HZ, RAIL, G, Wide, high_g, low_g, shock

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.dual_range import (
    FADE,
    HIGH_RAIL_MPS2,
    MARGIN,
    MIN_AGREEMENT,
    DualRangeSettings,
    Span,
    Stretch,
    covered,
    merged,
    read_at,
    read_wide,
    saturated,
    shares,
    spans,
    usable,
)
from biodyn_core.conditioning.range_alignment import (
    DELAY_TOLERANCE_S,
    GAIN_TOLERANCE,
    Alignment,
    align,
    bias,
    corrected,
    levels,
    plausible,
    variance,
)

SETTINGS = DualRangeSettings()
PERIOD_S = 1.0 / LOW_HZ


def stretch_of(wide: Wide, seconds: float = 8.0, peak_g: float = 60.0, seed: int = 0, ride: bool = True) -> Stretch:
    motion = shock((3.0,), peak_g)
    rng = np.random.default_rng(seed)
    t = (0.0 if ride else -20.0) + np.arange(0.0, seconds, PERIOD_S)
    th = t[0] + 0.0137 + np.arange(0.0, seconds - 0.03, 1.0 / HIGH_HZ)
    return Stretch(t, low_g(motion, t, rng), th, high_g(motion, th, wide, rng), LOW_HZ)


def found_in(stretch: Stretch) -> list[Span]:
    sides = saturated(stretch.low_mps2, SETTINGS)
    hit = np.flatnonzero(sides.any(axis=1))
    return spans(hit, stretch.low_s[hit], sides[hit])


# --- reading between samples ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hz", "error"), [(5.0, 5e-4), (20.0, 5e-4), (100.0, 5e-4), (200.0, 5e-4), (300.0, 1e-3), (400.0, 6e-3)]
)
def test_sines_are_read_between_samples(hz: float, error: float) -> None:
    th, t = np.arange(0.0, 1.0, 1.0 / HIGH_HZ), np.arange(0.05, 0.95, PERIOD_S)
    read = read_at(th, np.sin(2 * np.pi * hz * th)[:, None], t, LOW_HZ)[:, 0]
    assert np.abs(read - np.sin(2 * np.pi * hz * t)).max() < error


@pytest.mark.parametrize("hz", [575.0, 620.0, 700.0, 790.0])
def test_frequencies_above_the_slower_nyquist_do_not_alias(hz: float) -> None:
    th, t = np.arange(0.0, 1.0, 1.0 / HIGH_HZ), np.arange(0.05, 0.95, PERIOD_S)
    straight = np.interp(t, th, np.sin(2 * np.pi * hz * th))
    read = read_at(th, np.sin(2 * np.pi * hz * th)[:, None], t, LOW_HZ)
    assert np.abs(read).max() < 0.002 < np.abs(straight).max()


@pytest.mark.parametrize(
    ("width_s", "at_edges", "at_top"), [(0.005, 0.05, 0.025), (0.011, 0.04, 0.002), (0.03, 0.01, 1e-4)]
)
def test_a_half_sine_is_read_but_for_its_corners(width_s: float, at_edges: float, at_top: float) -> None:
    """The slope of a half-sine jumps at its ends, which no band carries: the error there is stated, not hidden."""
    th, t = np.arange(0.0, 1.0, 1.0 / HIGH_HZ), np.arange(0.1, 0.9, 1e-4)

    def pulse(at: np.ndarray) -> np.ndarray:
        phase = (at - 0.5) / width_s
        return np.where((phase > 0) & (phase < 1), np.sin(np.pi * np.clip(phase, 0, 1)), 0.0)

    off = np.abs(read_at(th, pulse(th)[:, None], t, LOW_HZ)[:, 0] - pulse(t))
    assert off.max() < at_edges
    assert off[np.abs(t - 0.5 - width_s / 2) < 1e-3].max() < at_top


def test_a_constant_stays_a_constant_at_any_instant() -> None:
    th = np.arange(0.0, 1.0, 1.0 / HIGH_HZ)
    read = read_at(th, np.full((th.size, 3), 7.0), np.random.default_rng(1).uniform(0.1, 0.9, 500), LOW_HZ)
    assert np.abs(read - 7.0).max() < 1e-12


def test_nothing_is_read_beyond_the_ends_across_a_gap_or_beside_a_loss() -> None:
    th = np.arange(0.0, 1.0, 1.0 / HIGH_HZ)
    values = np.ones((th.size, 1))
    values[1200] = np.nan
    kept = (th < 0.3) | (th > 0.31)
    t = np.arange(-0.1, 1.1, PERIOD_S)
    there = np.isfinite(read_at(th[kept], values[kept], t, LOW_HZ)[:, 0])
    reach = 16 / HIGH_HZ
    for lost_s, until_s in ((-1.0, reach - 1 / HIGH_HZ), (0.3, 0.31), (th[1200], th[1200]), (1.0 - reach, 2.0)):
        assert not there[(t > lost_s) & (t < until_s)].any()
    assert there[(t > 0.02) & (t < 0.29)].all() and there[(t > 0.33) & (t < 0.73)].all()
    assert not np.isfinite(read_at(th[:20], values[:20], t, LOW_HZ)).any()


def test_channels_on_the_same_instants_are_matched_not_filtered() -> None:
    t = np.arange(100) / 250.0
    high = np.random.default_rng(2).standard_normal((100, 3))
    kept = np.arange(100) != 50
    read = read_wide(Stretch(t, high, t[kept], high[kept], 250.0, shared=True), 0.0)
    assert np.array_equal(read[kept], high[kept]) and np.isnan(read[50]).all()


def test_high_g_at_its_own_rail_is_no_reading() -> None:
    t = np.arange(100) / 250.0
    high = np.zeros((100, 3))
    high[40, 1] = HIGH_RAIL_MPS2
    read = read_wide(Stretch(t, high, t, high, 250.0, shared=True), 0.0)
    assert np.isnan(read[40, 1]) and np.isfinite(read[40, [0, 2]]).all()


# --- saturations ------------------------------------------------------------------------------------------------------


def test_spans_are_consecutive_samples_of_one_axis_and_side() -> None:
    low = np.zeros((20, 3))
    low[3:6, 2] = RAIL
    low[6, 2] = -RAIL
    low[10, 2] = low[4:9, 0] = RAIL
    low[15, 1] = np.nan
    t = np.arange(20.0)
    sides = saturated(low, SETTINGS)
    hit = np.flatnonzero(sides.any(axis=1))
    expected = [Span(2, 1, 3.0, 5.0), Span(0, 1, 4.0, 8.0), Span(2, -1, 6.0, 6.0), Span(2, 1, 10.0, 10.0)]
    assert spans(hit, t[hit], sides[hit]) == expected
    assert spans(np.empty(0, dtype=np.int64), np.empty(0), np.empty((0, 3), dtype=np.int8)) == []


def test_samples_near_a_rail_or_a_loss_are_excluded() -> None:
    low = np.zeros((100, 3))
    low[40, 1], low[80, 0] = -RAIL, np.nan
    good = usable(low, SETTINGS)
    assert not good[24:57].any() and not good[64:97].any()
    assert good[:24].all() and good[57:64].all() and good[97:].all()


# --- comparing --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("gain", "delay_s"), [(1.0, 0.0), (1.04, 0.0031), (0.96, -0.0044), (1.0, 0.0123)])
def test_bias_gain_and_delay_are_recovered(gain: float, delay_s: float) -> None:
    wide = Wide(gain=gain, delay_s=delay_s)
    stretch = stretch_of(wide)
    found = align([stretch], SETTINGS)
    assert np.abs(np.array(found.gain) - gain).max() < 0.02
    assert found.gain[2] == pytest.approx(gain, abs=0.008)
    assert found.delay_s == pytest.approx(delay_s, abs=0.0003)
    assert found.delay_measured == (delay_s != 0.0)
    means = levels(stretch, SETTINGS)
    assert means is not None
    # A gain that is off by so much of gravity is a bias that is off by it.
    assert np.abs(bias(means, found) - wide.bias).max() < 0.03 + 0.008 * G
    step = 400.0 * G / 4096.0
    assert found.noise_mps2 == pytest.approx(
        [np.hypot(0.6, step / np.sqrt(12)) * np.sqrt(2 * 484 / HIGH_HZ)] * 3, rel=0.1
    )


def test_a_noisy_channel_does_not_shrink_its_own_gain() -> None:
    """The noise is larger than the motion: regressed the other way round the gain would come out below a half."""
    stretch = stretch_of(Wide(gain=1.05, noise=4.0), seconds=50.0)
    good = usable(stretch.low_mps2, SETTINGS) & (stretch.low_s > 1.5)
    high = read_wide(stretch, 0.0)[:, 2]
    both = good & np.isfinite(high)
    assert 1.0 / np.polyfit(high[both], stretch.low_mps2[both, 2], 1)[0] > 2.0
    assert align([stretch], DualRangeSettings()).gain[2] == pytest.approx(1.05, abs=0.03)


def test_a_body_at_rest_supports_neither_gain_nor_delay() -> None:
    stretch = stretch_of(Wide(gain=1.05, delay_s=0.003), ride=False)
    found = align([stretch], SETTINGS)
    assert found.gain == (1.0, 1.0, 1.0) and found.delay_s == 0.0
    assert found.measured == (False, False, False) and not found.delay_measured
    assert found.determined == (False, False, False) and not found.delay_determined
    assert found.gain_error == (GAIN_TOLERANCE,) * 3 and found.delay_error_s == DELAY_TOLERANCE_S
    means = levels(stretch, SETTINGS)
    assert means is not None and bias(means, found)[2] == pytest.approx(9.0 + 0.05 * G, abs=0.03)


def test_without_a_comparison_gain_and_delay_stay_nominal() -> None:
    none = Stretch(np.empty(0), np.empty((0, 3)), np.empty(0), np.empty((0, 3)), LOW_HZ)
    assert align([], SETTINGS) == align([none], SETTINGS) == Alignment()
    assert levels(none, SETTINGS) is None


def test_channels_of_two_sensors_are_implausible() -> None:
    one, other = stretch_of(Wide()), stretch_of(Wide(gain=0.6))
    assert plausible(align([one], SETTINGS)) and not plausible(align([other], SETTINGS))


def test_a_gain_of_one_and_a_delay_of_zero_can_be_determined() -> None:
    found = align([stretch_of(Wide())], SETTINGS)
    assert found.gain[2] == 1.0 and not found.measured[2] and found.determined[2]
    assert found.delay_s == 0.0 and not found.delay_measured and found.delay_determined
    assert 0.0 < found.gain_error[2] < 0.02 and 0.0 < found.delay_error_s < 0.0005


def test_a_variance_contains_noise_and_the_errors_of_gain_and_delay() -> None:
    t = np.arange(400) * PERIOD_S
    values = np.column_stack([0.0 * t, np.full_like(t, 200.0), 1000.0 * t])
    stretch = Stretch(t, values, t, values, LOW_HZ)
    own = Alignment(noise_mps2=(0.5, 0.5, 0.5), gain_error=(0.1, 0.1, 0.0), delay_error_s=0.002)
    found = np.sqrt(variance(stretch, own, values))
    assert found[:, 0] == pytest.approx(0.5)
    assert found[:, 1] == pytest.approx(np.hypot(0.5, 20.0))
    assert found[5:-5, 2] == pytest.approx(np.hypot(0.5, 2.0))
    values[50, 1] = np.nan  # a reading that the wide channel lacks
    again = np.sqrt(variance(stretch, own, values))
    assert np.isnan(again[50, 1]) and np.isfinite(np.delete(again[:, 1], 50)).all()
    assert variance(Stretch(t[:0], values[:0], t, values, LOW_HZ), own, values[:0]).shape == (0, 3)


# --- taking over ------------------------------------------------------------------------------------------------------


def test_the_share_is_one_at_the_rail_and_its_margin_and_fades_smoothly() -> None:
    t = np.arange(60) * PERIOD_S
    share = shares(t, PERIOD_S, [Span(1, 1, float(t[20]), float(t[29]))])
    assert (share[:, [0, 2]] == 0.0).all()
    assert (share[20 - MARGIN : 30 + MARGIN, 1] == 1.0).all()
    fade = share[30 + MARGIN : 30 + MARGIN + FADE, 1]
    assert (np.diff(fade) < 0).all() and 0.0 < fade[-1] < 0.15 and fade[0] < 1.0
    assert fade == pytest.approx(0.5 + 0.5 * np.cos(np.pi * np.arange(1, FADE + 1) / (FADE + 1)), abs=1e-9)
    assert share[20 - MARGIN - FADE : 20 - MARGIN, 1] == pytest.approx(fade[::-1], abs=1e-9)
    assert (share[: 20 - MARGIN - FADE] == 0.0).all() and (share[30 + MARGIN + FADE :] == 0.0).all()


def test_the_share_is_the_same_for_any_cut() -> None:
    t = np.arange(200) * PERIOD_S
    taken = [Span(0, 1, float(t[50]), float(t[60])), Span(2, -1, float(t[66]), float(t[66]))]
    parts = [shares(part, PERIOD_S, taken) for part in np.split(t, [3, 49, 57, 58, 64, 70])]
    assert np.array_equal(np.concatenate(parts), shares(t, PERIOD_S, taken))


@pytest.mark.parametrize("peak_g", [20.0, 60.0, 150.0])
def test_a_shock_beyond_the_rail_is_recovered(peak_g: float) -> None:
    wide = Wide(gain=1.03, delay_s=0.0031)
    stretch = stretch_of(wide, peak_g=peak_g)
    found = align([stretch], SETTINGS)
    means = levels(stretch, SETTINGS)
    assert means is not None
    right = corrected(stretch, found, bias(means, found))
    kept = covered(found_in(stretch), stretch, right, SETTINGS)
    assert [span.axis for span in kept] == [2]
    share = shares(stretch.low_s, PERIOD_S, kept)
    result = merged(stretch.low_mps2, right, share)
    truth = shock((3.0,), peak_g)(stretch.low_s)
    peak = peak_g * G
    assert stretch.low_mps2[:, 2].max() < RAIL < 0.9 * peak
    used = share[:, 2] == 1.0
    # Bias, 0.3 ms of delay on the steepest flank, a percent of gain, and four sigma of noise.
    steepest = np.pi / 0.011 * peak
    assert np.abs(result[used, 2] - truth[used, 2]).max() < 0.1 + 0.0001 * steepest + 0.02 * peak + 4 * 0.6
    assert result[:, 2].max() == pytest.approx(truth[:, 2].max(), rel=0.015, abs=2.4)
    untouched = share == 0.0
    assert np.array_equal(result[untouched], stretch.low_mps2[untouched])
    # The impulse, which is what the body feels, to a percent and a half.
    near = np.abs(stretch.low_s - 3.0055) < 0.02
    assert (result - truth)[near, 2].sum() == pytest.approx(0.0, abs=0.015 * truth[near, 2].sum())


def test_a_span_is_taken_over_only_where_high_g_is_there_and_agrees() -> None:
    stretch = stretch_of(Wide())
    found = found_in(stretch)
    right = read_wide(stretch, 0.0) - np.array(Wide().bias)
    assert covered(found, stretch, right, SETTINGS) == found
    lost = right.copy()
    lost[np.searchsorted(stretch.low_s, found[0].end_s) + MARGIN, 2] = np.nan
    assert covered(found, stretch, lost, SETTINGS) == []
    assert covered(found, stretch, np.minimum(right, 0.99 * MIN_AGREEMENT * RAIL), SETTINGS) == []
    assert covered(found, stretch, -right, SETTINGS) == []


@pytest.mark.parametrize(
    ("name", "value"), [("saturation_mps2", 1.0), ("compared_s", 0.0), ("saturation_mps2", np.nan)]
)
def test_settings_out_of_range_are_named(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        DualRangeSettings(**{name: value})


def test_a_shared_wide_channel_without_a_sample_is_unknown_everywhere():
    t, low = np.arange(5) / 250.0, np.ones((5, 3))
    for kept, known in (([], []), ([1, 3], [1, 3])):
        read = read_wide(Stretch(t, low, t[kept], 2.0 * low[kept], 250.0, shared=True), 0.0)
        expected = np.full((5, 3), np.nan)
        expected[known] = 2.0
        np.testing.assert_array_equal(read, expected)
