"""Alignment: accuracy of neighbours between samples at any rate, and refusals."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BarycentricInterpolator

from biodyn_core.conditioning.alignment import LARGEST_ERROR, Aligner, half_width, interpolation_error
from biodyn_core.conditioning.conditioned import Block

EPOCH_NS = 1_767_225_600 * 10**9
RATE_HZ = 1129.3
HALF_WIDTH = 4
"""From 500 Hz on, as below."""


def block(
    time_s, values, begins_run: bool = False, epoch_ns: int = EPOCH_NS, rate_hz: float = RATE_HZ, cutoff_hz=100.0
) -> Block:
    """Conditioned samples of a sensor."""
    return Block(
        stamps_ns=epoch_ns + np.rint(time_s * 1e9).astype(np.int64),
        time_s=time_s,
        levelled_mps2=np.zeros((time_s.size, 3)),
        low_passed_mps2=values,
        begins_run=begins_run,
        gap_s=0.0,
        epoch_ns=epoch_ns,
        rate_hz=rate_hz,
        cutoff_hz=cutoff_hz,
    )


def aligner(*blocks: Block, keep_s: float = 100.0) -> Aligner:
    """An aligner that has these blocks."""
    made = Aligner(keep_s)
    made.add(blocks)
    return made


def inside(time_s: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Instants that have all their neighbours, ascending."""
    low, high = time_s[HALF_WIDTH - 1], time_s[-HALF_WIDTH]
    return np.sort(np.random.default_rng(seed).uniform(low, high, count))


# --- how well it reads -----------------------------------------------------------------------------------------------

RATES_HZ = [249.75, 250.0, 251.0, 255.0, 262.0, 280.0, 300.0, 333.3, 400.0, 480.0, 499.9, 500.0, RATE_HZ, 4000.0, 20e3]


def worst_error(rate_hz: float, frequency_hz: float, samples: int = 400, cutoff_hz: float = 100.0) -> float:
    """Largest error in reading a sine of amplitude 1, any phase, anywhere between samples."""
    time = np.arange(samples) / rate_hz
    half = half_width(round(rate_hz, 1), cutoff_hz)
    grid = np.sort(np.random.default_rng(4).uniform(time[half], time[-half - 1], 3000))
    read = []
    for phase in (0.0, 0.5 * np.pi):
        values, answered = aligner(
            block(time, np.cos(2.0 * np.pi * frequency_hz * time + phase), True, rate_hz=rate_hz, cutoff_hz=cutoff_hz)
        ).read(grid, EPOCH_NS)
        assert answered == grid.size
        read.append(values - np.cos(2.0 * np.pi * frequency_hz * grid + phase))
    return float(np.hypot(*read).max())  # two phases a quarter apart make the worst of all


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("frequency_hz", [1.0, 30.0, 80.0, 100.0])
def test_a_sine_up_to_100_hz_is_read_within_half_a_percent_at_every_rate(rate_hz, frequency_hz):
    assert worst_error(rate_hz, frequency_hz) < 0.005


@given(st.floats(249.75, 20_000.0))
def test_half_a_percent_holds_at_any_rate_that_is_accepted(rate_hz):
    assert LARGEST_ERROR == 0.005
    assert worst_error(rate_hz, 100.0, samples=200) < 0.005


@pytest.mark.parametrize("cutoff_hz", [20.0, 50.0, 150.0, 200.0])
@pytest.mark.parametrize("rate_per_cutoff", [2.5, 3.0, 5.0, 10.0])
def test_the_error_bound_holds_for_any_cut_off_and_any_rate_it_allows(cutoff_hz, rate_per_cutoff):
    assert worst_error(rate_per_cutoff * cutoff_hz, cutoff_hz, cutoff_hz=cutoff_hz) < 0.005


@pytest.mark.parametrize(("rate_hz", "half"), [(250.0, 48), (300.0, 16), (400.0, 6), (500.0, 4), (RATE_HZ, 4)])
def test_the_number_of_neighbours_is_the_least_for_the_error_bound(rate_hz, half):
    assert half_width(rate_hz, 100.0) == half
    made = aligner(block(np.arange(200) / rate_hz, np.zeros(200), True, rate_hz=rate_hz))
    assert made.look_ahead == half
    fewer = {48: 32, 16: 12, 6: 4}.get(half, 3)
    assert interpolation_error(half, 100.0 / rate_hz) < 0.005
    assert half == 4 or interpolation_error(fewer, 100.0 / rate_hz) >= 0.005


@pytest.mark.parametrize(("half", "per_rate"), [(4, 0.2), (4, 100.0 / RATE_HZ), (12, 0.3), (48, 0.4)])
def test_the_error_that_widths_are_chosen_by_is_that_of_the_polynomial(half, per_rate):
    # A wave exp(i w n) has every phase at once; scipy's barycentric polynomial reads it, in its own way.
    n = np.arange(1 - half, half + 1)
    polynomial = BarycentricInterpolator(n.astype(float), np.exp(2j * np.pi * per_rate * n), rng=1)
    at = np.linspace(0.05, 0.95, 19)
    wanted = np.abs(polynomial(at) - np.exp(2j * np.pi * per_rate * at)).max()
    assert interpolation_error(half, per_rate) == pytest.approx(wanted, rel=1e-6)


def test_the_error_at_500_hz_is_half_a_percent():
    assert worst_error(500.0, 100.0) == pytest.approx(4.6e-3, abs=1e-4)
    assert worst_error(RATE_HZ, 100.0) < 5e-5
    assert worst_error(4000.0, 100.0) < 1e-8


@pytest.mark.parametrize("rate_hz", [250.0, 400.0, RATE_HZ])
def test_many_neighbours_do_not_amplify_noise(rate_hz):
    # In the middle of evenly spaced points a polynomial of any degree amplifies but little; at its ends it would not.
    values = np.random.default_rng(5).standard_normal(2000)
    time = np.arange(2000) / rate_hz
    grid = (time[200:-200] + time[201:-199]) / 2.0
    found, _ = aligner(block(time, values, True, rate_hz=rate_hz)).read(grid, EPOCH_NS)
    assert found.std() < 1.05 * values.std()


@given(st.lists(st.floats(-5.0, 5.0), min_size=8, max_size=8), st.integers(0, 2**32 - 1))
def test_polynomials_of_the_seventh_degree_are_read_exactly(coefficients, seed):
    time = np.arange(8) / RATE_HZ
    shape = np.polynomial.Polynomial(coefficients, domain=[0.0, time[-1]], window=[-1.0, 1.0])
    # One sample more, so that the middle interval's neighbours are known to be there.
    time = np.arange(9) / RATE_HZ
    grid = np.sort(np.random.default_rng(seed).uniform(time[3], time[4], 20))
    values, answered = aligner(block(time, shape(time), True)).read(grid, EPOCH_NS)
    assert answered == grid.size
    np.testing.assert_allclose(values, shape(grid), atol=1e-11 * (1.0 + np.abs(shape(time)).max()))  # rounding


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_interpolation_is_the_lagrange_polynomial(seed):
    rng = np.random.default_rng(seed)
    time, values = np.arange(60) / RATE_HZ, rng.standard_normal(60)
    grid = inside(time, 40, seed)
    found, _ = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    for at, value in zip(grid, found, strict=True):
        first = int(np.searchsorted(time, at, side="right")) - HALF_WIDTH
        around = slice(first, first + 2 * HALF_WIDTH)
        assert value == pytest.approx(naive.lagrange(time[around], values[around], at), rel=1e-9, abs=1e-9)


def test_interpolation_at_a_sample_is_the_sample():
    time, values = np.arange(50) / 1024.0, np.random.default_rng(1).standard_normal(50)
    grid = time[4:-4]
    found, answered = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    np.testing.assert_array_equal(found, values[4:-4])
    assert answered == grid.size


def test_the_epoch_of_stamps_has_no_effect():
    time, values = np.arange(200) / 1000.0, np.sin(np.arange(200) / 20.0)
    late_ns = 250_000_000_125
    grid = inside(time, 50)
    wanted, _ = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    found, _ = aligner(block(time, values, True, EPOCH_NS - late_ns)).read(grid - late_ns * 1e-9, EPOCH_NS)
    np.testing.assert_allclose(found, wanted, atol=1e-9)  # seconds carry 1e-14 here, and the slope is below 100 / s


# --- what is missing, and what may still come ------------------------------------------------------------------------


def test_without_samples_no_instant_is_interpolated():
    values, answered = Aligner(1.0).read(np.arange(5.0), EPOCH_NS)
    assert answered == 0 and np.isnan(values).all()


def test_an_instant_needs_four_later_neighbours():
    time = np.arange(40) / RATE_HZ
    grid = np.array([time[20] + 0.2 / RATE_HZ])
    waiting = Aligner(100.0)
    for n in range(40):
        waiting.add([block(time[n : n + 1], np.cos(time[n : n + 1]), n == 0)])
        values, answered = waiting.read(grid, EPOCH_NS)
        assert answered == (1 if n >= 20 + HALF_WIDTH else 0)
        assert np.isnan(values[0]) == (answered == 0)


def test_output_stops_at_the_first_instant_without_neighbours():
    time = np.arange(100) / RATE_HZ
    grid = time[:-1] + 0.5 / RATE_HZ
    values, answered = aligner(block(time, np.ones(100), True)).read(grid, EPOCH_NS)
    assert answered == 100 - HALF_WIDTH
    # The run's first instants lack earlier neighbours, which never come.
    assert np.isnan(values[: HALF_WIDTH - 1]).all() and not np.isnan(values[HALF_WIDTH - 1 : answered]).any()
    assert np.isnan(values[answered:]).all()


def test_before_the_first_sample_the_output_is_nan_at_once():
    time = np.arange(100) / RATE_HZ
    values, answered = aligner(block(time, np.ones(100), True)).read(np.linspace(-1.0, -1e-6, 20), EPOCH_NS)
    assert answered == 20 and np.isnan(values).all()


def test_a_gap_is_nan_for_four_neighbours_on_both_sides():
    time = np.concatenate([np.arange(50), np.arange(50) + 500]) / RATE_HZ
    made = aligner(block(time[:50], np.ones(50), True), block(time[50:], np.full(50, 2.0), True))
    grid = np.arange(4.5, 545.0) / RATE_HZ
    values, answered = made.read(grid, EPOCH_NS)
    assert answered == grid.size
    index = grid * RATE_HZ
    first, second = index < 50 - HALF_WIDTH, index > 500 + HALF_WIDTH - 1
    np.testing.assert_allclose(values[first], 1.0, rtol=1e-12)  # rounding
    np.testing.assert_allclose(values[second], 2.0, rtol=1e-12)
    assert np.isnan(values[~(first | second)]).all()


def test_the_edge_of_a_run_is_interpolated_once_the_next_run_begins():
    time = np.arange(50) / RATE_HZ
    made = aligner(block(time, np.ones(50), True))
    edge = np.array([time[47] + 1e-4])
    assert made.read(edge, EPOCH_NS)[1] == 0  # its neighbours may still come
    made.add([block(time[:10] + 1.0, np.ones(10), True)])
    values, answered = made.read(edge, EPOCH_NS)
    assert answered == 1 and np.isnan(values[0])  # they will not


@given(
    st.lists(st.integers(0, 300), max_size=10).map(sorted),
    st.integers(0, 2**32 - 1),
    st.sampled_from([250.0, 300.0, RATE_HZ]),
)
def test_any_cut_into_blocks_is_read_alike(cuts, seed, rate_hz):
    time, values = np.arange(300) / rate_hz, np.random.default_rng(seed).standard_normal(300)
    half = half_width(rate_hz, 100.0)
    grid = np.sort(np.random.default_rng(seed).uniform(time[half - 1], time[-half], 100))
    pieces = zip(np.split(time, cuts), np.split(values, cuts), strict=True)
    begun = [block(t, v, bool(t.size) and t[0] == 0.0, rate_hz=rate_hz) for t, v in pieces]
    found, answered = aligner(*begun).read(grid, EPOCH_NS)
    wanted, _ = aligner(block(time, values, True, rate_hz=rate_hz)).read(grid, EPOCH_NS)
    np.testing.assert_array_equal(found, wanted)
    assert answered == grid.size


@given(
    st.integers(0, 12),
    st.floats(-2.0, 14.0),
    st.sampled_from([0, 1, 7]),
    st.booleans(),
)
def test_an_instant_is_reached_where_it_is_interpolated(count, at, ahead, on_a_sample):
    """With eight neighbours and few samples, before the first and behind the last of them, whatever the epochs."""
    made = aligner(block(np.arange(count) / RATE_HZ, np.ones(count), True))
    time_s, epoch_ns = (round(at) if on_a_sample else at) / RATE_HZ, EPOCH_NS - ahead * 1_000_000_000
    _, answered = made.read(np.array([time_s + ahead]), epoch_ns)
    assert made.reaches(time_s + ahead, epoch_ns) == bool(answered)


# --- forgetting ------------------------------------------------------------------------------------------------------


def test_later_samples_stay_readable_after_older_ones_are_dropped():
    time, values = np.arange(500) / RATE_HZ, np.random.default_rng(2).standard_normal(500)
    made, wanted = aligner(block(time, values, True)), aligner(block(time, values, True))
    made.drop(time[200], EPOCH_NS)
    grid = np.sort(np.random.default_rng(3).uniform(time[200], time[-5], 300))
    np.testing.assert_array_equal(made.read(grid, EPOCH_NS)[0], wanted.read(grid, EPOCH_NS)[0])
    assert made.read(time[:10], EPOCH_NS)[1] == 10 and np.isnan(made.read(time[:10], EPOCH_NS)[0]).all()


def test_instants_within_a_line_have_the_length_of_its_loss():
    time, lost = np.arange(400) / RATE_HZ, np.zeros(400, dtype=np.int64)
    lost[100:110], lost[200:203], lost[300:304] = 10, 3, 4
    made = Aligner(keep_s=100.0, shortest_loss_s=0.003)
    assert not made.has_lines
    for part in np.split(np.arange(400), [50, 104, 250]):  # a loss may be cut
        made.add([block(time[part], np.zeros(part.size), part[0] == 0)._replace(lost=lost[part])])
    grid = time[:-1] + 0.5 / RATE_HZ
    shift_ns = 3_000_000_000  # the seat's epoch
    length_s = made.lost_s(grid - 3.0, EPOCH_NS + shift_ns, 1.0 / RATE_HZ)
    expected = np.zeros(399)
    expected[99:110], expected[299:304] = 10 / RATE_HZ, 4 / RATE_HZ
    np.testing.assert_allclose(length_s, expected)
    for phase in np.linspace(0.0, 1.0, 11):  # of a seat with slower samples than the line is long
        slow = np.arange(phase * 0.02, 0.35, 0.02)
        assert (made.lost_s(slow, EPOCH_NS, 0.02) > 0.0).sum() == 2
    made.drop(time[200], EPOCH_NS)
    assert (made.lost_s(grid, EPOCH_NS, 1.0 / RATE_HZ) > 0.0).sum() == 5
    made.drop(time[350], EPOCH_NS)
    assert not made.has_lines and not made.lost_s(grid, EPOCH_NS, 1.0 / RATE_HZ).any()


def test_a_line_ends_where_stamps_that_had_leapt_ahead_return():
    time, lost = np.arange(140) / 1000.0, np.zeros(140, dtype=np.int64)
    lost[100:140] = 40
    made = Aligner(keep_s=100.0, shortest_loss_s=0.003)
    made.add([block(time, np.zeros(140), True, rate_hz=1000.0)._replace(lost=lost)])
    made.add([block(np.arange(105, 200) / 1000.0, np.zeros(95), True, rate_hz=1000.0)])
    grid = np.arange(95, 150) / 1000.0 + 5e-4
    np.testing.assert_array_equal(made.lost_s(grid, EPOCH_NS, 1e-3) > 0.0, (grid > 0.099) & (grid < 0.105))


def test_memory_covers_only_the_requested_time():
    made = Aligner(keep_s=1.0)
    for second in range(120):
        time = second + np.arange(1000) / 1000.0
        made.add([block(time, np.sin(time), second == 0)])
        grid = np.array([time[-1] - 0.9])  # a second back is readable
        values, answered = made.read(grid, EPOCH_NS)
        assert answered == 1
        assert second == 0 or values[0] == pytest.approx(np.sin(grid[0]), abs=1e-9)
    assert made._time_s.size <= 2.0 * 1000 + 1000  # never more than twice that and a block
