"""Rests: the stretches of a session in which the vehicle stands still, in the sums of its seat.

A vehicle that gathers speed evenly can be as quiet as at a stop. Its mean reading then differs from that of the stop
before or after it, and of the two the rest is the one whose mean more of the session's quiet time has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.recording.flags import stretches
from biodyn_core.sessions.bins import Bins
from biodyn_core.sessions.digest import LEVELLED, SQUARE, repeats_in
from biodyn_core.sessions.repeats import unsure
from biodyn_core.sessions.settings import SessionSettings

QUIETEST_SHARE: Final = 0.05
"""The share of a session, by its quietest half seconds, that shows how still the vehicle can be."""

ONE_STOP_S: Final = 5.0
"""In a shorter time no vehicle comes from a stop on one slope to a stop on another."""


@dataclass(frozen=True)
class _Quiet:
    """A quiet part of a session by its intervals, with one mean reading (3,)."""

    begin: int
    end: int
    mean_mps2: Floats


def find_rests(coarse: Bins, settings: SessionSettings, others_mps2: Floats | None = None) -> list[tuple[float, float]]:
    """The stretches in which the seat does not move: quiet for the session, with the mean reading of a stop.

    A seat that repeats one reading is stuck, or too coarse to show its noise. Such a stretch is a rest if another
    sensor is quiet in it; without other sensors if the seat returns to its reading after motion. If no stretch is left,
    all are rests in which no other sensor moves. others_mps2 (b,): the least rms of the other sensors in each interval,
    NaN without any.
    """
    s, width_s = settings, coarse.width_s
    there = coarse.counts > 0.0
    if not there.any():
        return []
    full = coarse.counts >= 0.5 * np.median(coarse.counts[there])
    counts = np.where(full, coarse.counts, 1.0)[:, None]
    mean = coarse.sums[:, LEVELLED] / counts
    spread = np.sqrt(np.maximum(coarse.sums[:, SQUARE] / counts[:, 0] - (mean**2).sum(axis=1), 0.0))
    repeats = full & repeats_in(coarse)
    varied = full & ~repeats if (full & ~repeats).any() else full
    quietest = float(np.quantile(spread[varied], QUIETEST_SHARE))
    others = np.full(full.shape, np.nan) if others_mps2 is None else others_mps2
    quiet = full & (spread <= min(s.rest_level_mps2, max(s.rest_floor_mps2, s.rest_ratio * quietest)))
    quiet &= ~(repeats & (others > s.rest_level_mps2))
    parts = [
        _Quiet(begin, end, mean[begin:end].mean(axis=0))
        for first, last in stretches(quiet)
        for begin, end in _with_one_mean(mean, first, last, s.rest_drift_mps2)
        if (end - begin) * width_s >= s.rest_least_s
    ]
    known = others <= s.rest_level_mps2
    parts = _plausible(parts, repeats & ~known, full & ~repeats, s.rest_drift_mps2) or parts
    return [(part.begin * width_s, part.end * width_s) for part in _standing(parts, width_s, s.rest_drift_mps2)]


def _plausible(parts: Sequence[_Quiet], repeats: Flags, changing: Flags, drift_mps2: float) -> list[_Quiet]:
    """The parts in which the seat is not stuck."""
    means = np.array([part.mean_mps2 for part in parts]).reshape(-1, 3)
    doubted = unsure(means, [(part.begin, part.end) for part in parts], repeats, changing, drift_mps2)
    return [part for part, is_unsure in zip(parts, doubted, strict=True) if not is_unsure]


def _with_one_mean(mean: Floats, first: int, last: int, drift_mps2: float) -> Iterator[tuple[int, int]]:
    """The parts of a stretch of intervals whose means (b, 3) stay near the mean of the part so far."""
    begin, total = first, mean[first].copy()
    for at in range(first + 1, last):
        if np.linalg.norm(mean[at] - total / (at - begin)) > drift_mps2:
            yield begin, at
            begin, total = at, np.zeros(3)
        total += mean[at]
    yield begin, last


def _standing(parts: Sequence[_Quiet], width_s: float, drift_mps2: float) -> Iterator[_Quiet]:
    """Of parts of one stop with different means, those whose mean has the most time of the session."""
    if not parts:
        return
    means = np.array([part.mean_mps2 for part in parts])
    alike = np.linalg.norm(means[:, None] - means, axis=2) <= drift_mps2
    intervals = alike @ np.array([part.end - part.begin for part in parts])
    gaps_s = [width_s * (after.begin - before.end) for before, after in pairwise(parts)]
    for stop in np.split(np.arange(len(parts)), np.flatnonzero(np.array(gaps_s) > ONE_STOP_S) + 1):
        for at in stop:
            if (alike[at, stop] | (intervals[at] >= intervals[stop])).all():
                yield parts[at]
