"""Exposure: aw, MTVV, crest factor, VDV, DRI and HIC, and the residual's rms; live and batch are one class each.

Every meter takes blocks of any size and answers since reset and over the last `window_s`; cuts never change a number.
A row of NaN is a break: filters start anew behind it and nothing is counted for it.
ISO 2631-1:1997; Zaman et al., Eq. 23-27, in the definitions their contradictions forced on us.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from biodyn_core import kernels
from biodyn_core.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.weighting import WeightingName, weighting_sections

Floats = NDArray[np.float64]

BIN_S: Final = 0.1
"""Rolling figures move in steps of this."""

MTVV_TIME_CONSTANT_S: Final = 1.0
"""MTVV is the largest exponentially averaged running rms (ISO 2631-1:1997, 6.3.1)."""

DRI_OMEGA_RAD_PER_S: Final = 52.9
DRI_DAMPING_RATIO: Final = 0.224
DRI_BANDS: Final = ((5.2, "< 5.2"), (13.0, "5.2-13.0"), (17.7, "13.0-17.7"), (math.inf, "> 17.7 (AIS 2+ threshold)"))


@dataclass(frozen=True)
class Dose:
    """Weighted exposure of one channel: aw and MTVV m/s^2, VDV m/s^1.75, weighted peak m/s^2, seconds counted."""

    aw_mps2: float
    mtvv_mps2: float
    vdv_mps175: float
    peak_mps2: float
    seconds: float

    @property
    def crest_factor(self) -> float | None:
        """Weighted peak over aw, None where nothing was felt."""
        return self.peak_mps2 / self.aw_mps2 if self.aw_mps2 > 0.0 else None


@dataclass(frozen=True)
class Dri:
    """Dynamic Response Index: for one upward pulse, not a dose of repeated shocks (Eq. 24, 25).

    `compression` counts spinal compression alone and is the headline; `as_printed` takes |z|. time_s: since reset.
    """

    compression: float
    as_printed: float
    time_s: float

    @property
    def band(self) -> str:
        """The numeric band the compression falls in (Zaman et al., 4.4)."""
        return next(label for upper, label in DRI_BANDS if self.compression < upper)


@dataclass(frozen=True)
class Hic:
    """Head Injury Criterion over all windows up to one length: |vertical + 1 g|, |vertical|, resultant (Eq. 23)."""

    as_printed: float
    vertical: float
    resultant: float
    bandwidth_hz: float


class _Tally:
    """Bins that close into a total since reset and a ring over the window; `sums` columns add, the rest are largest."""

    def __init__(self, rate_hz: float, channels: int, columns: int, sums: int, window_s: float) -> None:
        self.length = max(1, round(BIN_S * rate_hz))
        self.sums = sums
        self.bin = np.zeros((channels, columns))
        self.total = np.zeros((channels, columns))
        self.ring = np.zeros((max(1, math.ceil(window_s * rate_hz / self.length)), channels, columns))
        self.position = np.zeros(2, dtype=np.int64)

    def since_reset(self) -> Floats:
        return self._join(self.total, self.bin)

    def rolling(self) -> Floats:
        past = self.ring.max(axis=0)
        past[:, : self.sums] = self.ring[:, :, : self.sums].sum(axis=0)
        return self._join(past, self.bin)

    def _join(self, past: Floats, now: Floats) -> Floats:
        joined = np.maximum(past, now)
        joined[:, : self.sums] = past[:, : self.sums] + now[:, : self.sums]
        return joined

    def reset(self) -> None:
        """Start "since reset" anew; the rolling window goes on."""
        self.ring[self.position[1] % len(self.ring)] = self.bin
        self.position[:] = 0, self.position[1] + 1
        self.bin[:] = 0.0
        self.total[:] = 0.0


class DoseMeter:
    """aw, MTVV, VDV and peak of channels sharing a clock: `push` blocks (n, c) of m/s^2, unweighted."""

    def __init__(self, weighting: WeightingName, rate_hz: float, channels: int, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._sos = weighting_sections(weighting, rate_hz)
        self._state = np.zeros((len(self._sos), 2, channels))
        self._decay = 1.0 - math.exp(-1.0 / (MTVV_TIME_CONSTANT_S * rate_hz))
        self._running = np.zeros(channels)
        self._tally = _Tally(rate_hz, channels, 5, 3, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, c)."""
        t = self._tally
        kernels.dose(
            accel_mps2, self._sos, self._state, self._decay, self._running, t.bin, t.total, t.ring, t.position, t.length
        )

    def since_reset(self) -> tuple[Dose, ...]:
        """One Dose per channel since the last reset."""
        return self._doses(self._tally.since_reset())

    def rolling(self) -> tuple[Dose, ...]:
        """One Dose per channel over the last `window_s`."""
        return self._doses(self._tally.rolling())

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._tally.reset()

    def _doses(self, rows: Floats) -> tuple[Dose, ...]:
        return tuple(
            Dose(
                aw_mps2=math.sqrt(square / max(count, 1.0)),
                mtvv_mps2=math.sqrt(running),
                vdv_mps175=(fourth / self._rate_hz) ** 0.25,
                peak_mps2=peak,
                seconds=count / self._rate_hz,
            )
            for square, fourth, count, peak, running in rows.tolist()
        )


class HorizontalMeter:
    """Wd-weighted aw and VDV of the horizontal plane in every direction at once, from the moments of both axes."""

    def __init__(self, rate_hz: float, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._sos = weighting_sections("Wd", rate_hz)
        self._state = np.zeros((len(self._sos), 2, 2))
        self._tally = _Tally(rate_hz, 1, 9, 9, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, 2)."""
        t = self._tally
        kernels.planar_dose(accel_mps2, self._sos, self._state, t.bin, t.total, t.ring, t.position, t.length)

    def along(self, angles_rad: ArrayLike, rolling: bool = False) -> tuple[Floats, Floats]:
        """Return (aw m/s^2, VDV m/s^1.75) along directions (n,) from the first axis, each (n,)."""
        row = (self._tally.rolling() if rolling else self._tally.since_reset())[0]
        angle = np.atleast_1d(np.asarray(angles_rad, dtype=np.float64))
        c, s = np.cos(angle), np.sin(angle)
        second = row[0] * c**2 + 2.0 * row[1] * c * s + row[2] * s**2
        fourth = (
            row[3] * c**4
            + 4.0 * row[4] * c**3 * s
            + 6.0 * row[5] * (c * s) ** 2
            + 4.0 * row[6] * c * s**3
            + row[7] * s**4
        )
        aw = np.sqrt(np.maximum(second, 0.0) / max(row[8], 1.0))
        return aw, (np.maximum(fourth, 0.0) / self._rate_hz) ** 0.25

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._tally.reset()


class DriMeter:
    """The DRI oscillator driven by the seat's vertical acceleration, gravity-free, exact between samples."""

    def __init__(self, rate_hz: float, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._transition = _first_order_hold(DRI_OMEGA_RAD_PER_S, DRI_DAMPING_RATIO, 1.0 / rate_hz)
        self._state = np.zeros(3)
        self._seen = np.zeros(2, dtype=np.int64)
        self._tally = _Tally(rate_hz, 1, 2, 0, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, 1)."""
        t = self._tally
        kernels.dynamic_response(
            accel_mps2, self._transition, self._state, t.bin, t.total, t.ring, t.position, t.length, self._seen
        )

    def since_reset(self) -> Dri:
        """The largest since the last reset."""
        return self._dri(self._tally.since_reset())

    def rolling(self) -> Dri:
        """The largest over the last `window_s`; its time is that of the largest since reset."""
        return self._dri(self._tally.rolling())

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._tally.reset()
        self._seen[:] = 0

    def _dri(self, rows: Floats) -> Dri:
        scale = DRI_OMEGA_RAD_PER_S**2 / STANDARD_GRAVITY_MPS2
        return Dri(float(rows[0, 0] * scale), float(rows[0, 1] * scale), float(self._seen[1] / self._rate_hz))


class HicMeter:
    """HIC of the head over all windows up to `length_s`; `push` gravity-free levelled acceleration (n, 3), z up."""

    def __init__(self, rate_hz: float, length_s: float, window_s: float) -> None:
        self._rate_hz, self._length_s = rate_hz, length_s
        self._history = np.zeros((math.floor(length_s * rate_hz + 1e-9) + 2, 2, 3))
        self._filled = np.zeros(1, dtype=np.int64)
        self._tally = _Tally(rate_hz, 3, 1, 0, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, 3)."""
        g = accel_mps2 / STANDARD_GRAVITY_MPS2
        channels = np.column_stack([np.abs(g[:, 2] + 1.0), np.abs(g[:, 2]), np.sqrt((g**2).sum(axis=1))])
        t = self._tally
        kernels.head_injury(
            channels, 1.0 / self._rate_hz, self._length_s, self._history, self._filled,
            t.bin, t.total, t.ring, t.position, t.length,
        )  # fmt: skip

    def since_reset(self) -> Hic:
        """The largest since the last reset."""
        return self._hic(self._tally.since_reset())

    def rolling(self) -> Hic:
        """The largest over the last `window_s`."""
        return self._hic(self._tally.rolling())

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._tally.reset()

    def _hic(self, rows: Floats) -> Hic:
        as_printed, vertical, resultant = rows[:, 0].tolist()
        return Hic(as_printed, vertical, resultant, self._rate_hz / 2.0)


class ResidualMeter:
    """Rms of predicted minus measured per channel: `push` both (n, c) m/s^2; rows with NaN are left out."""

    def __init__(self, rate_hz: float, channels: int, window_s: float) -> None:
        self._tally = _Tally(rate_hz, channels, 3, 3, window_s)

    def push(self, predicted_mps2: Floats, measured_mps2: Floats) -> None:
        """Count a block."""
        t = self._tally
        kernels.residual(predicted_mps2, measured_mps2, t.bin, t.total, t.ring, t.position, t.length)

    def since_reset(self) -> tuple[Floats, Floats]:
        """Return (rms m/s^2, rms over measured rms in percent), each (c,), NaN where nothing was compared."""
        return self._rms(self._tally.since_reset())

    def rolling(self) -> tuple[Floats, Floats]:
        """The same over the last `window_s`."""
        return self._rms(self._tally.rolling())

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._tally.reset()

    @staticmethod
    def _rms(rows: Floats) -> tuple[Floats, Floats]:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(rows[:, 0] / rows[:, 2]), 100.0 * np.sqrt(rows[:, 0] / rows[:, 1])


def _first_order_hold(omega: float, zeta: float, step_s: float) -> Floats:
    """Exact step of z'' + 2 zeta w z' + w^2 z = -a for a linear between samples: (2, 4) on [z, z', a before, a now]."""
    block = np.zeros((4, 4))
    block[0, 1] = 1.0
    block[1] = [-(omega**2), -2.0 * zeta * omega, -1.0, 0.0]
    block[2, 3] = 1.0 / step_s
    moved = linalg.expm(block * step_s)
    # The fourth state is the rise of a over the step: a now - a before.
    return np.column_stack([moved[:2, :2], moved[:2, 2] - moved[:2, 3], moved[:2, 3]])
