"""Range alignment: bias, gain and delay of a 200 g channel against the 16 g channel of the same sensor.

Its bias is large and drifts with temperature, its gain errs by a few percent, its clock or filter may add a delay. All
are measured over the seconds around saturations in which the fine channel is usable (a *stretch*), by least squares
with the fine channel as the regressor, so that the noise of the coarse one does not reduce the gain:

    high(t) = gain low(t - delay) + bias

gain per axis and one delay for the whole recording, bias per axis and stretch. A gain or delay that the motion does not
determine is taken as 1 or 0, with an assumed error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

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

GAIN_TOLERANCE: Final = 0.1
"""Assumed error of a gain that the motion does not determine.

Analog Devices' data sheet of the ADXL375, a part of 200 g: 18.4 to 22.6 LSB/g about 20.5. That the sensor has a part
with such a tolerance is an assumption; Vicon states none.
"""

DELAY_TOLERANCE_S: Final = 0.002
"""Assumed error of a delay that the motion does not determine: two samples of the 16 g channel, in no data sheet."""

_STEP_S: Final = 0.001
_BASE: Final = 8


@dataclass(frozen=True)
class Alignment:
    """Gain (3,) and delay of the wide channel, and the rms of the residual between both, (3,) m/s^2.

    measured: whether each gain (3,) is significant; delay_measured: whether the delay is. determined, delay_determined:
    whether the motion determines them, also as 1 and 0. gain_error (3,), delay_error_s: their standard errors, or the
    assumed ones of `GAIN_TOLERANCE` and `DELAY_TOLERANCE_S`.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    delay_s: float = 0.0
    noise_mps2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    measured: tuple[bool, bool, bool] = (False, False, False)
    delay_measured: bool = False
    determined: tuple[bool, bool, bool] = (False, False, False)
    delay_determined: bool = False
    gain_error: tuple[float, float, float] = (GAIN_TOLERANCE, GAIN_TOLERANCE, GAIN_TOLERANCE)
    delay_error_s: float = DELAY_TOLERANCE_S


class _Estimate(NamedTuple):
    """A gain or delay in use, its error, whether it is significant and whether the motion determines it."""

    value: float
    error: float
    measured: bool
    determined: bool


_NO_GAIN: Final = _Estimate(1.0, GAIN_TOLERANCE, False, False)
_NO_DELAY: Final = _Estimate(0.0, DELAY_TOLERANCE_S, False, False)


def align(stretches: Sequence[Stretch], settings: DualRangeSettings) -> Alignment:
    """Measure gain and delay of the wide channel over some stretches; values that are not significant stay 1 and 0."""
    delay = _delay(stretches, settings)
    pairs = [_pair(stretch, delay.value, settings) for stretch in stretches]
    low = [part - part.mean(axis=0) for part, _ in pairs if len(part)]
    high = [part - part.mean(axis=0) for _, part in pairs if len(part)]
    if not low:
        return Alignment()
    x, y = np.concatenate(low), np.concatenate(high)
    gains = [_gain(x[:, axis], y[:, axis]) for axis in range(3)]
    values = [gain.value for gain in gains]
    return Alignment(
        gain=_three(values),
        delay_s=delay.value,
        noise_mps2=_three(np.std(y - x * values, axis=0).tolist()),
        measured=(gains[0].measured, gains[1].measured, gains[2].measured),
        delay_measured=delay.measured,
        determined=(gains[0].determined, gains[1].determined, gains[2].determined),
        delay_determined=delay.determined,
        gain_error=_three([gain.error for gain in gains]),
        delay_error_s=delay.error,
    )


def _gain(low: Floats, high: Floats) -> _Estimate:
    """Gain of one axis from both channels (k,) without their means."""
    energy = float(low @ low)
    if not energy:
        return _NO_GAIN
    gain = float(low @ high) / energy
    error = float(np.std(high - gain * low)) / np.sqrt(energy)
    if error >= GAIN_ERROR:
        return _NO_GAIN
    return _used(gain, 1.0, error)


def _used(found: float, nominal: float, error: float) -> _Estimate:
    """A determined value, or the nominal one if it does not differ from it; the error is then the distance as well."""
    if abs(found - nominal) > 3.0 * error:
        return _Estimate(found, error, True, True)
    return _Estimate(nominal, float(np.hypot(found - nominal, error)), False, True)


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


def variance(stretch: Stretch, alignment: Alignment, corrected_mps2: Floats) -> Floats:
    """Variance of corrected readings (n, 3) m^2/s^4: of noise, of the gain's error and of the delay's error.

    The delay's part is the change of the reading within the error, earlier or later. An error of the bias, and of the
    interpolation between samples, is not contained.
    """
    by_gain = corrected_mps2 * np.array(alignment.gain_error) / alignment.gain
    by_delay = np.zeros(corrected_mps2.shape)
    for shift_s in (-alignment.delay_error_s, alignment.delay_error_s):
        for axis, values in enumerate(corrected_mps2.T):
            if values.size:
                shifted = np.interp(stretch.low_s + shift_s, stretch.low_s, values)
                by_delay[:, axis] = np.fmax(by_delay[:, axis], np.abs(shifted - values))
    found: Floats = np.square(alignment.noise_mps2) + by_gain**2 + by_delay**2
    return found


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _pair(stretch: Stretch, delay_s: float, settings: DualRangeSettings) -> tuple[Floats, Floats]:
    """Both channels (k, 3) where both are usable."""
    high = read_wide(stretch, delay_s)
    good = usable(stretch.low_mps2, settings) & np.isfinite(high).all(axis=1)
    return stretch.low_mps2[good], high[good]


def _delay(stretches: Sequence[Stretch], settings: DualRangeSettings) -> _Estimate:
    """Delay of the wide channel, seconds: a search, then Gauss-Newton; 0 where its error is too large."""
    if all(stretch.shared for stretch in stretches):
        return _NO_DELAY
    delay_s, error_s = _coarse_delay_s(stretches, settings), np.inf
    for _ in range(4):
        slope, excess, energy = _slopes(stretches, delay_s, settings)
        if energy <= 0.0:
            return _NO_DELAY
        error_s = float(np.std(excess)) / np.sqrt(energy)
        # The wide channel read too late is ahead by the slope.
        delay_s -= float(np.clip((slope * excess).sum() / energy, -_STEP_S, _STEP_S))
    if error_s >= DELAY_ERROR_S or abs(delay_s) >= LONGEST_DELAY_S:
        return _NO_DELAY
    return _used(delay_s, 0.0, error_s)


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
