"""Conditioning: one sensor's raw stamps and samples become evenly spaced, levelled, gravity-free, low-passed ones.

Causal, and the same numbers for any cut into blocks. The low-pass's low-frequency group delay is taken off the stamps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from biodyn_core import kernels
from biodyn_core.errors import InputError
from biodyn_core.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.settings import check_settings, setting
from biodyn_core.weighting import MIN_RATE_HZ

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

FILTER_ORDER: Final = 4
"""Butterworth low-pass of the paper, 5.2."""

MAX_RATE_HZ: Final = 20_000.0
CLOCK_TIME_CONSTANT_S: Final = 1.0
GRAVITY_TOLERANCE: Final = 0.05
LAP_S: Final = 1e6
"""Added to a sensor's own seconds whenever its stamps jump back, so that time inside never does."""

_STANDING_SAMPLES: Final = 1_000
"""So many samples without a later stamp mean that stamps stand still."""


@dataclass(frozen=True)
class ConditioningSettings:
    """How every sensor is conditioned."""

    cutoff_hz: float = setting(100.0, "low-pass cut-off of the model's input and of comparisons", "Hz", 5.0, 200.0)
    rest_s: float = setting(0.8, "seconds at rest from which gravity, vertical and clock are taken", "s", 0.2, 60.0)
    rest_patience_s: float = setting(
        10.0, "seconds to wait for rest before motion is averaged instead", "s", 0.2, 600.0
    )
    rest_rms_mps2: float = setting(0.3, "largest rms about the mean that still counts as rest", "m/s^2", 0.01, 5.0)
    max_gap_s: float = setting(
        0.05, "longest gap that is interpolated; a longer one splits the record", "s", 0.002, 1.0
    )
    saturation_mps2: float = setting(156.9, "reading of one axis that counts as clipped (16 g)", "m/s^2", 10.0, 5000.0)

    def __post_init__(self) -> None:
        check_settings(self)


class Block(NamedTuple):
    """Conditioned samples of one sensor, evenly spaced within one run.

    stamps_ns (n,) and time_s (n,) are the instants answered, filter delay taken off (time_s since epoch_ns, the
    sensor's first stamp, for alignment); levelled_mps2 (n, 3), gravity-free, third axis up, before the low-pass;
    low_passed_mps2 (n,), vertical.
    """

    stamps_ns: Integers
    time_s: Floats
    levelled_mps2: Floats
    low_passed_mps2: Floats
    begins_run: bool
    epoch_ns: int


@dataclass(frozen=True)
class Rest:
    """What a second at rest tells of a sensor: sampling period, gravity (norm, m/s^2) and vertical (unit vector)."""

    period_s: float
    last_time_s: float
    gravity_mps2: float
    vertical: tuple[float, float, float]
    in_motion: bool


@dataclass(frozen=True)
class SensorStatus:
    """What one sensor's conditioning has seen so far; `fault` says in one line why it answers nothing."""

    rate_hz: float | None
    gravity_mps2: float | None
    vertical: tuple[float, float, float] | None
    filter_delay_s: float | None
    accepted: int
    late: int
    non_finite: int
    filled: int
    runs: int
    clipped: int
    uncounted_s: float
    gap_s: float
    warnings: tuple[str, ...]
    fault: str | None


class Conditioner:
    """One sensor: clock, gaps, vertical and gravity, low-pass. `push` raw samples, get `Block`s back."""

    def __init__(self, sensor: str, settings: ConditioningSettings | None = None) -> None:
        self.sensor = sensor
        self.settings = settings or ConditioningSettings()
        self.epoch_ns: int | None = None
        self.rest: Rest | None = None
        self.fault: str | None = None
        self.warnings: list[str] = []
        self.uncounted_s = 0.0
        self.gap_s = 0.0
        self._waiting = _RestWindow(self.settings)
        self._counts = np.zeros(kernels.COUNT_SIZE, dtype=np.int64)
        self._clock = np.zeros(kernels.CLOCK_SIZE)
        self._last = np.zeros(3)
        self._lap = 0
        self._new_run = True

    def push(self, stamps_ns: Integers, samples_mps2: Floats) -> list[Block]:
        """Condition raw specific force (n, 3) m/s^2 with header stamps (n,) ns, in order of arrival."""
        if stamps_ns.shape[0] == 0 or self.fault is not None:
            return []
        if self.epoch_ns is None:
            self.epoch_ns = int(stamps_ns[0])
        # Copies: what comes from a message may be read-only or strided, and each such kind would be compiled anew.
        samples_mps2 = np.array(samples_mps2, dtype=np.float64, order="C")
        stamps_s: Floats = np.asarray(stamps_ns - self.epoch_ns, dtype=np.float64) * 1e-9
        if self.rest is None:
            kept = self._look_for_rest(stamps_s, samples_mps2)
            if kept is None:
                return []
            stamps_s, samples_mps2 = kept
            stamps_ns = self.epoch_ns + np.rint(stamps_s * 1e9).astype(np.int64)
        return self._condition(stamps_ns, stamps_s, samples_mps2, self.epoch_ns)

    @property
    def rate_hz(self) -> float:
        """Sampling rate the filters were designed for; known after rest."""
        assert self.rest is not None
        return 1.0 / self.rest.period_s

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest accepted sample; None before gravity is known and right after time jumped back."""
        newest_s = float(self._clock[kernels.CLOCK_LAST_STAMP])
        if self.rest is None or self.epoch_ns is None or not math.isfinite(newest_s):
            return None
        return self.epoch_ns + round(newest_s * 1e9)

    def status(self) -> SensorStatus:
        """What was seen so far."""
        counts = [int(v) for v in self._counts]
        rest = self.rest
        return SensorStatus(
            rate_hz=1.0 / float(self._clock[kernels.CLOCK_PERIOD]) if rest else None,
            gravity_mps2=rest.gravity_mps2 if rest else None,
            vertical=rest.vertical if rest else None,
            filter_delay_s=self.delay_s if rest else None,
            accepted=counts[kernels.COUNT_ACCEPTED],
            late=counts[kernels.COUNT_LATE],
            non_finite=counts[kernels.COUNT_NONFINITE],
            filled=counts[kernels.COUNT_FILLED],
            runs=counts[kernels.COUNT_RUNS],
            clipped=counts[kernels.COUNT_CLIPPED],
            uncounted_s=self.uncounted_s,
            gap_s=self.gap_s,
            warnings=tuple(self.warnings),
            fault=self.fault,
        )

    def _look_for_rest(self, stamps_s: Floats, samples: Floats) -> tuple[Floats, Floats] | None:
        """Collect until gravity is known; return the samples that come after it, or None while it is not."""
        try:
            found = self._waiting.push(stamps_s, samples)
        except InputError as error:
            self.fault = f"{self.sensor}: {error}"
            return None
        if found is None:
            return None
        self.rest, stamps_s, samples, self._last[:] = found
        self.uncounted_s = self.rest.last_time_s + self.rest.period_s
        self._start(self.rest)
        return stamps_s, samples

    def _start(self, rest: Rest) -> None:
        """Design the filters for the rate found; they start in steady state for gravity: zero, once levelled."""
        self._sos = signal.butter(FILTER_ORDER, self.settings.cutoff_hz, fs=self.rate_hz, output="sos")
        self.delay_s = group_delay_s(self._sos, self.rate_hz)
        self._delay_ns = round(self.delay_s * 1e9)
        self._filter_state = np.zeros((len(self._sos), 2, 1))
        self._rotation = rotation_to_vertical(np.array(rest.vertical))
        turns = CLOCK_TIME_CONSTANT_S * self.rate_hz
        limits = self.settings
        self._constants = (limits.max_gap_s, 2.0 / turns, 1.0 / turns**2, limits.saturation_mps2, rest.gravity_mps2)
        self._clock[:] = rest.last_time_s, rest.period_s, rest.period_s, rest.last_time_s
        self._max_fill = int(self.settings.max_gap_s / (0.98 * rest.period_s)) + 2
        if rest.in_motion:
            self.warnings.append("no rest found: gravity was averaged over motion")
        if abs(rest.gravity_mps2 / STANDARD_GRAVITY_MPS2 - 1.0) > GRAVITY_TOLERANCE:
            self.warnings.append(f"gravity at rest reads {rest.gravity_mps2:.2f} m/s^2: gain, unit or mounting is off")

    def _condition(self, stamps_ns: Integers, stamps_s: Floats, samples: Floats, epoch_ns: int) -> list[Block]:
        blocks: list[Block] = []
        done, n = 0, stamps_s.shape[0]
        while done < n:
            room = n - done + self._max_fill + 2
            stamps, times = np.empty(room, dtype=np.int64), np.empty(room)
            levelled, low_passed = np.empty((room, 3)), np.empty((room, 1))
            last_s = self._clock[kernels.CLOCK_TIME]
            used, written, breaks = kernels.condition(
                stamps_ns[done:], stamps_s[done:], samples[done:], self._clock, self._last, self._counts,
                self._rotation, self._sos, self._filter_state, self._constants, epoch_ns, self._delay_ns,
                stamps, times, levelled, low_passed,
            )  # fmt: skip
            done += used
            if written:
                last_s = times[written - 1]
                shift_s = self._lap * LAP_S - self.delay_s
                low = low_passed[:written, 0]
                blocks.append(
                    Block(stamps[:written], times[:written] + shift_s, levelled[:written], low, self._new_run, epoch_ns)
                )
                self._counts[kernels.COUNT_RUNS] += self._new_run
                self._new_run = False
            if breaks:
                self._begin_run(float(last_s), float(stamps_s[done]))
        return blocks

    def _begin_run(self, ended_s: float, begins_s: float) -> None:
        """Nothing integrates across a break: filters start anew, and time that jumped back goes on in the next lap."""
        self._new_run = True
        self._filter_state[:] = 0.0
        if begins_s > ended_s:
            self.gap_s += begins_s - ended_s
        else:
            self._lap += 1


class _RestWindow:
    """Collects the first seconds of a sensor until one window of them is at rest, or patience runs out."""

    def __init__(self, settings: ConditioningSettings) -> None:
        self._settings = settings
        self._stamps_s: Floats = np.empty(0)
        self._samples: Floats = np.empty((0, 3))
        self._start = 0

    def push(self, stamps_s: Floats, samples: Floats) -> tuple[Rest, Floats, Floats, Floats] | None:
        """Return (what rest told, stamps and samples after it, the last sample in it), or None; raises InputError."""
        self._stamps_s = np.concatenate([self._stamps_s, stamps_s])
        self._samples = np.concatenate([self._samples, samples])
        while True:
            begin = self._start
            past = np.flatnonzero(self._stamps_s[begin:] - self._stamps_s[begin] >= self._settings.rest_s)
            if past.size == 0:
                first = self._stamps_s[begin : begin + _STANDING_SAMPLES]
                if first.size == _STANDING_SAMPLES and first.max() == first[0]:
                    raise InputError("stamps stand still: use log time (--time log), or mend the driver's stamps")
                return None
            end = begin + int(past[0])
            rest = self._judge(begin, end)
            if rest is not None:
                return rest, self._stamps_s[end:], self._samples[end:], self._usable(0, end)[-1]
            self._start = end

    def _judge(self, begin: int, end: int) -> Rest | None:
        """The window [begin, end) if it is at rest; once patience has run out, everything so far."""
        window = self._usable(begin, end)
        moving = len(window) < 2 or float(np.sqrt(((window - window.mean(axis=0)) ** 2).sum(axis=1).mean())) > (
            self._settings.rest_rms_mps2
        )
        if moving and self._stamps_s[end] - self._stamps_s[0] < self._settings.rest_patience_s:
            return None
        if moving:
            begin, window = 0, self._usable(0, end)
        if len(window) < 2:
            raise InputError("no finite sample arrived: check the sensor")
        period, last = fit_clock(self._stamps_s[begin:end])
        rate = 1.0 / period
        if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ or rate < 2.5 * self._settings.cutoff_hz:
            least = max(MIN_RATE_HZ, 2.5 * self._settings.cutoff_hz)
            raise InputError(f"a rate of {rate:.4g} Hz does not fit, {least:g} to {MAX_RATE_HZ:g} Hz are needed")
        mean = window.mean(axis=0)
        norm = float(np.linalg.norm(mean))
        if norm < 0.5 * STANDARD_GRAVITY_MPS2:
            raise InputError(f"at rest it reads {norm:.2f} m/s^2: without gravity the vertical is unknown (REP-145)")
        x, y, z = (mean / norm).tolist()
        return Rest(period, last, norm, (x, y, z), moving)

    def _usable(self, begin: int, end: int) -> Floats:
        part = self._samples[begin:end]
        # As the kernel does later; squares of what it would reject may overflow, and one such sample spoils a mean.
        usable: Floats = part[(np.abs(part) < kernels.IMPLAUSIBLE * self._settings.saturation_mps2).all(axis=1)]
        return usable


def fit_clock(stamps_s: Floats) -> tuple[float, float]:
    """Return (sampling period, fitted time of the last stamp) of nearly even stamps (n,), lost samples allowed."""
    rising = stamps_s[np.concatenate([[True], np.diff(np.maximum.accumulate(stamps_s)) > 0.0])]
    if rising.size < 3:
        raise InputError("fewer than three different stamps: the rate is unknown")
    index = np.arange(rising.size, dtype=np.float64)
    period, first = _line(index, rising)
    if np.abs(rising - first - period * index).max() > 0.5 * period:
        # Something is missing: count the periods in every gap instead of the samples.
        gaps = np.diff(rising)
        index[1:] = np.cumsum(np.maximum(1.0, np.rint(gaps / np.median(gaps))))
        period, first = _line(index, rising)
    return period, first + period * float(index[-1])


def _line(index: Floats, stamps_s: Floats) -> tuple[float, float]:
    slope, offset = np.polyfit(index, stamps_s, 1)
    return float(slope), float(offset)


def group_delay_s(sos: Floats, rate_hz: float) -> float:
    """Group delay at 0 Hz of second-order sections, seconds."""
    delay = 0.0
    for b0, b1, b2, a0, a1, a2 in sos.tolist():
        delay += (b1 + 2.0 * b2) / (b0 + b1 + b2) - (a1 + 2.0 * a2) / (a0 + a1 + a2)
    return delay / rate_hz


def rotation_to_vertical(up: Floats) -> Floats:
    """The smallest rotation, (3, 3), that turns the unit vector `up` onto the third axis (Rodrigues)."""
    x, y, z = up.tolist()
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    rotation: Floats = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation
