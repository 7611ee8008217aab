"""Dual range: where a 16 g channel is at its rail, a 200 g channel beside it takes over, set right against the first.

The second channel is coarse: its bias is large and wanders with temperature, its scale is off by a few percent, its
clock or its filter may lie a little off. All of that is measured on the spot, over the seconds around saturations in
which the first channel is to be trusted (a *stretch*), by least squares with the fine channel as the regressor, so
that the noise of the coarse one does not shrink its gain:

    high(t) = gain low(t - delay) + bias

gain per axis and one delay for the whole recording, bias per axis and stretch. An axis is taken over for itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biodyn_core.arrays import Flags, Floats, Integers
from biodyn_core.conditioning import ConditioningSettings
from biodyn_core.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.settings import check_settings, setting

Signs = NDArray[np.int8]

HIGH_RAIL_MPS2: Final = 0.995 * 200.0 * STANDARD_GRAVITY_MPS2
"""From here on the 200 g channel is at its own rail."""

MARGIN: Final = 2
"""Samples on either side of a saturated one that are taken over whole: the sensor's own low-pass smears its rail."""

FADE: Final = 4
"""Samples beyond these over which one channel gives way to the other, as a raised cosine, so that there is no step."""

GUARD: Final = 16
"""Samples beyond the rail, either side, that are not trusted in the comparison of the channels."""

LEAST_TRUSTED: Final = 100
"""With fewer samples than this a stretch says nothing of its bias."""

GAIN_ERROR: Final = 0.01
"""A gain is used where its standard error is below this, and a third of what it is off by; else it is 1."""

GAIN_OFF: Final = 0.25
DELAY_ERROR_S: Final = 0.0002
LONGEST_DELAY_S: Final = 0.02
AGREES: Final = 0.8
"""Where one channel is at its rail the other must reach this share of it, or they do not tell of the same motion."""

_STEP_S: Final = 0.001
_BASE: Final = 8
_HALF: Final = 16
_SHAPE: Final = 5.65
"""Of the Kaiser window: 60 dB beside a band edge that 32 samples make 180 Hz wide at 1600 Hz."""

_EDGE: Final = 0.43
"""-6 dB of the reader per rate of the slower channel: 484 Hz of 1125 Hz, so that nothing folds back below 470 Hz."""


@dataclass(frozen=True)
class DualRangeSettings:
    """When the wide channel takes over."""

    saturation_mps2: float = setting(
        ConditioningSettings.saturation_mps2,
        "reading of one axis from which the low-g channel is at its rail",
        "m/s^2", 10.0, 5000.0,
    )  # fmt: skip
    compared_s: float = setting(5.0, "seconds around a saturation over which the channels are compared", "s", 0.5, 60.0)

    def __post_init__(self) -> None:
        check_settings(self)


class Span(NamedTuple):
    """An axis at its rail, above or below (sign), from its first sample to its last, seconds."""

    axis: int
    sign: int
    begin_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """Both channels around some saturations: low_mps2 (n, 3) at low_s (n,), high_mps2 (m, 3) at high_s (m,), ascending.

    low_hz: rate of the fine channel. shared: both were laid on the same instants already, and are not read in between.
    """

    low_s: Floats
    low_mps2: Floats
    high_s: Floats
    high_mps2: Floats
    low_hz: float
    shared: bool = False


@dataclass(frozen=True)
class Alignment:
    """What the wide channel is off by: gain (3,), delay; and the rms of what is left between the two, (3,) m/s^2.

    measured: which of the gains (3,) the data supported; delay_measured: whether they supported the delay.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    delay_s: float = 0.0
    noise_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    measured: tuple[bool, bool, bool] = (False, False, False)
    delay_measured: bool = False


def saturated(low_mps2: Floats, settings: DualRangeSettings) -> Signs:
    """Which readings (n, 3) are at the rail, axis by axis: 1 above, -1 below, 0 if not, nor if not finite."""
    over = np.abs(low_mps2) >= settings.saturation_mps2
    return np.where(over, np.sign(low_mps2), 0.0).astype(np.int8)


def spans(number: Integers, low_s: Floats, sides: Signs) -> list[Span]:
    """The saturations of a stream, in order of their begin, from its saturated samples alone.

    number (k,) counts all samples of the stream: consecutive ones of one axis and side are one span; low_s (k,), sides
    (k, 3) as `saturated` gives them.
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
    """Read samples (m, k) at other instants (n,), band-limited to the slower of the two rates: (n, k).

    A Kaiser-windowed sinc through 32 samples, its weights made to add up to one. NaN where any of the samples is
    missing: at the ends, across a gap, and beside a NaN.
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
    """The reader's weight (n,) by the distance in samples (n,), finely tabulated; edge in cycles per sample."""
    distance = np.linspace(0.0, _HALF, 1 << 15)
    window = np.i0(_SHAPE * np.sqrt(np.clip(1.0 - (distance / _HALF) ** 2, 0.0, 1.0)))
    return distance, np.sinc(2.0 * edge * distance) * window


def read_beside(stretch: Stretch, delay_s: float) -> Floats:
    """The wide channel at the instants of the fine one (n, 3); NaN where it has none, or is at its own rail."""
    high = np.where(np.abs(stretch.high_mps2) < HIGH_RAIL_MPS2, stretch.high_mps2, np.nan)
    if not stretch.shared:
        return read_at(stretch.high_s, high, stretch.low_s + delay_s, stretch.low_hz)
    if not stretch.high_s.size:
        return np.full(stretch.low_mps2.shape, np.nan)
    at = np.minimum(np.searchsorted(stretch.high_s, stretch.low_s), stretch.high_s.size - 1)
    return np.where((stretch.high_s[at] == stretch.low_s)[:, None], high[at], np.nan)


def trusted(low_mps2: Floats, settings: DualRangeSettings) -> Flags:
    """Which instants (n,) of the fine channel are finite and far enough from any rail, on all axes."""
    bad = (saturated(low_mps2, settings) != 0).any(axis=1) | ~np.isfinite(low_mps2).all(axis=1)
    return ~_widened(bad, GUARD)


def align(stretches: Sequence[Stretch], settings: DualRangeSettings) -> Alignment:
    """Measure gain and delay of the wide channel over some stretches; what they do not support stays 1 and 0."""
    delay_s, delay_measured = _delay(stretches, settings)
    pairs = [_pair(stretch, delay_s, settings) for stretch in stretches]
    low = [part - part.mean(axis=0) for part, _ in pairs if len(part)]
    high = [part - part.mean(axis=0) for _, part in pairs if len(part)]
    if not low:
        return Alignment()
    x, y = np.concatenate(low), np.concatenate(high)
    gains, noise, measured = [], [], []
    for axis in range(3):
        energy = float(x[:, axis] @ x[:, axis])
        gain = float(x[:, axis] @ y[:, axis]) / energy if energy else 1.0
        scatter = float(np.std(y[:, axis] - gain * x[:, axis]))
        error = scatter / np.sqrt(energy) if energy else np.inf
        holds = error < GAIN_ERROR and abs(gain - 1.0) > 3.0 * error
        gains.append(gain if holds else 1.0)
        noise.append(scatter if holds else float(np.std(y[:, axis] - x[:, axis])))
        measured.append(bool(holds))
    return Alignment(_three(gains), delay_s, _three(noise), (measured[0], measured[1], measured[2]), delay_measured)


def plausible(alignment: Alignment) -> bool:
    """Whether the two channels can be one sensor's at all."""
    return all(abs(gain - 1.0) <= GAIN_OFF for gain in alignment.gain)


def levels(stretch: Stretch, settings: DualRangeSettings) -> Floats | None:
    """Means of low and high (2, 3) m/s^2 where both are to be trusted; None where too little of a stretch is.

    Over seconds no delay matters to them.
    """
    low, high = _pair(stretch, 0.0, settings)
    return np.array([low.mean(axis=0), high.mean(axis=0)]) if len(low) >= LEAST_TRUSTED else None


def bias(levels_mps2: Floats, alignment: Alignment) -> Floats:
    """The bias of the wide channel (3,) m/s^2 where it and the fine one have these means."""
    off: Floats = levels_mps2[1] - levels_mps2[0] * alignment.gain
    return off


def set_right(stretch: Stretch, alignment: Alignment, bias_mps2: Floats) -> Floats:
    """The wide channel at the instants of the fine one, its bias, gain and delay taken off, (n, 3)."""
    return (read_beside(stretch, alignment.delay_s) - bias_mps2) / np.array(alignment.gain)


def covered(found: Sequence[Span], stretch: Stretch, right_mps2: Floats, settings: DualRangeSettings) -> list[Span]:
    """The spans that can be taken over: the wide channel is there all along, and reaches the rail as the other does."""
    kept = []
    for span in found:
        first, last = np.searchsorted(stretch.low_s, (span.begin_s, span.end_s))
        reach = MARGIN + FADE
        values = right_mps2[max(first - reach, 0) : last + reach + 1, span.axis]
        inside = right_mps2[first : last + 1, span.axis]
        if np.isfinite(values).all() and (span.sign * inside).max() >= AGREES * settings.saturation_mps2:
            kept.append(span)
    return kept


def shares(low_s: Floats, period_s: float, taken: Sequence[Span]) -> Floats:
    """How much of each reading comes from the wide channel, 0 to 1, (n, 3); a function of time alone."""
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
    return out


def take_over(low_mps2: Floats, right_mps2: Floats, share: Floats) -> Floats:
    """The fine channel with the wide one, set right, in the place of its rail, (n, 3)."""
    return np.where(share > 0.0, (1.0 - share) * low_mps2 + share * np.where(share > 0.0, right_mps2, 0.0), low_mps2)


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _widened(flags: Flags, by: int) -> Flags:
    """The flags with as many neighbours on either side."""
    if not flags.size:
        return flags
    ones = np.convolve(flags.astype(np.int64), np.ones(2 * by + 1, dtype=np.int64), mode="full")
    return ones[by : by + flags.size] > 0


def _pair(stretch: Stretch, delay_s: float, settings: DualRangeSettings) -> tuple[Floats, Floats]:
    """Both channels (k, 3) where both are to be trusted."""
    high = read_beside(stretch, delay_s)
    good = trusted(stretch.low_mps2, settings) & np.isfinite(high).all(axis=1)
    return stretch.low_mps2[good], high[good]


def _delay(stretches: Sequence[Stretch], settings: DualRangeSettings) -> tuple[float, bool]:
    """By how much the wide channel is late, seconds: a search, then Gauss-Newton; 0 where its error is too large."""
    if all(stretch.shared for stretch in stretches):
        return 0.0, False
    delay_s, error_s = _roughly(stretches, settings), np.inf
    for _ in range(4):
        slope, excess, energy = _slopes(stretches, delay_s, settings)
        if energy <= 0.0:
            return 0.0, False
        error_s = float(np.std(excess)) / np.sqrt(energy)
        # Read too late, the wide channel is ahead by the slope.
        delay_s -= float(np.clip((slope * excess).sum() / energy, -_STEP_S, _STEP_S))
    holds = error_s < DELAY_ERROR_S and abs(delay_s) > 3.0 * error_s and abs(delay_s) < LONGEST_DELAY_S
    return (delay_s, True) if holds else (0.0, False)


def _roughly(stretches: Sequence[Stretch], settings: DualRangeSettings) -> float:
    """The delay that leaves least between the channels, to a millisecond, the wide one read on straight lines."""
    grid_s = np.arange(-LONGEST_DELAY_S, LONGEST_DELAY_S + 0.5 * _STEP_S, _STEP_S)
    left = np.zeros(grid_s.size)
    for stretch in stretches:
        good = trusted(stretch.low_mps2, settings)
        there = np.isfinite(stretch.high_mps2).all(axis=1)
        if good.sum() < LEAST_TRUSTED or there.sum() < LEAST_TRUSTED:
            continue
        for number, delay_s in enumerate(grid_s):
            for axis in range(3):
                at_s = stretch.low_s[good] + delay_s
                high = np.interp(at_s, stretch.high_s[there], stretch.high_mps2[there, axis])
                left[number] += float(np.var(high - stretch.low_mps2[good, axis])) * at_s.size
    return float(grid_s[int(np.argmin(left))]) if left.any() else 0.0


def _slopes(stretches: Sequence[Stretch], delay_s: float, settings: DualRangeSettings) -> tuple[Floats, Floats, float]:
    """The fine channel's slope (k, 3), the wide one's excess at a delay (k, 3), and the slope's energy without noise.

    A slope spans so many samples that its neighbour shares none with it: their product is the motion's alone.
    """
    slopes, excesses, energy = [np.empty((0, 3))], [np.empty((0, 3))], 0.0
    for stretch in stretches:
        high = read_beside(stretch, delay_s)
        slope = np.full(stretch.low_mps2.shape, np.nan)
        low, low_s = stretch.low_mps2, stretch.low_s
        if low_s.size > 2 * _BASE:
            rise = low[2 * _BASE :] - low[: -2 * _BASE]
            slope[_BASE:-_BASE] = rise / (low_s[2 * _BASE :] - low_s[: -2 * _BASE])[:, None]
        good = trusted(low, settings) & np.isfinite(high + slope).all(axis=1)
        if good.any():
            excess = high[good] - low[good]
            slopes.append(slope[good])
            excesses.append(excess - excess.mean(axis=0))
            both = good[1:] & good[:-1]
            energy += float((slope[1:][both] * slope[:-1][both]).sum())
    return np.concatenate(slopes), np.concatenate(excesses), energy
