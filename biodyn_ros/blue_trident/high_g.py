"""Compares the high-g and low-g channels of one sensor around saturations, and replaces saturated low-g values."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.conditioning.dual_range import Span, Stretch, covered, merged, shares
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings
from biodyn_core.conditioning.range_alignment import (
    Alignment,
    align,
    bias,
    corrected,
    levels,
    plausible,
    variance,
)
from biodyn_ros.blue_trident.cleaning import MAX_PLAUSIBLE_MPS2, Cleaner
from biodyn_ros.blue_trident.samples import Channel, Samples
from biodyn_ros.blue_trident.survey import SensorSurvey

LONGEST_SPAN_S: Final = 1.0
"""Real saturations are shorter; a value that stays at the limit for longer is a fault and is not replaced."""

GROUP_S: Final = 60.0
COMPARED_S: Final = 60.0
"""Gain and delay are estimated from the first stretches up to this length, to bound memory; bias is always local."""

BESIDE_S: Final = 0.1
"""Time around a saturation for which both channels are kept: more than the sum of delay, margins and sample period."""


@dataclass(frozen=True, eq=False)
class Replacement:
    """High-g values that replace low-g: weights share (k, 3) of values right_mps2 (k, 3) at stamps_ns (k,).

    variance (k, 3): of these values, m^2/s^4, 0 for axes that they do not replace.
    replaced and remaining: spans of saturation; bias_mps2 (3,): the mean of all stretches.
    """

    stamps_ns: Integers
    share: Floats
    right_mps2: Floats
    variance: Floats
    alignment: Alignment
    bias_mps2: Floats
    replaced: tuple[Span, ...]
    remaining: tuple[Span, ...]

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes on which high-g replaces clipped values."""
        return tuple(sorted({span.axis for span in self.replaced}))

    def applied(self, samples: Samples) -> tuple[Samples, Floats, Floats]:
        """Samples with high-g instead of saturated values, the weight of high-g (n, 3), and its variance (n, 3)."""
        share, spread = np.zeros(samples.accel_mps2.shape), np.zeros(samples.accel_mps2.shape)
        if not self.stamps_ns.size:
            return samples, share, spread
        at = np.minimum(np.searchsorted(self.stamps_ns, samples.stamps_ns), self.stamps_ns.size - 1)
        here = self.stamps_ns[at] == samples.stamps_ns
        share[here], spread[here] = self.share[at[here]], self.variance[at[here]]
        mixed = merged(samples.accel_mps2, self.right_mps2[at], share)
        return samples._replace(accel_mps2=mixed), share, spread


@dataclass(frozen=True, eq=False)
class _Near:
    """A reduced stretch: both channels close to its saturations, and `levels` of the whole stretch."""

    spans: tuple[Span, ...]
    part: Stretch
    whole: Stretch | None
    levels_mps2: Floats | None


class Comparison:
    """`push` the blocks of both channels of one sensor in order of time; `finish` returns the replacement."""

    def __init__(self, seen: SensorSurvey, settings: DualRangeSettings, shared: bool) -> None:
        self._settings, self._shared = settings, shared
        self._epoch_ns, self._rate_hz = seen.first_ns, seen.rate_hz() or 1.0
        found = seen.spans()
        self._stuck = [span for span in found if span.end_s - span.begin_s > LONGEST_SPAN_S]
        self._groups = _grouped([span for span in found if span.end_s - span.begin_s <= LONGEST_SPAN_S], settings)
        self._begins = np.array([group[0].begin_s for group in self._groups]) - settings.compared_s - BESIDE_S
        ends = np.array([max(span.end_s for span in group) for group in self._groups])
        self._ends = np.maximum.accumulate(ends + settings.compared_s + BESIDE_S)
        self._cleaner = Cleaner()
        self._rows: dict[Channel, tuple[Floats, Floats]] = {
            channel: (np.empty(0), np.empty((0, 3))) for channel in ("low", "high")
        }
        self._held = dict(self._rows)
        self._upto: dict[Channel, float] = {"low": -np.inf, "high": -np.inf}
        self._done = 0
        self._near: list[_Near] = []
        self._whole_s = 0.0

    def push(self, channel: Channel, samples: Samples) -> None:
        """Add a block of either channel."""
        if channel == "low":
            samples = self._cleaner.push(samples)
        self._keep(channel, samples)
        self._digest(final=False)

    def finish(self) -> Replacement:
        """Compare the channels, and replace saturated values where possible."""
        if (last := self._cleaner.finish()) is not None:
            self._keep("low", last)
        for channel, (time_s, accel_mps2) in self._held.items():
            self._add(channel, np.append(time_s, np.inf), accel_mps2)
        self._digest(final=True)
        alignment = align([near.whole for near in self._near if near.whole is not None], self._settings)
        biases = [None if near.levels_mps2 is None else bias(near.levels_mps2, alignment) for near in self._near]
        known = [value for value in biases if value is not None]
        mean = np.mean(known, axis=0) if known else np.zeros(3)
        stamps, share, right, spread = [], [], [], []
        replaced: list[Span] = []
        if known and plausible(alignment):
            for near, value in zip(self._near, biases, strict=True):
                values = corrected(near.part, alignment, mean if value is None else value)
                kept = covered(near.spans, near.part, values, self._settings)
                here = set(kept)
                left = [*self._stuck, *(span for span in near.spans if span not in here)]
                of_each = shares(near.part.low_s, 1.0 / self._rate_hz, kept, left)
                used = of_each.any(axis=1)
                replaced += kept
                stamps.append(self._epoch_ns + np.rint(1e9 * near.part.low_s[used]).astype(np.int64))
                share.append(of_each[used])
                right.append(values[used])
                of_values = variance(near.part, alignment, values)
                spread.append(np.where(of_each > 0.0, of_values, 0.0)[used])
        done = set(replaced)
        remaining = [*self._stuck, *(span for near in self._near for span in near.spans if span not in done)]
        order = _in_order(stamps, share, right, spread)
        return Replacement(*order, alignment, mean, tuple(replaced), tuple(remaining))

    def _keep(self, channel: Channel, samples: Samples) -> None:
        """Add the samples around saturations but the last one, whose stamp is judged by the next one."""
        if not len(samples.stamps_ns) or not len(self._groups):
            return
        held_s, held = self._held[channel]
        time_s = np.concatenate([held_s, 1e-9 * (samples.stamps_ns - self._epoch_ns)])
        accel = np.concatenate([held, samples.accel_mps2])
        self._held[channel] = time_s[-1:], accel[-1:]
        self._add(channel, time_s, accel[:-1])

    def _add(self, channel: Channel, time_s: Floats, accel: Floats) -> None:
        """Add samples (n, 3) around saturations; time_s (n + 1,): of them and of the next one."""
        wanted = _ascending(time_s, self._upto[channel])
        time_s = time_s[:-1]
        if not wanted.any():
            return
        self._upto[channel] = float(time_s[wanted][-1])
        group = np.searchsorted(self._begins, time_s, side="right") - 1
        wanted &= (group >= 0) & (time_s <= self._ends[np.maximum(group, 0)])
        if channel == "high":
            wanted &= (accel != 0.0).any(axis=1) & (np.abs(accel) < MAX_PLAUSIBLE_MPS2).all(axis=1)
        if wanted.any():
            old_s, old = self._rows[channel]
            self._rows[channel] = np.concatenate([old_s, time_s[wanted]]), np.concatenate([old, accel[wanted]])

    def _digest(self, final: bool) -> None:
        """Reduce every stretch that both channels have passed."""
        while self._done < len(self._groups) and (final or min(self._upto.values()) > self._ends[self._done]):
            begin_s, end_s = float(self._begins[self._done]), float(self._ends[self._done])
            whole = self._stretch(begin_s, end_s)
            self._near.append(self._reduced(self._groups[self._done], whole))
            self._done += 1
            after_s = float(self._begins[self._done]) if self._done < len(self._groups) else np.inf
            for channel, (time_s, values) in self._rows.items():
                keep = int(np.searchsorted(time_s, after_s))
                self._rows[channel] = time_s[keep:].copy(), values[keep:].copy()

    def _stretch(self, begin_s: float, end_s: float) -> Stretch:
        parts = []
        for channel in ("low", "high"):
            time_s, values = self._rows[channel]
            lo, hi = np.searchsorted(time_s, (begin_s, end_s))
            parts += [time_s[lo:hi], values[lo:hi]]
        return Stretch(parts[0], parts[1], parts[2], parts[3], self._rate_hz, self._shared)

    def _reduced(self, group: Sequence[Span], whole: Stretch) -> _Near:
        low, high = (_close(times_s, group) for times_s in (whole.low_s, whole.high_s))
        part = dataclasses.replace(
            whole, low_s=whole.low_s[low], low_mps2=whole.low_mps2[low], high_s=whole.high_s[high],
            high_mps2=whole.high_mps2[high],
        )  # fmt: skip
        found = levels(whole, self._settings)
        kept = whole if self._whole_s < COMPARED_S and found is not None else None
        if kept is not None:
            self._whole_s += float(whole.low_s[-1] - whole.low_s[0])
        return _Near(tuple(group), part, kept, found)


def _ascending(time_s: Floats, before_s: float) -> Flags:
    """Flags of the samples but the last that ascend from a time on, without those behind them and outliers ahead.

    A time after which the next one is earlier, but still later than the one before it, is an outlier: it must not put
    all later samples behind it.
    """
    now_s, next_s = time_s[:-1], time_s[1:]
    outlier = (next_s < now_s) & (next_s > np.concatenate([[before_s], now_s[:-1]])[: now_s.size])
    latest_s = np.maximum.accumulate(np.concatenate([[before_s], np.where(outlier, -np.inf, now_s)]))
    return np.asarray(~outlier & (now_s > latest_s[:-1]))


def _in_order(
    stamps: list[Integers], share: list[Floats], right: list[Floats], spread: list[Floats]
) -> tuple[Integers, Floats, Floats, Floats]:
    """All values in order of time, without duplicates of overlapping stretches."""
    if not stamps:
        return np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3))
    _, first = np.unique(np.concatenate(stamps), return_index=True)
    values = [np.concatenate(parts)[first] for parts in (share, right, spread)]
    return np.concatenate(stamps)[first], values[0], values[1], values[2]


def _grouped(found: Sequence[Span], settings: DualRangeSettings) -> list[list[Span]]:
    """Groups of spans whose surroundings overlap, of a minute at most; a cut is never within a shock."""
    groups: list[list[Span]] = []
    end_s = -np.inf
    for span in found:
        near_s = end_s + 2.0 * BESIDE_S
        if groups and span.begin_s < max(
            near_s, min(end_s + 2.0 * settings.compared_s, groups[-1][0].begin_s + GROUP_S)
        ):
            groups[-1].append(span)
            end_s = max(end_s, span.end_s)
        else:
            groups.append([span])
            end_s = span.end_s
    return groups


def _close(times_s: Floats, group: Sequence[Span]) -> Integers:
    """Indices of the times within `BESIDE_S` of a span."""
    edges = np.zeros(times_s.size + 1, dtype=np.int64)
    begins = np.searchsorted(times_s, [span.begin_s - BESIDE_S for span in group])
    ends = np.searchsorted(times_s, [span.end_s + BESIDE_S for span in group])
    np.add.at(edges, begins, 1)
    np.add.at(edges, ends, -1)
    return np.flatnonzero(np.cumsum(edges[:-1]) > 0)
