"""Shocks: known pulses, block cuts, silent channels, leaping stamps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from streams import predicted_frames

from biodyn_core.pipeline.frames import MeasuredFrames, PredictedFrames
from biodyn_core.pipeline.shocks import MAX_SHOCKS, SEPARATION_NS, Shocks

RATE_HZ = 1000.0
EPOCH_NS = 1_700_000_000_000_000_000


def ride(seconds: float, pulses: dict[float, float], head_gain: float = 1.5, neck: bool = True):
    """Half sines of 20 ms on an otherwise still seat; every segment feels them with a gain, the head 100 ms later."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    seat = np.zeros_like(time_s)
    for begin_s, peak in pulses.items():
        inside = (time_s >= begin_s) & (time_s <= begin_s + 0.02)
        seat[inside] += peak * np.sin(np.pi * (time_s[inside] - begin_s) / 0.02)
    late = np.roll(seat, 100)
    measured = np.column_stack([seat, seat, seat, seat, seat if neck else np.full_like(seat, np.nan), head_gain * late])
    predicted = np.column_stack([seat, seat, seat, seat, seat, 2.0 * late])
    stamps_ns = EPOCH_NS + np.round(1e9 * time_s).astype(np.int64)
    return predicted_frames(stamps_ns, predicted), MeasuredFrames(stamps_ns, measured, measured[:, 1:])


def found(predicted, measured, cuts=()):
    """Shocks of a ride cut into pieces, every prediction a piece ahead of its measurement."""
    shocks = Shocks(5.0)
    edges = [0, *sorted(cuts), predicted.stamps_ns.size]
    empty = MeasuredFrames(*(column[:0] for column in measured))
    for begin, end in pairwise(edges):
        part = slice(begin, end)
        shocks.push(PredictedFrames(*(column[part] for column in predicted)), empty)
        shocks.push(PredictedFrames(*(c[:0] for c in predicted)), MeasuredFrames(*(c[part] for c in measured)))
    return shocks.latest()


def plain(shocks):
    return [(s.peak_ns, s.begin_ns, s.last_ns, *s.measured_mps2.tolist(), *s.predicted_mps2.tolist()) for s in shocks]


def test_a_pulse_is_a_shock_with_the_peaks_of_all_channels():
    (shock,) = found(*ride(3.0, {1.0: -20.0}))
    assert shock.peak_ns == EPOCH_NS + 1_010_000_000
    assert shock.seat_mps2 == pytest.approx(20.0)
    assert shock.measured_mps2[5] == pytest.approx(30.0), "the head, 100 ms later, belongs to it"
    assert shock.predicted_mps2[5] == pytest.approx(40.0)


def test_pulses_below_the_threshold_are_none_and_close_ones_are_one():
    assert not found(*ride(3.0, {1.0: 4.9}))
    assert len(found(*ride(5.0, {1.0: 9.0, 1.4: 12.0, 3.0: 8.0}))) == 2
    newest, oldest = found(*ride(5.0, {1.0: 9.0, 1.4: 12.0, 3.0: 8.0}))
    assert (newest.seat_mps2, oldest.seat_mps2) == (pytest.approx(8.0), pytest.approx(12.0))
    assert oldest.peak_ns == EPOCH_NS + 1_410_000_000


def test_the_last_five_are_listed_newest_first():
    pulses = {1.0 + at: 6.0 + at for at in range(8)}
    peaks = [shock.seat_mps2 for shock in found(*ride(10.0, pulses))]
    assert len(peaks) == MAX_SHOCKS
    assert peaks == pytest.approx([13.0, 12.0, 11.0, 10.0, 9.0])


def test_a_channel_without_values_is_nan():
    (shock,) = found(*ride(3.0, {1.0: 20.0}, neck=False))
    assert np.isnan(shock.measured_mps2[4])
    assert np.isfinite(shock.measured_mps2[5])


def test_stamps_that_leap_back_end_a_shock():
    predicted, measured = ride(2.0, {0.5: 20.0, 1.8: 30.0})
    shocks = Shocks(5.0)
    for _ in range(2):  # a bag that loops
        shocks.push(predicted, measured)
    assert [s.seat_mps2 for s in shocks.latest()] == pytest.approx([30.0, 20.0, 30.0, 20.0])


@given(cuts=st.lists(st.integers(1, 3999), max_size=12, unique=True), seed=st.integers(0, 5))
def test_block_cuts_change_nothing(cuts, seed):
    drawn = np.random.default_rng(seed)
    pulses = dict(zip(drawn.uniform(0.2, 3.5, 4), drawn.uniform(3.0, 20.0, 4), strict=True))
    whole = found(*ride(4.0, pulses))
    assert plain(found(*ride(4.0, pulses), cuts)) == plain(whole)
    for shock in whole:  # a slow twin: every hit lies in exactly one shock, and none within its reach is left out
        seat = np.abs(ride(4.0, pulses)[1].accel_mps2[:, 0])
        hits = ride(4.0, pulses)[1].stamps_ns[seat >= 5.0]
        assert shock.begin_ns in hits
        assert shock.last_ns in hits
        assert not np.any((hits > shock.last_ns) & (hits <= shock.last_ns + SEPARATION_NS))
