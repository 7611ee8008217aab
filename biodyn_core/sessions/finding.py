"""Finding: groups of shocks and steady stretches between the rests, in the sums of a seat.

A shock exceeds `shock_g`, and the level around it `shock_crest` times. Shocks that follow each other are a group; a
group with several single strikes is a train of shocks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.base.wording import counted
from biodyn_core.body.model import WARM_UP_S
from biodyn_core.recording.flags import stretches
from biodyn_core.sessions.bins import Bins
from biodyn_core.sessions.digest import COARSE_S, HIGH, LOW_PASSED
from biodyn_core.sessions.rests import Beside, find_rests
from biodyn_core.sessions.settings import SessionSettings

Kind = Literal["train", "shock", "steady"]

SEAT_GAP_S: Final = 0.1
"""A longer gap of the seat ends an event: nothing can be predicted across it."""

LEVEL_QUANTILE: Final = 0.25
"""Of half seconds around a shock: three quarters of them may hold shocks. In a steady drive it is 0.9 of the rms."""


@dataclass(frozen=True)
class Group:
    """Shocks that follow each other: the first and last time, and time, size and number of the single strikes."""

    begin_s: float
    end_s: float
    peak_s: float
    peak_mps2: float
    strikes: int


@dataclass(frozen=True)
class Window:
    """A part of a session with its groups of shocks; a steady stretch has none."""

    begin_s: float
    end_s: float
    groups: tuple[Group, ...] = ()

    @property
    def largest(self) -> Group | None:
        """The group of the largest shock."""
        return max(self.groups, key=lambda group: group.peak_mps2, default=None)

    def kind(self, settings: SessionSettings) -> Kind:
        """The kind of its largest shock; a group of several single strikes is a train."""
        largest = self.largest
        if largest is None:
            return "steady"
        return "train" if largest.strikes >= settings.train_strikes else "shock"


@dataclass(frozen=True)
class Found:
    """What a seat shows: rests (begin, end), windows in order of time, and shocks left out, with the reason."""

    rests: tuple[tuple[float, float], ...]
    windows: tuple[Window, ...]
    left_out: tuple[str, ...]


def find(coarse: Bins, fine: Bins, settings: SessionSettings | None = None, others: Beside | None = None) -> Found:
    """Find rests, shocks and steady stretches; others: see `find_rests`."""
    s = settings or SessionSettings()
    resting = find_rests(coarse, s, others)
    shocks_at = find_shocks(fine, s)
    windows: list[Window] = []
    left_out: list[str] = []
    for begin_s, end_s in _continuous(fine):
        early, groups = _groups(fine, shocks_at, begin_s, end_s, s)
        shocks = _shock_windows(groups, begin_s, end_s, s)
        taken = [*resting, *_extents(shocks), *((one.begin_s, one.end_s + s.tail_s) for one in early)]
        windows += [*shocks, *_steady_windows(fine, taken, begin_s, end_s, s)]
        left_out += [_early_line(early, begin_s)] if early else []
    return Found(tuple(resting), tuple(sorted(windows, key=lambda window: window.begin_s)), tuple(left_out))


def find_shocks(fine: Bins, settings: SessionSettings) -> Integers:
    """The numbers of the intervals in which the seat has a shock, ascending."""
    s = settings
    level = np.maximum(s.shock_g * STANDARD_GRAVITY_MPS2, s.shock_crest * _level_mps2(fine, s.around_s))
    return np.flatnonzero(fine.maxima[:, 0] >= level)


def _groups(
    fine: Bins, shocks_at: Integers, begin_s: float, end_s: float, s: SessionSettings
) -> tuple[list[Group], list[Group]]:
    """The shocks in the warm-up of a stretch of the seat, each alone, and the groups of the later ones."""
    width_s = fine.width_s
    inside = shocks_at[(shocks_at >= round(begin_s / width_s)) & (shocks_at < round(end_s / width_s))]
    single = _apart(inside, s.strike_apart_s / width_s)
    early = [part for part in single if part[0] * width_s - begin_s < WARM_UP_S]
    later = _apart(inside[sum(part.size for part in early) :], s.apart_s / width_s)
    first, second = (
        [_group(fine.maxima[:, 0], int(part[0]), int(part[-1]) + 1, width_s, s) for part in parts]
        for parts in (early, later)
    )
    return first, second


def _apart(at: Integers, most: float) -> list[Integers]:
    """Numbers (n,), ascending, divided where two neighbours differ by more."""
    return np.split(at, np.flatnonzero(np.diff(at) > most) + 1) if at.size else []


def level_of(fine: Bins, begin_s: float, end_s: float) -> float:
    """The rms of the low-passed vertical acceleration, m/s^2."""
    return rms_of(fine, LOW_PASSED, begin_s, end_s)


def rms_of(fine: Bins, column: int, begin_s: float, end_s: float) -> float:
    """The rms of a column of the seat's sums; 0 without samples."""
    here = fine.extent(begin_s, end_s)
    count = fine.counts[here].sum()
    return float(np.sqrt(fine.sums[here, column].sum() / count)) if count else 0.0


def is_idling(fine: Bins, begin_s: float, end_s: float, settings: SessionSettings) -> bool:
    """Whether a stretch has the spectrum of an engine that idles."""
    s, level = settings, level_of(fine, begin_s, end_s)
    high = rms_of(fine, HIGH, begin_s, end_s)
    return level <= s.idle_level_mps2 and high**2 >= s.idle_share * level**2


def _level_mps2(fine: Bins, around_s: float) -> Floats:
    """The level around each interval, rms: a low quantile over half seconds, on which a few shocks have no weight."""
    each = round(COARSE_S / fine.width_s)
    short = -fine.counts.size % each
    squares, counts = (
        np.append(values, np.zeros(short)).reshape(-1, each).sum(axis=1)
        for values in (fine.sums[:, LOW_PASSED], fine.counts)
    )
    present = counts > 0.0
    level = np.zeros(counts.size)
    if present.any():
        rms = np.sqrt(squares[present] / counts[present])
        size = max(3, round(around_s / COARSE_S)) | 1
        level[present] = scipy.ndimage.percentile_filter(rms, 100.0 * LEVEL_QUANTILE, size=size, mode="nearest")
    return np.repeat(level, each)[: fine.counts.size]


def _group(peaks: Floats, begin: int, end: int, width_s: float, s: SessionSettings) -> Group:
    """The group whose shocks lie in these intervals; weaker strikes just before and after them count too."""
    largest = float(peaks[begin:end].max())
    around = round(s.apart_s / width_s)
    padded = np.concatenate([[0.0], peaks[max(0, begin - around) : end + around], [0.0]])
    strikes, _ = scipy.signal.find_peaks(
        padded, height=s.strike_share * largest, distance=max(1, round(s.strike_apart_s / width_s))
    )
    peak_s = (begin + int(peaks[begin:end].argmax()) + 0.5) * width_s
    return Group(begin * width_s, end * width_s, peak_s, largest, len(strikes))


def _continuous(fine: Bins) -> Iterator[tuple[float, float]]:
    """The stretches (begin, end) of a seat without gaps."""
    present: Flags = fine.counts > 0.0
    half_gap = max(1, round(SEAT_GAP_S / fine.width_s / 2.0))
    closed = np.asarray(scipy.ndimage.binary_closing(present, iterations=half_gap))
    for begin, end in stretches(closed | present):
        yield begin * fine.width_s, end * fine.width_s


def _early_line(early: Sequence[Group], begin_s: float) -> str:
    """The shocks that are left out, with the reason."""
    first, last = early[0], early[-1]
    shocks = f"a shock at {first.peak_s:.1f} s is"
    if len(early) > 1:
        shocks = f"{counted(len(early), 'shock')} from {first.peak_s:.1f} to {last.peak_s:.1f} s are"
    return f"{shocks} left out: the seat's samples begin at {begin_s:.1f} s, and {WARM_UP_S:g} s of warm-up are needed"


def _shock_windows(groups: Sequence[Group], begin_s: float, end_s: float, s: SessionSettings) -> list[Window]:
    """The windows around groups in a stretch of the seat; groups too near for tail and warm-up share one."""
    windows: list[Window] = []
    for group in groups:
        found = Window(max(begin_s, group.begin_s - s.lead_s), min(end_s, group.end_s + s.tail_s), (group,))
        last = windows[-1] if windows else None
        if last is None or last.end_s <= found.begin_s:
            windows.append(found)
            continue
        after_s = last.groups[-1].end_s + s.tail_s
        if group.begin_s - after_s >= WARM_UP_S:
            cut_s = max(found.begin_s, after_s)
            windows[-1] = dataclasses.replace(last, end_s=cut_s)
            windows.append(dataclasses.replace(found, begin_s=cut_s))
        else:
            windows[-1] = dataclasses.replace(last, end_s=found.end_s, groups=(*last.groups, group))
    return windows


def _steady_windows(
    fine: Bins, taken: Sequence[tuple[float, float]], begin_s: float, end_s: float, s: SessionSettings
) -> Iterator[Window]:
    """The stretches between rests and shocks that are long and lively enough, divided into equal parts."""
    at_s = begin_s
    for a, b in [*sorted(one for one in taken if one[0] < end_s and one[1] > begin_s), (end_s, end_s)]:
        yield from _divided(fine, at_s, min(a, end_s), s)
        at_s = max(at_s, b)


def _divided(fine: Bins, begin_s: float, end_s: float, s: SessionSettings) -> Iterator[Window]:
    if end_s - begin_s < s.steady_least_s:
        return
    edges = np.linspace(begin_s, end_s, int(np.ceil((end_s - begin_s) / s.steady_longest_s)) + 1).tolist()
    for a, b in pairwise(edges):
        if level_of(fine, a, b) >= s.steady_level_mps2 and not is_idling(fine, a, b, s):
            yield Window(a, b)


def _extents(windows: Sequence[Window]) -> list[tuple[float, float]]:
    return [(window.begin_s, window.end_s) for window in windows]
