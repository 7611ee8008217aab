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

from biodyn_core.base.arrays import Floats
from biodyn_core.conditioning.gravity import STUCK_MPS2
from biodyn_core.recording.flags import stretches
from biodyn_core.sessions.bins import Bins
from biodyn_core.sessions.digest import LEVELLED, SQUARE
from biodyn_core.sessions.settings import SessionSettings

QUIETEST_SHARE: Final = 0.05
"""The share of a session, by its quietest half seconds, that shows how still the vehicle can be."""

ONE_STOP_S: Final = 5.0
"""In a shorter time no vehicle comes from a stop on one slope to a stop on another."""


@dataclass(frozen=True)
class _Quiet:
    """A quiet part of a session with one mean reading (3,); is_constant: the seat repeats one reading in most of it."""

    begin_s: float
    end_s: float
    mean_mps2: Floats
    is_constant: bool

    @property
    def seconds(self) -> float:
        return self.end_s - self.begin_s


def find_rests(coarse: Bins, settings: SessionSettings) -> list[tuple[float, float]]:
    """The stretches in which the seat does not move: quiet for the session, with the mean reading of a stop.

    A seat that repeats one reading is stuck, or too coarse to show its noise: such a rest counts without another alone.
    """
    s, width_s = settings, coarse.width_s
    there = coarse.counts > 0.0
    if not there.any():
        return []
    full = coarse.counts >= 0.5 * np.median(coarse.counts[there])
    counts = np.where(full, coarse.counts, 1.0)[:, None]
    mean = coarse.sums[:, LEVELLED] / counts
    spread = np.sqrt(np.maximum(coarse.sums[:, SQUARE] / counts[:, 0] - (mean**2).sum(axis=1), 0.0))
    stuck = full & (spread < STUCK_MPS2)
    varied = full & ~stuck if (full & ~stuck).any() else full
    quietest = float(np.quantile(spread[varied], QUIETEST_SHARE))
    quiet = full & (spread <= min(s.rest_level_mps2, max(s.rest_floor_mps2, s.rest_ratio * quietest)))
    parts = [
        _Quiet(begin * width_s, end * width_s, mean[begin:end].mean(axis=0), float(stuck[begin:end].mean()) > 0.5)
        for first, last in stretches(quiet)
        for begin, end in _with_one_mean(mean, first, last, s.rest_drift_mps2)
        if (end - begin) * width_s >= s.rest_least_s
    ]
    parts = [part for part in parts if not part.is_constant] or parts
    return [(part.begin_s, part.end_s) for part in _standing(parts, s.rest_drift_mps2)]


def _with_one_mean(mean: Floats, first: int, last: int, drift_mps2: float) -> Iterator[tuple[int, int]]:
    """The parts of a stretch of intervals whose means (b, 3) stay near the mean of the part so far."""
    begin, total = first, mean[first].copy()
    for at in range(first + 1, last):
        if np.linalg.norm(mean[at] - total / (at - begin)) > drift_mps2:
            yield begin, at
            begin, total = at, np.zeros(3)
        total += mean[at]
    yield begin, last


def _standing(parts: Sequence[_Quiet], drift_mps2: float) -> Iterator[_Quiet]:
    """Of parts of one stop with different means, those whose mean has the most time of the session."""
    if not parts:
        return
    means = np.array([part.mean_mps2 for part in parts])
    alike = np.linalg.norm(means[:, None] - means, axis=2) <= drift_mps2
    time_s = alike @ np.array([part.seconds for part in parts])
    gaps_s = [after.begin_s - before.end_s for before, after in pairwise(parts)]
    for stop in np.split(np.arange(len(parts)), np.flatnonzero(np.array(gaps_s) > ONE_STOP_S) + 1):
        for at in stop:
            if (alike[at, stop] | (time_s[at] >= time_s[stop])).all():
                yield parts[at]
