"""Rests: the stretches of a session in which the vehicle stands still, in the sums of its seat.

A vehicle that gathers speed evenly can be as quiet as at a stop. Its mean reading then differs from that of the stop
before or after it, and of the two the rest is the one whose mean more of the session's quiet time has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.recording.flags import stretches
from biodyn_core.sessions.bins import Bins
from biodyn_core.sessions.digest import LEVELLED, SQUARE, repeats_in
from biodyn_core.sessions.repeats import unsure
from biodyn_core.sessions.settings import SessionSettings

QUIETEST_SHARE: Final = 0.05
"""The share of a session, by its quietest half seconds, that shows how still the vehicle can be."""

MOVING_INTERVALS: Final = 10
MOVING_SHARE: Final = 0.75
"""The other sensors move where they do so in this share of 5 s: a person who nods at a stop does not."""

ONE_STOP_S: Final = 5.0
"""In a shorter time no vehicle comes from a stop on one slope to a stop on another."""


@dataclass(frozen=True)
class _Quiet:
    """A quiet part of a session by its intervals, with one mean reading (3,)."""

    begin: int
    end: int
    mean_mps2: Floats


class Beside(NamedTuple):
    """The sensors beside the seat, by interval (b,): whether one of them is quiet, and whether all of them move."""

    quiet: Flags
    moving: Flags


def beside(rms_mps2: Sequence[Floats], settings: SessionSettings) -> Beside:
    """Judge the other sensors of a session by the rms (b,) of each, NaN where it has none or repeats one reading."""
    known = [rms for rms in rms_mps2 if np.isfinite(rms).any()]
    quiet = [rms <= _quiet_mps2(rms[np.isfinite(rms)], settings) for rms in known]
    moves = np.all([~(rms <= settings.rest_level_mps2) for rms in known], axis=0)
    read = np.any([np.isfinite(rms) for rms in known], axis=0)
    share = scipy.ndimage.uniform_filter1d((moves & read).astype(np.float64), MOVING_INTERVALS, mode="constant")
    return Beside(np.any(quiet, axis=0), share >= MOVING_SHARE)


def _quiet_mps2(rms_mps2: Floats, settings: SessionSettings) -> float:
    """The largest rms of half a second, (b,), that is quiet for a sensor in this session."""
    s = settings
    return min(s.rest_level_mps2, max(s.rest_floor_mps2, s.rest_ratio * float(np.quantile(rms_mps2, QUIETEST_SHARE))))


def find_rests(coarse: Bins, settings: SessionSettings, others: Beside | None = None) -> list[tuple[float, float]]:
    """The stretches in which the seat does not move: quiet for the session, with the mean reading of a stop.

    A seat that repeats one reading is stuck, or too coarse to show its noise. Such a stretch is a rest if another
    sensor is quiet in it, or if the seat returns to its reading after motion. If no stretch is left, all are rests in
    which the others do not move. others: the sensors beside the seat, None without any.
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
    quiet = full & (spread <= _quiet_mps2(spread[varied], s))
    known = np.zeros_like(full)
    if others is not None:
        known = others.quiet
        quiet &= ~(repeats & others.moving)
    parts = [
        _Quiet(begin, end, mean[begin:end].mean(axis=0))
        for first, last in stretches(quiet)
        for begin, end in _with_one_mean(mean, first, last, s.rest_drift_mps2)
        if (end - begin) * width_s >= s.rest_least_s
    ]
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
