"""Relative drift: how the clock of a sensor runs against the seat's, from the phase between both over a session.

A body answers the seat in the same way from beginning to end, so the phase at a frequency stays; a clock that drifts
turns it in proportion to frequency and time. The drift is the one that aligns the phases of all parts of the session.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize, signal

from biodyn_core.base.arrays import Complexes, Flags, Floats

FRAME: Final = 256
"""Intervals of a spectrum: 5 s at 20 ms."""

BAND_HZ: Final = (1.0, 12.0)
"""Below there is little motion, above little remains of means over 20 ms and of the seat in the body."""

BLOCK_FRAMES: Final = 8
"""Spectra that are summed before the search, within 20 s: no clock drifts noticeably."""

LEAST_BLOCKS: Final = 6
LARGEST_DRIFT: Final = 200e-6
"""No quartz is farther off."""

CYCLES: Final = 0.1
"""Step of the search, in cycles of the highest frequency over the session."""

TINY: Final = 1e-300
"""Against division by zero where a channel does not move."""

LEFT_OUT: Final = 8
"""Parts of the session of which each is left out once for the error."""


@dataclass(frozen=True)
class RelativeDrift:
    """Drift of a sensor's clock against the seat's: positive if it is fast; error: standard error."""

    ppm: float
    error_ppm: float

    def is_sure(self, seconds: float, sigmas: float, least_s: float) -> bool:
        """Whether it differs from zero, and changes times over a session by a noticeable amount."""
        return abs(self.ppm) > sigmas * self.error_ppm and 1e-6 * abs(self.ppm) * seconds > least_s


def relative_drift(seat: Floats, sensor: Floats, usable: Flags, width_s: float) -> RelativeDrift | None:
    """The drift from values of both (n,) on one grid; usable (n,): with samples of both, in motion.

    None for too little motion.
    """
    begins = _frames(usable)
    if len(begins) < LEAST_BLOCKS * BLOCK_FRAMES:
        return None
    frequency_hz, phasors = _phasors(seat, sensor, begins, width_s)
    count = len(begins) // BLOCK_FRAMES
    shape = count, BLOCK_FRAMES
    blocks = phasors[: count * BLOCK_FRAMES].reshape(*shape, -1).sum(axis=1)
    time_s = (np.array(begins[: count * BLOCK_FRAMES]).reshape(shape).mean(axis=1) + 0.5 * FRAME) * width_s
    drift = _best(blocks, time_s, frequency_hz)
    parts = np.arange(count) * LEFT_OUT // count
    others = [_best(blocks[parts != part], time_s[parts != part], frequency_hz) for part in range(LEFT_OUT)]
    error = np.sqrt((LEFT_OUT - 1) / LEFT_OUT * ((np.array(others) - np.mean(others)) ** 2).sum())
    return RelativeDrift(1e6 * drift, 1e6 * float(error))


def _frames(usable: Flags) -> list[int]:
    """The beginnings of frames that overlap by half and are usable throughout."""
    bad = np.concatenate([[0], np.cumsum(~usable)])
    return [at for at in range(0, usable.size - FRAME + 1, FRAME // 2) if bad[at + FRAME] == bad[at]]


def _phasors(seat: Floats, sensor: Floats, begins: list[int], width_s: float) -> tuple[Floats, Complexes]:
    """Frequencies (f,) of the band, and the phase of the sensor against the seat in each frame (w, f), unit length."""
    window = signal.get_window("hann", FRAME)
    frequency_hz = np.arange(FRAME // 2 + 1) / (FRAME * width_s)
    inside = np.flatnonzero((frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1]))
    unit = np.empty((len(begins), inside.size), dtype=np.complex128)
    for row, at in enumerate(begins):  # one by one, because all frames of two hours take 20 MB
        one, other = (
            np.fft.rfft((frame - frame.mean()) * window)[inside]
            for frame in (seat[at : at + FRAME], sensor[at : at + FRAME])
        )
        cross = other * one.conj()
        unit[row] = cross / np.maximum(np.abs(cross), TINY)
    return frequency_hz[inside], unit


def _best(blocks: Complexes, time_s: Floats, frequency_hz: Floats) -> float:
    """The drift, s/s, that aligns the phases of blocks (k, f)."""

    def misaligned(drift: float) -> float:
        turned = blocks * np.exp(2j * np.pi * drift * time_s[:, None] * frequency_hz)
        return -float(np.abs(turned.sum(axis=0)).sum())

    step = CYCLES / (float(np.ptp(time_s)) * float(frequency_hz[-1]))
    tried = np.arange(-LARGEST_DRIFT, LARGEST_DRIFT + step, step)
    near = float(tried[int(np.argmin([misaligned(drift) for drift in tried.tolist()]))])
    found = optimize.minimize_scalar(
        misaligned, bounds=(near - step, near + step), method="bounded", options={"xatol": 1e-9}
    )
    return float(found.x)
