"""Sampling clock: period and losses from faulty stamps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ticks import COUNT, RATE_HZ, even_s, lost_at_random

from biodyn_core.base.errors import InputError
from biodyn_core.conditioning.sampling_clock import fit_clock, number_samples

SEEDS = st.integers(0, 2**32 - 1)


@given(st.floats(250.0, 4000.0), SEEDS, st.lists(st.integers(1, 398), max_size=20, unique=True))
def test_fit_clock_counts_lost_periods(rate_hz, seed, lost):
    index = np.delete(np.arange(400), lost)
    jitter = np.random.default_rng(seed).uniform(-0.1, 0.1, index.size)
    clock = fit_clock((index + jitter) / rate_hz)
    assert clock.period_s == pytest.approx(1.0 / rate_hz, rel=1e-3)  # 0.1 period of jitter over 400
    assert clock.last_s == pytest.approx(399.0 / rate_hz, abs=0.1 / rate_hz)
    assert clock.jitter_s == pytest.approx(0.05 / rate_hz, rel=0.2)  # the mean of |uniform|
    assert clock.jitter_s < clock.worst_s < 0.21 / rate_hz and clock.samples == index.size


@given(st.floats(0.01, 0.45), SEEDS, st.floats(250.0, 20_000.0))
def test_random_loss_up_to_nearly_half_of_all_does_not_change_the_rate(share, seed, rate_hz):
    stamps_s = lost_at_random(share, seed, rate_hz)
    # The typical step is the median one: with a share of 0.45, half of the steps of a rare draw span lost samples.
    assume(np.mean(np.rint(np.diff(stamps_s) * rate_hz) == 1.0) > 0.5)
    clock = fit_clock(stamps_s)
    assert clock.period_s == pytest.approx(1.0 / rate_hz, rel=1e-9) and clock.jitter_s < 1e-9


@given(st.floats(255.0, 5000.0), st.integers(0, 10**7), st.sampled_from([1e-3, 2e-3, 4e-3, 10e-3]))
def test_quantised_stamps_are_no_losses(rate_hz, begins_ns, quantum_s):
    index = np.arange(round(0.8 * rate_hz))
    stamps_s = np.floor((index / rate_hz + begins_ns * 1e-9) / quantum_s) * quantum_s
    clock = fit_clock(stamps_s - stamps_s[0])
    # A sawtooth over n samples bends a line's slope by no more than 6 (quantum / 2) / (n period) / 2; up to 5 stamps
    # that are one quantum too far apart may be as many lost samples of a clock that ticks in quanta.
    few = 5.0 / index.size if abs(rate_hz * quantum_s - 1.0) < 0.03 else 0.0
    assert clock.period_s * rate_hz == pytest.approx(1.0, abs=1.5 * quantum_s / 0.8 + few + 0.02 * (few > 0.0))


@pytest.mark.parametrize("many", [2, 3, 4, 5, 8, 20])
@pytest.mark.parametrize("within", [0.01, 0.1, 0.5, 0.7])
def test_bursts_are_no_losses(many, within):
    index = np.arange(COUNT // many * many)
    stamps_s = (index // many * many + index % many * within) / RATE_HZ
    # The last burst changes the slope of the line by as much as its samples are early.
    assert fit_clock(stamps_s).period_s == pytest.approx(1.0 / RATE_HZ, rel=0.01 + 2.0 * (many / COUNT) ** 2)


@pytest.mark.parametrize("delay_ms", [0.05, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("seed", range(5))
def test_stamps_of_late_callbacks_are_no_losses(delay_ms, seed):
    delays_s = np.random.default_rng(seed).exponential(1e-3 * delay_ms, COUNT)
    clock = fit_clock(np.maximum.accumulate(even_s() + delays_s))
    assert clock.period_s == pytest.approx(1.0 / RATE_HZ, rel=1e-3 + 5e-3 * delay_ms)


@pytest.mark.parametrize("jitter", [0.2, 0.3, 0.5])
@pytest.mark.parametrize("lost", [(), (450,), (200, 300, 700), tuple(range(400, 420))])
def test_samples_have_their_numbers_under_much_jitter(jitter, lost):
    index = np.delete(np.arange(COUNT), lost)
    stamps_s = np.sort((index + jitter * np.random.default_rng(1).standard_normal(index.size)) / RATE_HZ)
    clock, found = number_samples(stamps_s)
    assert found[0] == 0.0 and (np.diff(found) > 0.0).all()
    assert (found != index).sum() <= 15  # each loss is found to a few samples
    assert clock.last_s == pytest.approx(index[-1] / RATE_HZ, abs=0.1 / RATE_HZ)


@pytest.mark.parametrize("delay", [0.3, 3.0])
def test_late_stamps_give_the_samples_no_other_numbers(delay):
    """Delays in periods, and a stall of 20 samples."""
    time_s = even_s() + np.random.default_rng(5).exponential(delay / RATE_HZ, COUNT)
    time_s[300:320] = time_s[320]
    assert np.array_equal(number_samples(np.maximum.accumulate(time_s))[1], np.arange(COUNT))


@pytest.mark.parametrize("lost", [(), (600,)])
def test_a_stall_under_much_jitter_is_no_loss(lost):
    index = np.delete(np.arange(COUNT), lost)
    time_s = (index + 0.2 * np.random.default_rng(1).standard_normal(index.size)) / RATE_HZ
    time_s[300:320] = time_s[320]
    assert (number_samples(np.maximum.accumulate(time_s))[1] != index).sum() <= 3


@pytest.mark.parametrize("stamps_s", [[], [0.0], [0.0, 1.0]])
def test_two_stamps_give_no_rate(stamps_s):
    with pytest.raises(InputError, match="fewer than three different samples"):
        fit_clock(np.array(stamps_s))
