"""The bins of a stream for the live page: a tenth of a second, whole and once, however blocks are cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from biodyn_ros.reports.downsampling import BIN_NS, MinMaxDownsampler

EPOCH_NS = 1_700_000_000_000_000_000


def taken(stamps_ns, accel, cuts=()):
    """All bins of a stream cut into blocks, as rows."""
    bins, rows = MinMaxDownsampler(accel.shape[1]), []
    for begin, end in pairwise([0, *sorted(cuts), stamps_ns.size]):
        bins.add(stamps_ns[begin:end], accel[begin:end])
        rows += [(b, *lo, *hi) for b, lo, hi in zip(*(part.tolist() for part in bins.take()), strict=True)]
    return rows


def test_bins_hold_minimum_and_maximum_and_the_newest_is_open():
    stamps_ns = EPOCH_NS + np.arange(0, 450) * 1_000_000
    rising = np.arange(450.0)[:, None]
    assert taken(stamps_ns, rising) == [(EPOCH_NS + k * BIN_NS, 100.0 * k, 100.0 * k + 99.0) for k in range(4)]


def test_a_channel_without_samples_is_nan():
    stamps_ns = EPOCH_NS + np.arange(0, 250) * 1_000_000
    ((_, low, _), _) = taken(stamps_ns, np.full((250, 1), np.nan))
    assert np.isnan(low)


@given(cuts=st.lists(st.integers(1, 1999), max_size=20, unique=True), seed=st.integers(0, 9))
def test_block_cuts_change_nothing(cuts, seed):
    drawn = np.random.default_rng(seed)
    stamps_ns = EPOCH_NS + np.cumsum(drawn.integers(500_000, 1_200_000, 2000))
    accel = drawn.normal(size=(2000, 2))
    rows = taken(stamps_ns, accel, cuts)
    assert rows == taken(stamps_ns, accel)
    slow = {}  # a twin, sample by sample
    for stamp, row in zip(stamps_ns.tolist(), accel, strict=True):
        slow.setdefault(stamp // BIN_NS * BIN_NS, []).append(row)
    last = max(slow)
    assert rows == [(b, *np.min(v, axis=0), *np.max(v, axis=0)) for b, v in slow.items() if b != last]
