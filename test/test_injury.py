"""Injury criteria: DRI and HIC against published values, closed forms, another integrator and brute force."""

from __future__ import annotations

import csv
import math

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biodyn_core.exposure.injury import DRI_BANDS, Dri, DriMeter, HicMeter

RATE_HZ = 1129.3
WINDOW_S = 2.0
SEEDS = st.integers(0, 2**32 - 1)
ROUNDING = 1e-9


def dri(accel: np.ndarray, rate_hz: float = RATE_HZ) -> Dri:
    """The DRI of a seat (n,) m/s^2."""
    meter = DriMeter(rate_hz, WINDOW_S)
    meter.push(accel.reshape(-1, 1))
    return meter.since_reset()


def hic(accel_g: np.ndarray, rate_hz: float, length_s: float = 0.015):
    """The HIC of a head (n, 3) g."""
    meter = HicMeter(rate_hz, length_s, WINDOW_S)
    meter.push(accel_g * naive.GRAVITY)
    return meter.since_reset()


def vertical(accel_g: np.ndarray) -> np.ndarray:
    """A head that moves up and down only, (n, 3)."""
    return np.column_stack([np.zeros((len(accel_g), 2)), accel_g])


# --- DRI -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("peak_g", "compression"), [(-5.0, 3.08), (5.0, 6.47)])
def test_a_downward_pulse_counts_its_compression_and_as_printed_its_tension_too(peak_g, compression):
    found = dri(naive.half_sine(peak_g * naive.GRAVITY, 0.08, 0.6, RATE_HZ))
    assert found.compression == pytest.approx(compression, abs=0.01)
    assert found.as_printed == pytest.approx(6.47, abs=0.01)


@pytest.mark.parametrize(
    ("rate_hz", "missed", "peak_g", "length_s"),
    [
        (250.0, 6e-3, -5.0, 0.08),
        (500.0, 1.5e-3, 8.0, 0.03),
        (RATE_HZ, 3e-4, -5.0, 0.08),
        (RATE_HZ, 3e-4, 3.0, 0.2),
        (4000.0, 3e-5, 8.0, 0.03),
    ],
)  # a peak between two samples is missed: (52.9 / rate)^2 / 8 of itself
def test_dri_is_the_oscillator_integrated_otherwise(rate_hz, missed, peak_g, length_s):
    accel = naive.half_sine(peak_g * naive.GRAVITY, length_s, 0.5, rate_hz)
    wanted = naive.dynamic_response(np.arange(len(accel)) / rate_hz, accel)
    found = dri(accel, rate_hz)
    assert found.compression == pytest.approx(wanted[0], rel=missed)
    assert found.as_printed == pytest.approx(wanted[1], rel=missed)


def test_dri_of_a_sudden_constant_is_its_overshoot():
    # A step of 1 g overshoots by exp(-pi zeta / sqrt(1 - zeta^2)), at half the damped period.
    zeta, omega = 0.224, 52.9
    found = dri(np.concatenate([np.zeros(10), np.full(8000, naive.GRAVITY)]), 4000.0)
    damped = math.sqrt(1.0 - zeta**2)
    assert found.compression == pytest.approx(
        1.0 + math.exp(-math.pi * zeta / damped), rel=1e-4
    )  # the ramp of a sample
    assert found.time_s == pytest.approx(10 / 4000.0 + math.pi / (omega * damped), abs=2.0 / 4000.0)


# Regression numbers of SOURCE.txt, from another program; the force of each pulse is published, its DRI is not.
@pytest.mark.parametrize(("length_ms", "known"), [(50, 42.19), (75, 34.68), (100, 28.18), (150, 19.91), (200, 14.67)])
def test_dri_of_the_spine_pulses_is_known(shared_data, length_ms, known):
    path = shared_data / "yoganandan_spine_pulses" / f"accel_{length_ms}ms.csv"
    time, accel = np.loadtxt(path, delimiter=",", skiprows=1).T
    even = np.interp(np.arange(0.0, time[-1] + 0.3, 1e-4), time, accel, right=0.0)
    found = dri(even * naive.GRAVITY, 1e4)
    assert found.compression == pytest.approx(known, abs=0.006)  # two digits are given
    time, accel = np.append(time, time[-1] + [1e-9, 0.1]), np.append(accel, [0.0, 0.0])
    assert naive.dynamic_response(time, accel * naive.GRAVITY)[0] == pytest.approx(known, abs=0.01)


@pytest.mark.parametrize("rate_hz", [500.0, RATE_HZ, 4000.0])
@pytest.mark.parametrize(
    "pieces",
    [
        [(-50j, 1j * math.pi / 0.05, 0.01, 0.06)],
        [(-20j, 1j * math.pi / 0.3, 0.01, 0.31)],
        [(-30j, 2j * math.pi * 8.0, 0.01, 0.51)],
        [(-60j, -8.0 + 2j * math.pi * 10.0, 0.01, math.inf)],
    ],
)
def test_dri_of_analytic_pulses_is_the_closed_form(rate_hz, pieces):
    time, fine = (np.arange(0.0, 1.0, step) for step in (1.0 / rate_hz, 1e-5))
    oscillator = [-1.0], [1.0, 2.0 * 0.224 * 52.9, 52.9**2]  # z / a, of z'' + 2 zeta w z' + w^2 z = -a
    deflection = naive.response_to_pulses(*oscillator, pieces, fine)
    found = dri(naive.pulses(pieces, time), rate_hz)
    # A pulse linear between samples is a little smaller, and a peak may lie between two: 0.5 % and 0.15 % at 500 Hz.
    near = 7e-3 * (500.0 / rate_hz) ** 2 + 1e-5
    assert found.compression == pytest.approx(-deflection.min() * 52.9**2 / naive.GRAVITY, rel=near)
    assert found.as_printed == pytest.approx(np.abs(deflection).max() * 52.9**2 / naive.GRAVITY, rel=near)
    assert found.time_s == pytest.approx(fine[deflection.argmin()], abs=1.5 / rate_hz)


def test_dri_time_continues_while_samples_are_missing():
    pulse = naive.half_sine(60.0, 0.04, 1.0, 1000.0)[:, None]
    at = dri(pulse, 1000.0).time_s
    for lost_s in (0.5, 1.0):
        meters = [DriMeter(1000.0, WINDOW_S) for _ in range(2)]
        meters[0].push(np.full((round(lost_s * 1000.0), 1), np.nan))
        meters[1].skip(lost_s)
        for meter in meters:
            meter.push(pulse)
            assert meter.since_reset().time_s == pytest.approx(lost_s + at)


def test_a_tilt_adds_little_compression():
    lost = naive.GRAVITY * (math.cos(math.radians(10.0)) - 1.0)  # what 10 degrees take from the vertical
    assert dri(np.full(3000, lost)).as_printed < 0.025


def test_dri_time_is_since_reset():
    meter = DriMeter(1000.0, WINDOW_S)
    first, second = naive.half_sine(30.0, 0.04, 1.0, 1000.0)[:, None], naive.half_sine(60.0, 0.04, 1.0, 1000.0)[:, None]
    meter.push(np.concatenate([first, second]))
    at = meter.since_reset().time_s
    assert 1.02 < at < 1.1
    meter.push(first)
    assert meter.since_reset().time_s == at
    meter.reset()
    meter.push(first)
    assert meter.since_reset().time_s == pytest.approx(at - 1.0, abs=2e-3)


@pytest.mark.parametrize(
    ("compression", "band"),
    [(0.0, "< 5.2"), (5.19, "< 5.2"), (5.2, "5.2-13.0"), (13.0, "13.0-17.7"), (17.7, "> 17.7 (AIS 2+ threshold)")],
)
def test_the_bands_are_numeric(compression, band):
    assert Dri(compression, 99.0, 0.0).band == band
    assert not any("surviv" in label for _, label in DRI_BANDS)


# --- HIC -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "hic15", "hic36"), [("toyota_corolla", 205.75, 345.55), ("honda_cr_v", 177.63, 330.60)]
)
def test_hic_of_the_crash_tests_is_known(shared_data, name, hic15, hic36):
    with (shared_data / "nhtsa_head_hic15" / f"{name}.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))[1:]
    head = np.array(rows, dtype=float)[:, 1:]
    assert hic(head, 1e4, 0.015).resultant == pytest.approx(hic15, abs=0.005)  # printed to 0.01
    assert hic(head, 1e4, 0.036).resultant == pytest.approx(hic36, abs=0.005)


@pytest.mark.parametrize("rate_hz", [500.0, RATE_HZ, 10_000.0])
@pytest.mark.parametrize("length_s", [0.015, 0.036])
def test_hic_of_a_long_square_pulse_fills_the_window(rate_hz, length_s):
    pulse = np.concatenate([np.zeros(20), np.full(round(0.1 * rate_hz), 40.0), np.zeros(20)])
    found = hic(vertical(pulse), rate_hz, length_s)
    assert found.vertical == pytest.approx(length_s * 40.0**2.5, rel=1e-9)  # exact, window ends interpolated
    assert found.resultant == pytest.approx(found.vertical, rel=ROUNDING)
    assert found.as_printed == pytest.approx(length_s * 41.0**2.5, rel=1e-9)
    assert found.bandwidth_hz == rate_hz / 2.0


def test_hic_of_a_short_square_pulse_takes_the_pulse_alone():
    pulse = np.concatenate([np.zeros(500), np.full(101, 40.0), np.zeros(500)])  # 10 ms at 10 kHz, edges of 0.1 ms
    assert hic(vertical(pulse), 1e4).vertical == pytest.approx(0.01 * 40.0**2.5, rel=5e-3)  # the edges


@pytest.mark.parametrize(("half_width_s", "whole"), [(0.1, False), (0.02, True)])
def test_hic_of_a_triangle_is_the_closed_form(half_width_s, whole):
    peak, rate_hz = 60.0, RATE_HZ
    time = np.arange(round(0.3 * rate_hz)) / rate_hz - 0.15
    pulse = peak * np.maximum(0.0, 1.0 - np.abs(time) / half_width_s)
    # Best symmetric window: 4/7 of the half width to each side; more than half of 15 ms is not allowed.
    best = 4.0 / 7.0 * half_width_s
    tau = min(best, 0.0075)
    wanted = 2.0 * tau * (peak * (1.0 - tau / (2.0 * half_width_s))) ** 2.5
    assert hic(vertical(pulse), rate_hz).vertical == pytest.approx(wanted, rel=3e-3)  # half a sample off
    if whole:
        wanted = 2.0 * best * (peak * (1.0 - best / (2.0 * half_width_s))) ** 2.5
        assert hic(vertical(pulse), rate_hz, 0.036).vertical == pytest.approx(wanted, rel=3e-3)


@settings(max_examples=25)
@given(SEEDS, st.sampled_from([250.0, 500.0, 1000.0, RATE_HZ]), st.sampled_from([0.015, 0.036]))
def test_hic_is_nearly_brute_force_over_a_fine_grid_and_never_more(seed, rate_hz, length_s):
    rough = np.abs(np.random.default_rng(seed).standard_normal(90)).cumsum()
    pulse = 50.0 * np.abs(np.sin(rough))
    found = hic(vertical(pulse), rate_hz, length_s).vertical
    fine = np.interp(np.arange(8 * 89 + 1) / 8.0, np.arange(90), pulse)
    on_fine = naive.head_injury(fine, 8.0 * rate_hz, length_s)
    assert found >= 0.99 * on_fine
    # The fine grid's windows are shorter than allowed by less than 1/8 sample, so it may be short by that share.
    assert found <= on_fine * (1.0 + 0.2 / (length_s * rate_hz))


@pytest.mark.parametrize(("rate_hz", "steps"), [(250.0, 8), (500.0, 4), (1000.0, 2), (2000.0, 1)])
def test_hic_is_brute_force_over_samples_at_2_khz_with_straight_lines_between_them(rate_hz, steps):
    pulse = np.abs(naive.half_sine(60.0, 0.03, 0.2, rate_hz)) + np.abs(
        np.random.default_rng(1).standard_normal(round(0.2 * rate_hz))
    )
    length_s = round(0.015 * rate_hz) / rate_hz
    finer = np.interp(np.arange(steps * (pulse.size - 1) + 1) / steps, np.arange(pulse.size), pulse)
    wanted = naive.head_injury(finer, steps * rate_hz, length_s)
    assert hic(vertical(pulse), rate_hz, length_s).vertical == pytest.approx(wanted, rel=ROUNDING)


@pytest.mark.parametrize("cuts", [(), (600, 601, 640)])
@pytest.mark.parametrize(("rate_hz", "near_s"), [(1000.0, 1e-9), (RATE_HZ, 1.0 / RATE_HZ)])
def test_hic_has_the_window_of_its_maximum(rate_hz, near_s, cuts):
    """A half-sine of 20 ms is best where tan x = 5/3 x, over 0.633 of it, around its middle: 12.7 ms."""
    pulse = vertical(naive.half_sine(40.0, 0.02, 1.5, rate_hz, begin_s=0.62))
    pulse[-round(0.2 * rate_hz) :] = np.nan  # what is missing behind it changes nothing
    meter = HicMeter(rate_hz, 0.015, WINDOW_S)
    for part in np.split(pulse * naive.GRAVITY, cuts):
        meter.push(np.ascontiguousarray(part))
    window = meter.since_reset().windows_s["vertical"]
    assert sum(window) / 2.0 == pytest.approx(0.63, abs=near_s)
    assert window.end - window.begin == pytest.approx(0.01267, abs=1.5 / rate_hz)
    at_s = np.arange(len(pulse)) / rate_hz
    fine_s = np.linspace(*window, 20_001)
    mean_g = np.interp(fine_s, at_s, pulse[:, 2]).mean()
    assert meter.since_reset().vertical == pytest.approx((window.end - window.begin) * mean_g**2.5, rel=1e-4)


def test_the_window_of_hic_includes_breaks_and_restarts_at_a_reset():
    pulse = vertical(naive.half_sine(40.0, 0.02, 0.5, 1000.0, begin_s=0.3)) * naive.GRAVITY
    meter = HicMeter(1000.0, 0.015, WINDOW_S)
    meter.push(0.5 * pulse)
    meter.skip(2.0)
    meter.push(pulse)
    first, second = 0.31, 2.5 + 0.31
    assert sum(meter.since_reset().windows_s["resultant"]) / 2.0 == pytest.approx(second, abs=1e-9)
    meter.push(0.9 * pulse)
    assert sum(meter.since_reset().windows_s["resultant"]) / 2.0 == pytest.approx(second, abs=1e-9)
    totals = meter.totals()
    meter.reset()
    assert meter.since_reset().windows_s["resultant"] is None
    meter.push(0.2 * pulse)
    assert sum(meter.since_reset().windows_s["resultant"]) / 2.0 == pytest.approx(first, abs=1e-9)
    # A later run continues: the window is that of the larger pulse, by the time since the first run began.
    for share, wanted in ((0.5, second), (2.0, 3.5 + first)):
        after = HicMeter(1000.0, 0.015, WINDOW_S)
        after.resume(totals)
        after.push(share * pulse)
        assert sum(after.since_reset().windows_s["resultant"]) / 2.0 == pytest.approx(wanted, abs=1e-9)


def test_interpolated_ends_improve_on_the_grid_at_the_native_rate():
    truth = naive.head_injury(naive.half_sine(50.0, 0.04, 0.08, 10_000.0), 10_000.0, 0.015)
    pulse = naive.half_sine(50.0, 0.04, 0.08, RATE_HZ)
    grid = naive.head_injury(pulse, RATE_HZ, 0.015)
    found = hic(vertical(pulse), RATE_HZ).vertical
    assert grid < 0.96 * truth  # 16 whole samples are 14.17 ms
    assert found == pytest.approx(truth, rel=2e-3)


def test_a_fixed_window_is_not_enough():
    # Two pulses 4 ms long: the search finds the one, a 15 ms window dilutes it.
    pulse = np.concatenate([np.zeros(100), np.full(41, 80.0), np.zeros(200)])
    fixed = 0.015 * (80.0 * 0.0041 / 0.015) ** 2.5
    assert hic(vertical(pulse), 1e4).vertical > 5.0 * fixed


def test_hic_counts_any_direction_in_the_resultant_and_up_and_down_in_the_vertical():
    up = vertical(naive.half_sine(30.0, 0.03, 0.1, RATE_HZ))
    along = np.roll(up, 1, axis=1)
    assert hic(-up, RATE_HZ).vertical == hic(up, RATE_HZ).vertical
    assert hic(along, RATE_HZ).resultant == hic(up, RATE_HZ).resultant
    assert hic(along, RATE_HZ).vertical == 0.0
    assert hic(along, RATE_HZ).as_printed == pytest.approx(0.015, rel=ROUNDING)  # the 1 g of Eq. 23 alone


def test_a_missing_axis_leaves_hic_of_the_vertical():
    head = np.column_stack(
        [naive.half_sine(20.0, 0.03, 0.2, RATE_HZ)] * 2 + [naive.half_sine(30.0, 0.03, 0.2, RATE_HZ)]
    )
    whole, holes = hic(head, RATE_HZ), head.copy()
    holes[round(0.035 * RATE_HZ), 0] = np.nan  # amid the pulse
    found = hic(holes, RATE_HZ)
    assert (found.vertical, found.as_printed) == (whole.vertical, whole.as_printed)
    assert 0.1 * whole.resultant < found.resultant < whole.resultant


def test_one_g_more_multiplies_hic_as_noted():
    for peak, factor in ((2.0, 2.8), (4.0, 1.8), (8.0, 1.35)):
        found = hic(vertical(np.full(300, peak)), RATE_HZ)
        assert found.as_printed / found.vertical == pytest.approx(factor, abs=0.06)


def test_a_smaller_maximum_of_an_earlier_run_leaves_the_time_of_the_larger_one():
    """Both runs' seconds add up; the time is that of the larger of both maxima."""
    soft, hard = (naive.half_sine(peak_g * naive.GRAVITY, 0.08, 0.6, RATE_HZ) for peak_g in (2.0, 5.0))
    silence = np.zeros(400)

    def counted(accel: np.ndarray) -> DriMeter:
        meter = DriMeter(RATE_HZ, WINDOW_S)
        meter.push(accel.reshape(-1, 1))
        return meter

    for earlier, later in ((soft, hard), (hard, soft)):
        first, second = counted(earlier), counted(np.concatenate([silence, later]))
        alone = (first.since_reset(), second.since_reset())
        before_s, own_s = first.totals()[0, 2], second.totals()[0, 2]
        second.resume(first.totals())
        louder = max(alone, key=lambda one: one.compression)
        time_s = louder.time_s + (before_s if louder is alone[1] else 0.0)
        assert second.since_reset().compression == pytest.approx(louder.compression, rel=1e-9)
        assert second.since_reset().time_s == pytest.approx(time_s, abs=1e-9)
        assert second.totals()[0, 2] == pytest.approx(before_s + own_s, rel=1e-9)
