"""Exposure: aw, MTVV, crest factor, VDV, MSDV, DRI and HIC, and the residual's rms; live and batch are one class each.

Every meter takes blocks of any size and answers since reset and over the last `window_s`; cuts never change a number.
A NaN sample is missing and `skip(seconds)` is a break of that length, 0 where time jumped back: windows move on by it,
nothing is counted for it, and filters, oscillators and windows start anew behind it. So what is missing makes every
figure a lower bound, but for what a weighting adds that starts from a wrong level (`_Weighting`).
ISO 2631-1:1997; Zaman et al., Eq. 23-27, in the definitions their contradictions forced on us.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from biodyn_core import kernels
from biodyn_core.arrays import Floats
from biodyn_core.errors import InputError
from biodyn_core.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.weighting import CURVES, WeightingName, weighting_sections

BIN_S: Final = 0.1
"""Rolling figures move in steps of this."""

MTVV_TIME_CONSTANT_S: Final = 1.0
"""MTVV is the largest exponentially averaged running rms (ISO 2631-1:1997, 6.3.1, Eq. 3)."""

LEVEL_SHARE: Final = 0.2
"""A channel's slow level is its mean by a first-order low-pass at this share of the weighting's high-pass frequency.

2 s for Wk and Wd, 10 s for Wf. Shorter, and vibration passes for level; longer, and braking, bends and a body that
leans over go unnoticed: on cars, trams and buses 1 to 3 s leave the least false dose behind breaks.
"""

SHORTEST_MSDV_S: Final = 100.0
"""No motion sickness dose of less: eight periods of Wf's lower band limit.

ISO 2631-1:1997, 5.5 asks for a duration of reasonable statistical precision and leaves the figure for Wf open.
"""

DRI_OMEGA_RAD_PER_S: Final = 52.9
DRI_DAMPING_RATIO: Final = 0.224
DRI_BANDS: Final = ((5.2, "< 5.2"), (13.0, "5.2-13.0"), (17.7, "13.0-17.7"), (math.inf, "> 17.7 (AIS 2+ threshold)"))


@dataclass(frozen=True)
class Dose:
    """Weighted exposure of one channel: aw and MTVV m/s^2, VDV m/s^1.75, weighted peak m/s^2, seconds counted.

    MTVV's running mean square starts at zero behind a break. What it held there could only have added to the later
    ones, so it is a lower bound like the others.
    """

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
class MotionSickness:
    """Motion sickness dose MSDVz m/s^1.5, None while fewer than SHORTEST_MSDV_S were counted, and seconds counted."""

    msdv_mps15: float | None
    seconds: float


@dataclass(frozen=True)
class Dri:
    """Dynamic Response Index: for one upward pulse, not a dose of repeated shocks (Eq. 24, 25).

    `compression` counts spinal compression alone and is the headline; `as_printed` takes |z|. time_s: when it was
    largest, since reset, breaks included.
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
        self._rate_hz = rate_hz
        self._left_over = 0.0
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

    def kept(self) -> Floats:
        """What was counted since reset, (c, k), sums by the second: rates differ a little from start to start."""
        rows = self.since_reset()
        rows[:, : self.sums] /= self._rate_hz
        return rows

    def go_on_from(self, rows: Floats) -> None:
        """Add what was kept; the rolling window knows nothing of it."""
        earlier = rows.copy()
        earlier[:, : self.sums] *= self._rate_hz
        self.total = self._join(self.total, earlier)

    def reset(self) -> None:
        """Start "since reset" anew; the rolling window goes on."""
        self.ring[self.position[1] % len(self.ring)] = self.bin
        self.position[:] = 0, self.position[1] + 1
        self.bin[:] = 0.0
        self.total[:] = 0.0

    def skip(self, seconds: float) -> int:
        """Let time pass without samples; returns how many would have come. What is rounded is made good next time."""
        if not 0.0 <= seconds < math.inf:
            raise InputError(f"a break of {seconds:g} s cannot be: it lasts 0 s or longer")
        passed = self._left_over + seconds * self._rate_hz
        samples = round(passed)
        self._left_over = passed - samples
        closed, self.position[0] = divmod(int(self.position[0]) + samples, self.length)
        if closed:
            slots = len(self.ring)
            self.total = self.since_reset()
            self.ring[self.position[1] % slots] = self.bin
            self.bin[:] = 0.0
            self.position[1] += closed
            # The bin that was open when the break came is closed with what it holds, those behind it are empty.
            self.ring[(self.position[1] - 1 - np.arange(min(closed - 1, slots))) % slots] = 0.0
        return samples


class _Weighting:
    """A weighting's sections, their state for channels, and each channel's slow level.

    A body that has leaned over since gravity was taken off carries a constant, 1.7 m/s^2 at 10 degrees. Sections that
    start from zero under it see a step, a false VDV of 0.73 by Wd. So behind a break they start in steady state for the
    level, the mean of what lies within 1 g; at the very start that is zero. Where the level changes within a break the
    step remains, as it must.
    """

    def __init__(self, name: WeightingName, rate_hz: float, channels: int) -> None:
        self.sos = weighting_sections(name, rate_hz)
        self.state = np.zeros((len(self.sos), 2, channels))
        self.level = np.zeros(channels)
        self.follow = 1.0 - math.exp(-2.0 * math.pi * LEVEL_SHARE * CURVES[name].f1_hz / rate_hz)

    def restart(self) -> None:
        """Start behind a break."""
        for channel, level in enumerate(self.level.tolist()):
            kernels.settle(self.sos, self.state, channel, level)


class _Meter:
    """What all meters have: a tally, whose sums since reset can be kept and gone on from."""

    _tally: _Tally

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._tally.reset()

    def kept(self) -> Floats:
        """What was counted since reset, for `go_on_from` of a meter of another run."""
        return self._tally.kept()

    def go_on_from(self, kept: Floats) -> None:
        """Count on from what was kept; raises InputError for what no meter counts."""
        if kept.min(initial=0.0) < 0.0:
            raise InputError("kept with a sum of powers below zero")
        self._tally.go_on_from(kept)


class DoseMeter(_Meter):
    """aw, MTVV, VDV and peak of channels sharing a clock: `push` blocks (n, c) of m/s^2, unweighted."""

    def __init__(self, weighting: WeightingName, rate_hz: float, channels: int, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._weighting = _Weighting(weighting, rate_hz, channels)
        self._decay = 1.0 - math.exp(-1.0 / (MTVV_TIME_CONSTANT_S * rate_hz))
        self._running = np.zeros(channels)
        self._tally = _Tally(rate_hz, channels, 5, 3, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, c)."""
        w, t = self._weighting, self._tally
        kernels.dose(
            accel_mps2, w.sos, w.state, w.follow, w.level, self._decay, self._running,
            t.bin, t.total, t.ring, t.position, t.length,
        )  # fmt: skip

    def skip(self, seconds: float) -> None:
        """Nothing was measured for that long."""
        self._tally.skip(seconds)
        self._weighting.restart()
        self._running[:] = 0.0

    def since_reset(self) -> tuple[Dose, ...]:
        """One Dose per channel since the last reset."""
        return self._doses(self._tally.since_reset())

    def rolling(self) -> tuple[Dose, ...]:
        """One Dose per channel over the last `window_s`."""
        return self._doses(self._tally.rolling())

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


class HorizontalMeter(_Meter):
    """Wd-weighted aw and VDV of the horizontal plane in every direction at once, from the moments of both axes."""

    def __init__(self, rate_hz: float, window_s: float) -> None:
        self._rate_hz = rate_hz
        self._weighting = _Weighting("Wd", rate_hz, 2)
        self._tally = _Tally(rate_hz, 1, 9, 9, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, 2)."""
        w, t = self._weighting, self._tally
        kernels.planar_dose(accel_mps2, w.sos, w.state, w.follow, w.level, t.bin, t.total, t.ring, t.position, t.length)

    def skip(self, seconds: float) -> None:
        """Nothing was measured for that long."""
        self._tally.skip(seconds)
        self._weighting.restart()

    def go_on_from(self, kept: Floats) -> None:
        """Count on from what was kept; mixed moments of both axes may be below zero."""
        self._tally.go_on_from(kept)

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


class MotionSicknessMeter:
    """Motion sickness dose value of the vertical: root of the integral of the squared Wf-weighted acceleration.

    `push` blocks (n, 1) of m/s^2, unweighted. ISO 2631-1:1997, clause 9 and Annex D.
    """

    def __init__(self, rate_hz: float) -> None:
        self._meter = DoseMeter("Wf", rate_hz, 1, BIN_S)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, 1)."""
        self._meter.push(accel_mps2)

    def skip(self, seconds: float) -> None:
        """Nothing was measured for that long."""
        self._meter.skip(seconds)

    def since_reset(self) -> MotionSickness:
        """The dose since the last reset."""
        (dose,) = self._meter.since_reset()
        enough = dose.seconds >= SHORTEST_MSDV_S
        return MotionSickness(dose.aw_mps2 * math.sqrt(dose.seconds) if enough else None, dose.seconds)

    def reset(self) -> None:
        """Start "since reset" anew."""
        self._meter.reset()

    def kept(self) -> Floats:
        """What was counted since reset."""
        return self._meter.kept()

    def go_on_from(self, kept: Floats) -> None:
        """Count on from what was kept."""
        self._meter.go_on_from(kept)


class DriMeter(_Meter):
    """The DRI oscillator driven by the seat's vertical acceleration, gravity-free, exact between samples.

    Behind a break it starts at rest. The level a body's lean leaves in the vertical is of second order, 0.15 m/s^2 at
    10 degrees, and worth 0.02 of compression; the level of a shock's middle would be worth far more.
    """

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

    def skip(self, seconds: float) -> None:
        """Nothing was measured for that long."""
        self._seen[0] += self._tally.skip(seconds)
        self._state[:] = 0.0

    def since_reset(self) -> Dri:
        """The largest since the last reset."""
        return self._dri(self._tally.since_reset())

    def rolling(self) -> Dri:
        """The largest over the last `window_s`; its time is that of the largest since reset."""
        return self._dri(self._tally.rolling())

    def reset(self) -> None:
        """Start "since reset" anew."""
        super().reset()
        self._seen[:] = 0

    def kept(self) -> Floats:
        """As of every meter, with the seconds that passed and when it was largest, (1, 4)."""
        return np.column_stack([super().kept(), self._seen[None] / self._rate_hz])

    def go_on_from(self, kept: Floats) -> None:
        """Count on from what was kept."""
        largest, before = self._tally.since_reset()[0, 0], np.rint(kept[0, 2:] * self._rate_hz).astype(np.int64)
        self._seen += before[0]
        if kept[0, 0] >= largest:
            self._seen[1] = before[1]
        super().go_on_from(np.ascontiguousarray(kept[:, :2]))

    def _dri(self, rows: Floats) -> Dri:
        scale = DRI_OMEGA_RAD_PER_S**2 / STANDARD_GRAVITY_MPS2
        return Dri(float(rows[0, 0] * scale), float(rows[0, 1] * scale), float(self._seen[1] / self._rate_hz))


class HicMeter(_Meter):
    """HIC of the head over all windows up to `length_s`; `push` gravity-free levelled acceleration (n, 3), z up."""

    def __init__(self, rate_hz: float, length_s: float, window_s: float) -> None:
        self._rate_hz, self._length_s = rate_hz, length_s
        whole = math.floor(length_s * rate_hz + 1e-9)
        self._weights = np.append(np.arange(1, whole + 1) / rate_hz, length_s) ** -0.6
        self._history = np.zeros((3, 2, 2 * (whole + 2)))
        self._filled = np.zeros((3, 2), dtype=np.int64)
        self._tally = _Tally(rate_hz, 3, 1, 0, window_s)

    def push(self, accel_mps2: Floats) -> None:
        """Count a block (n, 3)."""
        g = accel_mps2 / STANDARD_GRAVITY_MPS2
        channels = np.column_stack([np.abs(g[:, 2] + 1.0), np.abs(g[:, 2]), np.sqrt((g**2).sum(axis=1))])
        t = self._tally
        kernels.head_injury(
            channels, 1.0 / self._rate_hz, self._length_s, self._weights, self._history, self._filled,
            t.bin, t.total, t.ring, t.position, t.length,
        )  # fmt: skip

    def skip(self, seconds: float) -> None:
        """Nothing was measured for that long; no window reaches across."""
        self._tally.skip(seconds)
        self._filled[:, 0] = 0

    def since_reset(self) -> Hic:
        """The largest since the last reset."""
        return self._hic(self._tally.since_reset())

    def rolling(self) -> Hic:
        """The largest over the last `window_s`."""
        return self._hic(self._tally.rolling())

    def _hic(self, rows: Floats) -> Hic:
        as_printed, vertical, resultant = (rows[:, 0] ** 2.5).tolist()
        return Hic(as_printed, vertical, resultant, self._rate_hz / 2.0)


class ResidualMeter(_Meter):
    """Rms of predicted minus measured per channel: `push` both (n, c) m/s^2; rows with NaN are left out."""

    def __init__(self, rate_hz: float, channels: int, window_s: float) -> None:
        self._tally = _Tally(rate_hz, channels, 3, 3, window_s)

    def push(self, predicted_mps2: Floats, measured_mps2: Floats) -> None:
        """Count a block."""
        t = self._tally
        kernels.residual(predicted_mps2, measured_mps2, t.bin, t.total, t.ring, t.position, t.length)

    def skip(self, seconds: float) -> None:
        """Nothing was measured for that long."""
        self._tally.skip(seconds)

    def since_reset(self) -> tuple[Floats, Floats]:
        """Return (rms m/s^2, rms over measured rms in percent), each (c,), NaN where nothing was compared."""
        return self._rms(self._tally.since_reset())

    def rolling(self) -> tuple[Floats, Floats]:
        """The same over the last `window_s`."""
        return self._rms(self._tally.rolling())

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
