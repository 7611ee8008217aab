"""Alignment: how well eight neighbours read between samples, and what stays unanswered."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biodyn_core.alignment import HALF_WIDTH, Aligner
from biodyn_core.conditioning import Block

EPOCH_NS = 1_767_225_600 * 10**9
RATE_HZ = 1129.3


def block(time_s: np.ndarray, values: np.ndarray, begins_run: bool = False, epoch_ns: int = EPOCH_NS) -> Block:
    """Conditioned samples of a sensor."""
    return Block(
        stamps_ns=epoch_ns + np.rint(time_s * 1e9).astype(np.int64),
        time_s=time_s,
        levelled_mps2=np.zeros((time_s.size, 3)),
        low_passed_mps2=values,
        begins_run=begins_run,
        epoch_ns=epoch_ns,
    )


def aligner(*blocks: Block, keep_s: float = 100.0) -> Aligner:
    """An aligner that has these blocks."""
    made = Aligner(keep_s)
    made.feed(blocks)
    return made


def inside(time_s: np.ndarray, count: int, seed: int = 0) -> np.ndarray:
    """Instants that have all their neighbours, ascending."""
    low, high = time_s[HALF_WIDTH - 1], time_s[-HALF_WIDTH]
    return np.sort(np.random.default_rng(seed).uniform(low, high, count))


@pytest.mark.parametrize(("rate_hz", "share"), [(500.0, 5e-3), (1129.3, 5e-5), (4000.0, 1e-8)])
@pytest.mark.parametrize("frequency_hz", [5.0, 30.0, 100.0])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_sine_up_to_the_cut_off_is_read_within_half_a_percent(rate_hz, share, frequency_hz, phase):
    time = np.arange(round(rate_hz)) / rate_hz
    grid = inside(time, 5000)
    values, answered = aligner(block(time, np.sin(2.0 * np.pi * frequency_hz * time + phase), True)).read(
        grid, EPOCH_NS
    )
    assert answered == grid.size
    error = np.abs(values - np.sin(2.0 * np.pi * frequency_hz * grid + phase)).max()
    assert error < share  # the last term of the series falls with the eighth power of f / rate


def test_half_a_percent_is_what_500_hz_really_costs():
    time = np.arange(500) / 500.0
    grid = (time[5:-5] + time[6:-4])[:-1] / 2.0  # halfway, where it is worst
    errors = []
    for phase in np.linspace(0.0, np.pi, 20):
        values, _ = aligner(block(time, np.sin(2.0 * np.pi * 100.0 * time + phase), True)).read(grid, EPOCH_NS)
        errors.append(np.abs(values - np.sin(2.0 * np.pi * 100.0 * grid + phase)).max())
    assert max(errors) == pytest.approx(4.6e-3, abs=1e-4)


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
def test_between_samples_it_is_the_polynomial_lagrange_wrote_down(seed):
    rng = np.random.default_rng(seed)
    time, values = np.arange(60) / RATE_HZ, rng.standard_normal(60)
    grid = inside(time, 40, seed)
    found, _ = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    for at, value in zip(grid, found, strict=True):
        first = int(np.searchsorted(time, at, side="right")) - HALF_WIDTH
        around = slice(first, first + 2 * HALF_WIDTH)
        assert value == pytest.approx(naive.lagrange(time[around], values[around], at), rel=1e-9, abs=1e-9)


def test_at_a_sample_it_is_the_sample():
    time, values = np.arange(50) / 1024.0, np.random.default_rng(1).standard_normal(50)
    grid = time[4:-4]
    found, answered = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    np.testing.assert_array_equal(found, values[4:-4])
    assert answered == grid.size


def test_another_epoch_is_another_zero_of_the_same_time():
    time, values = np.arange(200) / 1000.0, np.sin(np.arange(200) / 20.0)
    late_ns = 250_000_000_125
    grid = inside(time, 50)
    wanted, _ = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    found, _ = aligner(block(time, values, True, EPOCH_NS - late_ns)).read(grid - late_ns * 1e-9, EPOCH_NS)
    np.testing.assert_allclose(found, wanted, atol=1e-9)  # seconds carry 1e-14 here, and the slope is below 100 / s


# --- what is missing, and what may still come ------------------------------------------------------------------------


def test_nothing_known_leaves_everything_unanswered():
    values, answered = Aligner(1.0).read(np.arange(5.0), EPOCH_NS)
    assert answered == 0 and np.isnan(values).all()


def test_an_instant_waits_until_its_four_later_neighbours_are_there():
    time = np.arange(40) / RATE_HZ
    grid = np.array([time[20] + 0.2 / RATE_HZ])
    waiting = Aligner(100.0)
    for n in range(40):
        waiting.feed([block(time[n : n + 1], np.cos(time[n : n + 1]), n == 0)])
        values, answered = waiting.read(grid, EPOCH_NS)
        assert answered == (1 if n >= 20 + HALF_WIDTH else 0)
        assert np.isnan(values[0]) == (answered == 0)


def test_answers_stop_at_the_first_that_must_wait():
    time = np.arange(100) / RATE_HZ
    grid = time[:-1] + 0.5 / RATE_HZ
    values, answered = aligner(block(time, np.ones(100), True)).read(grid, EPOCH_NS)
    assert answered == 100 - HALF_WIDTH
    # The run's first instants lack earlier neighbours, which never come.
    assert np.isnan(values[: HALF_WIDTH - 1]).all() and not np.isnan(values[HALF_WIDTH - 1 : answered]).any()
    assert np.isnan(values[answered:]).all()


def test_before_the_first_sample_there_is_nan_and_no_waiting():
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


def test_the_edge_of_a_run_is_answered_once_the_next_run_has_come():
    time = np.arange(50) / RATE_HZ
    made = aligner(block(time, np.ones(50), True))
    edge = np.array([time[47] + 1e-4])
    assert made.read(edge, EPOCH_NS)[1] == 0  # its neighbours may still come
    made.feed([block(time[:10] + 1.0, np.ones(10), True)])
    values, answered = made.read(edge, EPOCH_NS)
    assert answered == 1 and np.isnan(values[0])  # they will not


@given(st.lists(st.integers(0, 300), max_size=10).map(sorted), st.integers(0, 2**32 - 1))
def test_any_cut_into_blocks_is_read_alike(cuts, seed):
    time, values = np.arange(300) / RATE_HZ, np.random.default_rng(seed).standard_normal(300)
    grid = inside(time, 100, seed)
    pieces = zip(np.split(time, cuts), np.split(values, cuts), strict=True)
    begun = [block(t, v, bool(t.size) and t[0] == 0.0) for t, v in pieces]
    found, answered = aligner(*begun).read(grid, EPOCH_NS)
    wanted, _ = aligner(block(time, values, True)).read(grid, EPOCH_NS)
    np.testing.assert_array_equal(found, wanted)
    assert answered == grid.size


# --- forgetting ------------------------------------------------------------------------------------------------------


def test_forgetting_the_past_leaves_the_rest_readable():
    time, values = np.arange(500) / RATE_HZ, np.random.default_rng(2).standard_normal(500)
    made, wanted = aligner(block(time, values, True)), aligner(block(time, values, True))
    made.forget(time[200], EPOCH_NS)
    grid = np.sort(np.random.default_rng(3).uniform(time[200], time[-5], 300))
    np.testing.assert_array_equal(made.read(grid, EPOCH_NS)[0], wanted.read(grid, EPOCH_NS)[0])
    assert made.read(time[:10], EPOCH_NS)[1] == 10 and np.isnan(made.read(time[:10], EPOCH_NS)[0]).all()


def test_an_hour_is_not_kept_where_a_second_is_asked_for():
    made = Aligner(keep_s=1.0)
    for second in range(120):
        time = second + np.arange(1000) / 1000.0
        made.feed([block(time, np.sin(time), second == 0)])
        grid = np.array([time[-1] - 0.9])  # a second back is readable
        values, answered = made.read(grid, EPOCH_NS)
        assert answered == 1
        assert second == 0 or values[0] == pytest.approx(np.sin(grid[0]), abs=1e-9)
    assert made._time_s.size <= 2.0 * 1000 + 1000  # never more than twice that and a block
