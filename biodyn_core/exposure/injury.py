"""Injury criteria of one shock: the Dynamic Response Index of the seat and the Head Injury Criterion.

Meters as in `meters`. Zaman et al., Eq. 23-25, in definitions that resolve their contradictions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import scipy

from biodyn_core import kernels
from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.exposure.meters import Meter
from biodyn_core.exposure.tally import Tally

DRI_OMEGA_RAD_PER_S: Final = 52.9
"""With the damping ratio, Eq. 24."""

DRI_DAMPING_RATIO: Final = 0.224
DRI_BANDS: Final = ((5.2, "< 5.2"), (13.0, "5.2-13.0"), (17.7, "13.0-17.7"), (math.inf, "> 17.7 (AIS 2+ threshold)"))

HIC_LENGTHS_S: Final = {"hic15": 0.015, "hic36": 0.036}
"""The longest window of each criterion."""

HIC_RATE_HZ: Final = 2000.0
"""Slower samples are interpolated linearly to this rate or more, because windows begin and end between samples."""


@dataclass(frozen=True)
class Dri:
    """Dynamic Response Index: for one upward pulse, not a dose of repeated shocks (Eq. 24, 25).

    compression: of spinal compression alone, the main figure; as_printed: of |z|. time_s: of the largest value since
    reset, for rolling figures too, breaks included.
    """

    compression: float
    as_printed: float
    time_s: float

    @property
    def band(self) -> str:
        """The numeric band the compression falls in (Zaman et al., 4.4)."""
        return next(label for upper, label in DRI_BANDS if self.compression < upper)

    @property
    def is_in_highest_band(self) -> bool:
        """Whether no band is higher, so that a lower bound of the compression decides the band too."""
        return self.band == DRI_BANDS[-1][1]


class Window(NamedTuple):
    """Begin and end, seconds."""

    begin: float
    end: float


@dataclass(frozen=True)
class Hic:
    """Head Injury Criterion over all windows up to one length: |vertical + 1 g|, |vertical|, resultant (Eq. 23).

    windows_s: by these names, start and end of the window of the largest value, since reset, breaks included; below
    zero where it began before the reset, None where HIC is zero and for rolling figures.
    """

    as_printed: float
    vertical: float
    resultant: float
    bandwidth_hz: float
    windows_s: Mapping[str, Window | None]


class DriMeter(Meter[Dri]):
    """The DRI oscillator driven by the seat's vertical acceleration, gravity-free, exact between samples.

    It restarts at rest after a break. A tilt leaves a level of second order in the vertical, 0.15 m/s^2 at 10 degrees,
    which adds 0.02 to compression; a restart from the level within a shock would add far more.
    """

    def __init__(self, rate_hz: float, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._transition = first_order_hold(DRI_OMEGA_RAD_PER_S, DRI_DAMPING_RATIO, 1.0 / rate_hz)
        self._state = np.zeros(3)
        self._seen = np.zeros(2, dtype=np.int64)
        self._tally = Tally(rate_hz, 1, 2, 0, window_s)

    def push(self, accel_mps2: Floats, suspect: bool = False) -> None:
        """Count a block (n, 1)."""
        t, largest_at = self._counting(len(accel_mps2), suspect), int(self._seen[1])
        kernels.dynamic_response(
            accel_mps2, self._transition, self._state, t.bin, t.total, t.ring, t.position, t.length, self._seen
        )
        if suspect:
            self._seen[1] = largest_at

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length."""
        self._seen[0] += self._skip(seconds)
        self._state[:] = 0.0

    def reset(self) -> None:
        """Set everything "since reset" to zero."""
        super().reset()
        self._seen[:] = 0

    def totals(self) -> Floats:
        """The totals, with the seconds passed and the time of the largest value, (1, 4)."""
        return np.column_stack([super().totals(), self._seen[None] / self._rate_hz])

    def resume(self, totals: Floats) -> None:
        """Continue from totals of an earlier run."""
        largest, before = self._tally.since_reset()[0, 0], np.rint(totals[0, 2:] * self._rate_hz).astype(np.int64)
        self._seen += before[0]
        if totals[0, 0] >= largest:
            self._seen[1] = before[1]
        super().resume(np.ascontiguousarray(totals[:, :2]))

    def _figures(self, rows: Floats, rolling: bool) -> Dri:
        scale = DRI_OMEGA_RAD_PER_S**2 / STANDARD_GRAVITY_MPS2
        return Dri(float(rows[0, 0] * scale), float(rows[0, 1] * scale), float(self._seen[1] / self._rate_hz))


class HicMeter(Meter[Hic]):
    """HIC of the head over all windows up to `length_s`; `push` gravity-free levelled acceleration (n, 3), z up."""

    def __init__(self, rate_hz: float, length_s: float, window_s: float) -> None:
        self._bandwidth_hz, self._length_s = rate_hz / 2.0, length_s
        self._steps = max(1, math.ceil(HIC_RATE_HZ / rate_hz))
        self._rate_hz = rate_hz = self._steps * rate_hz
        self._last = np.full((1, 3), np.nan)
        whole = math.floor(length_s * rate_hz + 1e-9)
        self._weights = np.append(np.arange(1, whole + 1) / rate_hz, length_s) ** -0.6
        self._history = np.zeros((3, 2, 2 * (whole + 2)))
        self._filled = np.zeros((3, 2), dtype=np.int64)
        self._seen = np.zeros(1, dtype=np.int64)
        self._windows = np.zeros((3, 2))
        self._tally = Tally(rate_hz, 3, 1, 0, window_s)

    def push(self, accel_mps2: Floats, suspect: bool = False) -> None:
        """Count a block (n, 3)."""
        if not accel_mps2.size:
            return
        g = accel_mps2 / STANDARD_GRAVITY_MPS2
        channels = np.column_stack([np.abs(g[:, 2] + 1.0), np.abs(g[:, 2]), np.sqrt((g**2).sum(axis=1))])
        finer, self._last = _interpolated(self._last, channels, self._steps), channels[-1:]
        t, windows = self._counting(len(finer), suspect), self._windows.copy() if suspect else self._windows
        kernels.head_injury(
            finer, 1.0 / self._rate_hz, self._length_s, self._weights, self._history, self._filled,
            self._seen, windows, t.bin, t.total, t.ring, t.position, t.length,
        )  # fmt: skip

    def skip(self, seconds: float) -> None:
        """Move on by a break of that length; no window reaches across it."""
        self._seen += self._skip(seconds)
        self._begin_anew()

    def reset(self) -> None:
        """Set everything "since reset" to zero."""
        super().reset()
        self._seen[:] = 0
        self._windows[:] = 0.0

    def forget(self) -> None:
        """As `Meter.forget`: no window reaches back."""
        super().forget()
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._filled[:, 0] = 0
        self._last = np.full((1, 3), np.nan)

    def totals(self) -> Floats:
        """The totals, with begin and end of the windows and the seconds passed, (3, 4)."""
        passed = np.full((3, 1), float(self._seen[0]))
        return np.column_stack([super().totals(), np.hstack([self._windows, passed]) / self._rate_hz])

    def resume(self, totals: Floats) -> None:
        """Continue from totals of an earlier run."""
        before = totals[:, 1:] * self._rate_hz
        larger = totals[:, 0] >= self._tally.since_reset()[:, 0]
        self._windows = np.where(larger[:, None], before[:, :2], self._windows + before[0, 2])
        self._seen += round(before[0, 2])
        super().resume(np.ascontiguousarray(totals[:, :1]))

    def _figures(self, rows: Floats, rolling: bool) -> Hic:
        names = ("as_printed", "vertical", "resultant")
        largest = dict(zip(names, (rows[:, 0] ** 2.5).tolist(), strict=True))
        windows: dict[str, Window | None] = dict.fromkeys(names)
        # The interpolated samples come before each sample.
        spans_s = (self._windows - (self._steps - 1)) / self._rate_hz
        for name, span in zip(names, spans_s.tolist(), strict=True):
            windows[name] = Window(*span) if largest[name] > 0.0 and not rolling else None
        return Hic(**largest, bandwidth_hz=self._bandwidth_hz, windows_s=windows)


def _interpolated(before: Floats, rows: Floats, steps: int) -> Floats:
    """Rows (n, c) after one (1, c), with steps - 1 rows linearly between, (n steps, c); between NaN they are NaN."""
    if steps == 1:
        return rows
    share = np.arange(1, steps)[:, None] / steps
    finer = np.empty((len(rows), steps, rows.shape[1]))
    finer[:, :-1] = (1.0 - share) * np.vstack([before, rows[:-1]])[:, None] + share * rows[:, None]
    finer[:, -1] = rows
    return finer.reshape(-1, rows.shape[1])


def first_order_hold(omega: float, zeta: float, step_s: float) -> Floats:
    """Exact step of z'' + 2 zeta w z' + w^2 z = -a for a linear between samples: (2, 4) on [z, z', a before, a now]."""
    block = np.zeros((4, 4))
    block[0, 1] = 1.0
    block[1] = [-(omega**2), -2.0 * zeta * omega, -1.0, 0.0]
    block[2, 3] = 1.0 / step_s
    moved = scipy.linalg.expm(block * step_s)
    # The fourth state is the rise of a over the step: a now - a before.
    return np.column_stack([moved[:2, :2], moved[:2, 2] - moved[:2, 3], moved[:2, 3]])
