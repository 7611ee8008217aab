"""Range alignment: bias, gain and delay of a 200 g channel against the 16 g channel of the same sensor.

Its bias is large and drifts with temperature, its gain errs by a few percent, its clock or filter may add a delay. All
are measured over the seconds around saturations in which the fine channel is usable (a *stretch*), by least squares
with the fine channel as the regressor, so that the noise of the coarse one does not reduce the gain:

    high(t) = gain low(t - delay) + bias

gain per axis and one delay for the whole recording, bias per axis and stretch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.conditioning.dual_range import Stretch, read_wide, usable
from biodyn_core.conditioning.dual_range_settings import DualRangeSettings

MIN_USABLE: Final = 100
"""Fewer samples of a stretch give no bias."""

GAIN_ERROR: Final = 0.01
"""Largest standard error of a gain that is used, and at most a third of its deviation from 1; else it is 1."""

MAX_GAIN_DEVIATION: Final = 0.25
DELAY_ERROR_S: Final = 0.0002
LONGEST_DELAY_S: Final = 0.02

_STEP_S: Final = 0.001
_BASE: Final = 8


@dataclass(frozen=True)
class Alignment:
    """Gain (3,) and delay of the wide channel, and the rms of the residual between both, (3,) m/s^2.

    measured: whether each gain (3,) is significant; delay_measured: whether the delay is.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    delay_s: float = 0.0
    noise_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    measured: tuple[bool, bool, bool] = (False, False, False)
    delay_measured: bool = False


def align(stretches: Sequence[Stretch], settings: DualRangeSettings) -> Alignment:
    """Measure gain and delay of the wide channel over some stretches; values that are not significant stay 1 and 0."""
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
        significant = error < GAIN_ERROR and abs(gain - 1.0) > 3.0 * error
        gains.append(gain if significant else 1.0)
        noise.append(scatter if significant else float(np.std(y[:, axis] - x[:, axis])))
        measured.append(bool(significant))
    return Alignment(_three(gains), delay_s, _three(noise), (measured[0], measured[1], measured[2]), delay_measured)


def plausible(alignment: Alignment) -> bool:
    """Whether the two channels can be of one sensor."""
    return all(abs(gain - 1.0) <= MAX_GAIN_DEVIATION for gain in alignment.gain)


def levels(stretch: Stretch, settings: DualRangeSettings) -> Floats | None:
    """Means of both channels (2, 3) m/s^2 over usable samples; None for too few of them.

    A delay does not matter to means over seconds.
    """
    low, high = _pair(stretch, 0.0, settings)
    return np.array([low.mean(axis=0), high.mean(axis=0)]) if len(low) >= MIN_USABLE else None


def bias(levels_mps2: Floats, alignment: Alignment) -> Floats:
    """The bias of the wide channel (3,) m/s^2 from the means of both channels."""
    found: Floats = levels_mps2[1] - levels_mps2[0] * alignment.gain
    return found


def corrected(stretch: Stretch, alignment: Alignment, bias_mps2: Floats) -> Floats:
    """The wide channel at the instants of the fine one, corrected for bias, gain and delay, (n, 3)."""
    return (read_wide(stretch, alignment.delay_s) - bias_mps2) / np.array(alignment.gain)


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _pair(stretch: Stretch, delay_s: float, settings: DualRangeSettings) -> tuple[Floats, Floats]:
    """Both channels (k, 3) where both are usable."""
    high = read_wide(stretch, delay_s)
    good = usable(stretch.low_mps2, settings) & np.isfinite(high).all(axis=1)
    return stretch.low_mps2[good], high[good]


def _delay(stretches: Sequence[Stretch], settings: DualRangeSettings) -> tuple[float, bool]:
    """Delay of the wide channel, seconds: a search, then Gauss-Newton; 0 where its error is too large."""
    if all(stretch.shared for stretch in stretches):
        return 0.0, False
    delay_s, error_s = _coarse_delay_s(stretches, settings), np.inf
    for _ in range(4):
        slope, excess, energy = _slopes(stretches, delay_s, settings)
        if energy <= 0.0:
            return 0.0, False
        error_s = float(np.std(excess)) / np.sqrt(energy)
        # The wide channel read too late is ahead by the slope.
        delay_s -= float(np.clip((slope * excess).sum() / energy, -_STEP_S, _STEP_S))
    significant = error_s < DELAY_ERROR_S and abs(delay_s) > 3.0 * error_s and abs(delay_s) < LONGEST_DELAY_S
    return (delay_s, True) if significant else (0.0, False)


def _coarse_delay_s(stretches: Sequence[Stretch], settings: DualRangeSettings) -> float:
    """The delay with the least residual between the channels, to a millisecond, by linear interpolation."""
    grid_s = np.arange(-LONGEST_DELAY_S, LONGEST_DELAY_S + 0.5 * _STEP_S, _STEP_S)
    residual = np.zeros(grid_s.size)
    for stretch in stretches:
        good = usable(stretch.low_mps2, settings)
        there = np.isfinite(stretch.high_mps2).all(axis=1)
        if good.sum() < MIN_USABLE or there.sum() < MIN_USABLE:
            continue
        for number, delay_s in enumerate(grid_s):
            for axis in range(3):
                at_s = stretch.low_s[good] + delay_s
                high = np.interp(at_s, stretch.high_s[there], stretch.high_mps2[there, axis])
                residual[number] += float(np.var(high - stretch.low_mps2[good, axis])) * at_s.size
    return float(grid_s[int(np.argmin(residual))]) if residual.any() else 0.0


def _slopes(stretches: Sequence[Stretch], delay_s: float, settings: DualRangeSettings) -> tuple[Floats, Floats, float]:
    """The fine channel's slope (k, 3), the wide one's excess at a delay (k, 3), and the slope's energy without noise.

    A slope shares no sample with its neighbour, so their product contains no noise.
    """
    slopes, excesses, energy = [np.empty((0, 3))], [np.empty((0, 3))], 0.0
    for stretch in stretches:
        high = read_wide(stretch, delay_s)
        slope = np.full(stretch.low_mps2.shape, np.nan)
        low, low_s = stretch.low_mps2, stretch.low_s
        if low_s.size > 2 * _BASE:
            rise = low[2 * _BASE :] - low[: -2 * _BASE]
            slope[_BASE:-_BASE] = rise / (low_s[2 * _BASE :] - low_s[: -2 * _BASE])[:, None]
        good = usable(low, settings) & np.isfinite(high + slope).all(axis=1)
        if good.any():
            excess = high[good] - low[good]
            slopes.append(slope[good])
            excesses.append(excess - excess.mean(axis=0))
            both = good[1:] & good[:-1]
            energy += float((slope[1:][both] * slope[:-1][both]).sum())
    return np.concatenate(slopes), np.concatenate(excesses), energy
