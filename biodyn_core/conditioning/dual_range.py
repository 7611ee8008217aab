"""Dual range: a corrected 200 g channel replaces a 16 g channel of the same sensor at its rail, axis by axis.

Spans at the rail, interpolation of the wide channel, and fading between both. `range_alignment` measures the errors of
the wide channel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.arrays import Flags, Floats, Integers
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings

Signs = NDArray[np.int8]

HIGH_RAIL_MPS2: Final = 0.995 * 200.0 * STANDARD_GRAVITY_MPS2
"""The 200 g channel is at its own rail from here on."""

MARGIN: Final = 2
"""Samples on either side of a saturated one that are replaced too: the sensor's own low-pass smears its rail."""

FADE: Final = 4
"""Samples beyond these over which the channels fade into each other, as a raised cosine, without a step."""

GUARD: Final = 16
"""Samples beyond the rail, on either side, that are excluded from the comparison of the channels."""

MIN_AGREEMENT: Final = 0.8
"""If one channel is at its rail, the other must reach this share of it; else they measure different motions."""

_HALF: Final = 16
_SHAPE: Final = 5.65
"""Of the Kaiser window: 60 dB outside a band edge, which is 180 Hz wide for 32 samples at 1600 Hz."""

_EDGE: Final = 0.43
"""-6 dB of the interpolator per rate of the slower channel: 484 Hz of 1125 Hz, without aliasing below 470 Hz."""


class Span(NamedTuple):
    """An axis at its rail, above or below (sign), from its first sample to its last, seconds."""

    axis: int
    sign: int
    begin_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """Both channels around some saturations: low_mps2 (n, 3) at low_s (n,), high_mps2 (m, 3) at high_s (m,), ascending.

    low_hz: rate of the fine channel. shared: both have the same instants already and are not interpolated.
    """

    low_s: Floats
    low_mps2: Floats
    high_s: Floats
    high_mps2: Floats
    low_hz: float
    shared: bool = False


def saturated(low_mps2: Floats, settings: DualRangeSettings) -> Signs:
    """Side of readings (n, 3) at the rail, axis by axis: 1 above, -1 below, 0 for others and for those not finite."""
    over = np.abs(low_mps2) >= settings.saturation_mps2
    return np.where(over, np.sign(low_mps2), 0.0).astype(np.int8)


def spans(number: Integers, low_s: Floats, sides: Signs) -> list[Span]:
    """The saturations of a stream, in order of their start, from its saturated samples alone.

    number (k,): index among all samples of the stream; consecutive samples of one axis and side are one span. low_s
    (k,), sides (k, 3): as of `saturated`.
    """
    found = []
    for axis in range(3):
        for sign in (1, -1):
            here = np.flatnonzero(sides[:, axis] == sign)
            cuts = np.flatnonzero(np.diff(number[here]) != 1) + 1
            groups = np.split(here, cuts) if here.size else []
            found += [Span(axis, sign, float(low_s[group[0]]), float(low_s[group[-1]])) for group in groups]
    return sorted(found, key=lambda span: span.begin_s)


def read_at(times_s: Floats, values: Floats, at_s: Floats, slower_hz: float) -> Floats:
    """Interpolate samples (m, k) at other instants (n,), band-limited to the slower of the two rates: (n, k).

    A Kaiser-windowed sinc through 32 samples, its weights normalised to a sum of one. NaN where any of the samples is
    missing: at the ends, across a gap, and near a NaN.
    """
    out = np.full((at_s.size, values.shape[1]), np.nan)
    if times_s.size < 2 * _HALF:
        return out
    period = float(np.median(np.diff(times_s)))
    after = np.searchsorted(times_s, at_s, side="right")
    inside = (after >= _HALF) & (after + _HALF <= times_s.size)
    first = np.where(inside, after - _HALF, 0)
    whole = inside & (times_s[first + 2 * _HALF - 1] - times_s[first] < (2 * _HALF - 0.5) * period)
    which = np.flatnonzero(whole)
    kernel = _kernel(_EDGE * min(slower_hz * period, 1.0))
    for begin in range(0, which.size, 1 << 14):
        part = which[begin : begin + (1 << 14)]
        index = first[part, None] + np.arange(2 * _HALF)
        distance = at_s[part, None] - times_s[index]
        weight = np.interp(np.abs(distance) / period, *kernel)
        weight /= weight.sum(axis=1, keepdims=True)
        out[part] = np.einsum("ij,ijk->ik", weight, values[index])
    return out


def _kernel(edge: float) -> tuple[Floats, Floats]:
    """The interpolator's weight (n,) by distance in samples (n,), finely tabulated; edge in cycles per sample."""
    distance = np.linspace(0.0, _HALF, 1 << 15)
    window = np.i0(_SHAPE * np.sqrt(np.clip(1.0 - (distance / _HALF) ** 2, 0.0, 1.0)))
    return distance, np.sinc(2.0 * edge * distance) * window


def read_wide(stretch: Stretch, delay_s: float) -> Floats:
    """The wide channel at the instants of the fine one (n, 3); NaN without a sample, or at its own rail."""
    high = np.where(np.abs(stretch.high_mps2) < HIGH_RAIL_MPS2, stretch.high_mps2, np.nan)
    if not stretch.shared:
        return read_at(stretch.high_s, high, stretch.low_s + delay_s, stretch.low_hz)
    if not stretch.high_s.size:
        return np.full(stretch.low_mps2.shape, np.nan)
    at = np.minimum(np.searchsorted(stretch.high_s, stretch.low_s), stretch.high_s.size - 1)
    return np.where((stretch.high_s[at] == stretch.low_s)[:, None], high[at], np.nan)


def usable(low_mps2: Floats, settings: DualRangeSettings) -> Flags:
    """Flags (n,) of samples of the fine channel that are finite and far enough from any rail, on all axes."""
    bad = (saturated(low_mps2, settings) != 0).any(axis=1) | ~np.isfinite(low_mps2).all(axis=1)
    return ~_widened(bad, GUARD)


def covered(found: Sequence[Span], stretch: Stretch, corrected_mps2: Floats, settings: DualRangeSettings) -> list[Span]:
    """The spans in which the wide channel is complete and reaches the rail as well."""
    kept = []
    for span in found:
        first, last = np.searchsorted(stretch.low_s, (span.begin_s, span.end_s))
        reach = MARGIN + FADE
        values = corrected_mps2[max(first - reach, 0) : last + reach + 1, span.axis]
        inside = corrected_mps2[first : last + 1, span.axis]
        if not inside.size:
            continue  # its stamps are damaged
        if np.isfinite(values).all() and (span.sign * inside).max() >= MIN_AGREEMENT * settings.saturation_mps2:
            kept.append(span)
    return kept


def shares(low_s: Floats, period_s: float, taken: Sequence[Span], left: Sequence[Span] = ()) -> Floats:
    """Share of the wide channel in each reading, 0 to 1, (n, 3); a function of time alone.

    taken: spans that the wide channel replaces. left: spans that stay at the rail, even beside a replaced one: a blend
    would hide that they are clipped.
    """
    out = np.zeros((low_s.size, 3))
    reach_s = (MARGIN + FADE + 0.5) * period_s
    for span in taken:
        lo, hi = np.searchsorted(low_s, (span.begin_s - reach_s, span.end_s + reach_s))
        if lo == hi:
            continue
        t = low_s[lo:hi]
        beyond = np.maximum(np.maximum(span.begin_s - t, t - span.end_s), 0.0) / period_s
        fade = np.clip((beyond - MARGIN) / (FADE + 1.0), 0.0, 1.0)
        share = 0.5 + 0.5 * np.cos(np.pi * fade)
        share[fade >= 1.0 - 1e-6] = 0.0
        out[lo:hi, span.axis] = np.maximum(out[lo:hi, span.axis], share)
    for span in left:
        lo, hi = np.searchsorted(low_s, span.begin_s), np.searchsorted(low_s, span.end_s, side="right")
        out[lo:hi, span.axis] = 0.0
    return out


def merged(low_mps2: Floats, corrected_mps2: Floats, share: Floats) -> Floats:
    """The fine channel, with the corrected wide one at its rail, (n, 3)."""
    return np.where(
        share > 0.0, (1.0 - share) * low_mps2 + share * np.where(share > 0.0, corrected_mps2, 0.0), low_mps2
    )


def _widened(flags: Flags, by: int) -> Flags:
    """The flags with so many neighbours on either side."""
    if not flags.size:
        return flags
    ones = np.convolve(flags.astype(np.int64), np.ones(2 * by + 1, dtype=np.int64), mode="full")
    return ones[by : by + flags.size] > 0
