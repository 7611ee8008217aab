"""Relative drift: how the clock of a sensor runs against the seat's, from the phase between both over a session.

A body answers the seat in the same way from beginning to end, so the phase at a frequency stays; a clock that drifts
turns it in proportion to frequency and time. The drift is the one that aligns the phases of all parts of the session.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy

from biodyn_core.base.arrays import Complexes, Flags, Floats

FRAME: Final = 256
"""Intervals of a spectrum: 5 s at 20 ms."""

HOP: Final = FRAME // 2

BAND_HZ: Final = (1.0, 12.0)
"""Below there is little motion, above little remains of means over 20 ms and of the seat in the body."""

BLOCK_FRAMES: Final = 8
"""Spectra that are summed before the search, within 20 s: no clock drifts noticeably."""

LEAST_FRAMES: Final = 24
"""One minute of motion."""

LARGEST_DRIFT: Final = 200e-6
"""No quartz is farther off."""

CYCLES: Final = 0.1
"""Step of the search, in cycles of the highest frequency over the session."""

LEAST_SCORE: Final = 6.0
"""The best of a thousand drifts of independent phases is above it once in a million sessions, if it is normal.

In 40 sessions of 20 minutes it was 3.3 at most; a sensor with four times as much noise as motion of the seat had 45.
"""

TINY: Final = 1e-300
"""Against division by zero where a channel does not move."""

BANDS: Final = 3
"""Parts of the band whose drifts are compared."""

LEFT_OUT: Final = 8
"""Parts of the session of which each is left out once for the error."""


@dataclass(frozen=True)
class RelativeDrift:
    """Drift of a sensor's clock against the seat's: positive if it is fast.

    chance_ppm: standard error by the parts of the session. spread_ppm: how much more the bands differ than by chance.
    """

    ppm: float
    chance_ppm: float
    spread_ppm: float = 0.0

    @property
    def error_ppm(self) -> float:
        """The standard error, of chance and of a body that changes."""
        return math.hypot(self.chance_ppm, self.spread_ppm)

    def apart_s(self, seconds: float) -> float:
        """By how much times change over a session."""
        return 1e-6 * abs(self.ppm) * seconds


class PhaseMeter:
    """Phase of a sensor against the seat over a session: `add` blocks of values, then read the `drift`.

    width_s: of the intervals of the values. least_mps2: least rms of the seat in a frame that counts. Memory is that of
    one phase for each frequency and block.
    """

    def __init__(self, width_s: float, least_mps2: float) -> None:
        self._width_s, self._least_mps2 = width_s, least_mps2
        frequency_hz = np.arange(FRAME // 2 + 1) / (FRAME * width_s)
        self._inside = np.flatnonzero((frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1]))
        self._frequency_hz = frequency_hz[self._inside]
        self._window = scipy.signal.get_window("hann", FRAME)
        self._blocks: list[Complexes] = []
        self._time_s: list[float] = []
        self._frames = 0

    def add(self, number: int, seat: Floats, sensor: Floats, usable: Flags) -> None:
        """Add the values of both in the intervals of a block (`block_extent`), (n,) each.

        usable (n,): with samples of both; only frames that are usable throughout, and move, count.
        """
        total, times = np.zeros(self._inside.size, dtype=np.complex128), []
        for at in range(0, BLOCK_FRAMES * HOP, HOP):
            here = slice(at, at + FRAME)
            if usable[here].all() and np.sqrt((seat[here] ** 2).mean()) >= self._least_mps2:
                total += self._phase(seat[here], sensor[here])
                times.append(block_extent(number)[0] + at + 0.5 * FRAME)
        if times:
            self._blocks.append(total)
            self._time_s.append(float(np.mean(times)) * self._width_s)
            self._frames += len(times)

    def drift(self) -> RelativeDrift | None:
        """The drift so far; None for too little motion, and for a sensor whose motion does not follow the seat."""
        if len(self._blocks) < LEFT_OUT or self._frames < LEAST_FRAMES:
            return None
        blocks, time_s = np.array(self._blocks), np.array(self._time_s)
        found = _estimate(blocks, time_s, self._frequency_hz)
        parts = np.array_split(np.arange(self._frequency_hz.size), BANDS)
        bands = [_estimate(blocks[:, part], time_s, self._frequency_hz[part]) for part in parts]
        spread_ppm = _spread_ppm([one for one in bands if one is not None])
        return found and replace(found, spread_ppm=spread_ppm)

    def _phase(self, seat: Floats, sensor: Floats) -> Complexes:
        """The phase of a frame at the frequencies of the band, of unit length (f,)."""
        one, other = (np.fft.rfft((frame - frame.mean()) * self._window)[self._inside] for frame in (seat, sensor))
        cross = other * one.conj()
        return np.asarray(cross / np.maximum(np.abs(cross), TINY))


def block_extent(number: int) -> tuple[int, int]:
    """The first interval of a block, and the one after its last; blocks overlap by half a frame."""
    begin = number * BLOCK_FRAMES * HOP
    return begin, begin + (BLOCK_FRAMES - 1) * HOP + FRAME


def _estimate(blocks: Complexes, time_s: Floats, frequency_hz: Floats) -> RelativeDrift | None:
    """The drift with its error of chance; None if the phases are no better aligned than by chance.

    blocks (k, f) at the frequencies (f,) and times (k,).
    """
    step = _step(time_s, frequency_hz)
    drift = _refined(_coarse(blocks, time_s, frequency_hz), step, blocks, time_s, frequency_hz)
    if _score(_aligned(drift, blocks, time_s, frequency_hz), blocks) < LEAST_SCORE:
        return None
    parts = np.arange(len(blocks)) * LEFT_OUT // len(blocks)
    left = [(blocks[parts != k], time_s[parts != k]) for k in range(LEFT_OUT)]
    others = [_refined(drift, step, *one, frequency_hz) for one in left]
    error = np.sqrt((LEFT_OUT - 1) / LEFT_OUT * ((np.array(others) - np.mean(others)) ** 2).sum())
    return RelativeDrift(1e6 * drift, 1e6 * float(error))


def _spread_ppm(bands: Sequence[RelativeDrift]) -> float:
    """How much more the drifts of bands differ than by chance, as a standard deviation.

    A clock turns the phases of all bands by one drift. A body that softens as the level rises turns each by another.
    """
    if len(bands) < 2:
        return 0.0
    excess = float(np.var([one.ppm for one in bands], ddof=1)) - float(np.mean([one.chance_ppm**2 for one in bands]))
    return math.sqrt(max(0.0, excess))


def _step(time_s: Floats, frequency_hz: Floats) -> float:
    """Step of the search, s/s."""
    return CYCLES / (float(np.ptp(time_s)) * float(frequency_hz[-1]))


def _aligned(drift: float, blocks: Complexes, time_s: Floats, frequency_hz: Floats) -> float:
    """The sum over frequencies of the length of the phases of blocks (k, f), turned back by a drift."""
    turned = blocks * np.exp(2j * np.pi * drift * time_s[:, None] * frequency_hz)
    return float(np.abs(turned.sum(axis=0)).sum())


def _coarse(blocks: Complexes, time_s: Floats, frequency_hz: Floats) -> float:
    """The drift, s/s, that aligns the phases best, to one step of the search."""
    step = _step(time_s, frequency_hz)
    tried = np.arange(-LARGEST_DRIFT, LARGEST_DRIFT + step, step)
    return float(tried[int(np.argmax([_aligned(drift, blocks, time_s, frequency_hz) for drift in tried.tolist()]))])


def _refined(near: float, step: float, blocks: Complexes, time_s: Floats, frequency_hz: Floats) -> float:
    """The drift, s/s, within a step of another that aligns the phases best."""
    found = scipy.optimize.minimize_scalar(
        lambda drift: -_aligned(drift, blocks, time_s, frequency_hz),
        bounds=(near - step, near + step), method="bounded", options={"xatol": 1e-9},
    )  # fmt: skip
    return float(found.x)


def _score(aligned: float, blocks: Complexes) -> float:
    """How far the alignment is above that of independent phases, in standard deviations of a single drift.

    The length of a sum of independent phases has Rayleigh's distribution.
    """
    squares = (np.abs(blocks) ** 2).sum(axis=0)
    expected, variance = float(np.sqrt(0.25 * np.pi * squares).sum()), (1.0 - 0.25 * np.pi) * float(squares.sum())
    return (aligned - expected) / np.sqrt(variance)
