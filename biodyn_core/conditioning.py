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

from biodyn_core.errors import InputError
from biodyn_core.kernels import sensor as kernels
from biodyn_core.segments import STANDARD_GRAVITY_MPS2
from biodyn_core.settings import check_settings, setting
from biodyn_core.weighting import MIN_RATE_HZ, RATE_TOLERANCE

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
    """What a second at rest tells of a sensor: its clock, gravity (norm, m/s^2) and vertical (unit vector).

    uncounted_s is what passed until then.
    """

    period_s: float
    last_time_s: float
    jitter_s: float
    uncounted_s: float
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
        # Copies: what comes from a message may be read-only or strided, and each such kind would be compiled anew.
        samples_mps2 = np.array(samples_mps2, dtype=np.float64, order="C")
        if self.epoch_ns is None:
            found = self._look_for_rest(stamps_ns, samples_mps2)
            if found is None:
                return []
            stamps_ns, samples_mps2 = found
        assert self.epoch_ns is not None
        stamps_s: Floats = np.asarray(stamps_ns - self.epoch_ns, dtype=np.float64) * 1e-9
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
            uncounted_s=rest.uncounted_s if rest else 0.0,
            gap_s=self.gap_s,
            warnings=tuple(self.warnings),
            fault=self.fault,
        )

    def _look_for_rest(self, stamps_ns: Integers, samples: Floats) -> tuple[Integers, Floats] | None:
        """Collect until gravity is known; return the samples that come after it, or None while it is not."""
        try:
            found = self._waiting.push(stamps_ns, samples)
        except InputError as error:
            self.fault = f"{self.sensor}: {error}"
            return None
        if found is None:
            return None
        self.rest, self.epoch_ns, self._last[:] = found.rest, found.epoch_ns, found.last_mps2
        self._start(self.rest)
        return found.stamps_ns, found.samples_mps2

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
        self._clock[:] = rest.last_time_s, rest.period_s, rest.period_s, rest.last_time_s, rest.jitter_s
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


class _Found(NamedTuple):
    """The end of waiting: what rest told, the epoch its times count from, what comes after it, its last sample."""

    rest: Rest
    epoch_ns: int
    stamps_ns: Integers
    samples_mps2: Floats
    last_mps2: Floats


class _RestWindow:
    """Collects the first seconds of a sensor until one window of them is at rest, or patience runs out.

    No window spans a gap or a jump of the stamps: behind one, waiting starts anew.
    """

    def __init__(self, settings: ConditioningSettings) -> None:
        self._settings = settings
        self._stamps_ns: Integers = np.empty(0, dtype=np.int64)
        self._samples: Floats = np.empty((0, 3))
        self._start = 0
        self._first = 0

    def push(self, stamps_ns: Integers, samples: Floats) -> _Found | None:
        """Return what was found, or None while there is no rest yet; raises InputError where there never will be."""
        self._stamps_ns = np.concatenate([self._stamps_ns, stamps_ns])
        self._samples = np.concatenate([self._samples, samples])
        while True:
            end = self._window_end()
            if end is None:
                return None
            found = self._judge(self._start, end)
            if found is not None:
                return found
            self._start = end

    def _window_end(self) -> int | None:
        """End of the window that begins at `_start`, moved behind the first break in it; None while it is not full."""
        while True:
            stamps_ns = self._stamps_ns[self._start :]
            past = np.flatnonzero(stamps_ns - stamps_ns[0] >= round(self._settings.rest_s * 1e9))
            inside = stamps_ns[: past[0] + 1] if past.size else stamps_ns
            steps_s = np.diff(inside) * 1e-9
            breaks = np.flatnonzero((steps_s > self._settings.max_gap_s) | (steps_s < -kernels.JUMP_BACK_S))
            if breaks.size == 0:
                break
            self._start = self._first = self._start + int(breaks[0]) + 1
        first = stamps_ns[:_STANDING_SAMPLES]
        if first.size == _STANDING_SAMPLES and first.max() == first.min():
            raise InputError("stamps stand still: use log time (--time log), or mend the driver's stamps")
        return self._start + int(past[0]) if past.size else None

    def _judge(self, begin: int, end: int) -> _Found | None:
        """The window [begin, end) if it is at rest; once patience has run out, everything since the last break."""
        window = self._usable(begin, end)
        moving = len(window) < 2 or _rms_about_mean(window) > self._settings.rest_rms_mps2
        waited_s = 1e-9 * int(self._stamps_ns[end] - self._stamps_ns[self._first])
        if moving and waited_s < self._settings.rest_patience_s:
            return None
        if moving:
            begin, window = self._first, self._usable(self._first, end)
        if len(window) < 2:
            raise InputError("no finite sample arrived: check the sensor")
        epoch_ns = int(self._stamps_ns[begin])
        rest = self._told(begin, end, window.mean(axis=0), moving)
        return _Found(rest, epoch_ns, self._stamps_ns[end:], self._samples[end:], self._usable(0, end)[-1])

    def _told(self, begin: int, end: int, mean: Floats, moving: bool) -> Rest:
        stamps_s = np.asarray(self._stamps_ns[begin:end] - self._stamps_ns[begin], dtype=np.float64) * 1e-9
        samples = self._samples[begin:end]
        fresh = np.concatenate([[True], (np.diff(stamps_s) != 0.0) | (samples[1:] != samples[:-1]).any(axis=1)])
        clock = fit_clock(stamps_s[fresh])
        rate = 1.0 / clock.period_s
        least = max(MIN_RATE_HZ, 2.5 * self._settings.cutoff_hz)
        if not least * (1.0 - RATE_TOLERANCE) <= rate <= MAX_RATE_HZ:
            raise InputError(f"a rate of {rate:.4g} Hz does not fit, {least:g} to {MAX_RATE_HZ:g} Hz are needed")
        norm = float(np.linalg.norm(mean))
        if norm < 0.5 * STANDARD_GRAVITY_MPS2:
            raise InputError(f"at rest it reads {norm:.2f} m/s^2: without gravity the vertical is unknown (REP-145)")
        x, y, z = (mean / norm).tolist()
        return Rest(clock.period_s, clock.last_s, clock.jitter_s, end * clock.period_s, norm, (x, y, z), moving)

    def _usable(self, begin: int, end: int) -> Floats:
        part = self._samples[begin:end]
        # As the kernel does later; squares of what it would reject may overflow, and one such sample spoils a mean.
        usable: Floats = part[(np.abs(part) < kernels.IMPLAUSIBLE * self._settings.saturation_mps2).all(axis=1)]
        return usable


def _rms_about_mean(samples: Floats) -> float:
    return float(np.sqrt(((samples - samples.mean(axis=0)) ** 2).sum(axis=1).mean()))


class Clock(NamedTuple):
    """A sensor's clock by its stamps: sampling period, fitted time of the last stamp, mean absolute jitter, seconds."""

    period_s: float
    last_s: float
    jitter_s: float


def fit_clock(stamps_s: Floats) -> Clock:
    """Fit an even clock to stamps (n,) in order of arrival; jittered, in bursts, quantised, or with samples lost.

    Samples are counted as lost only in gaps that jitter does not explain; raises InputError below three stamps.
    """
    if stamps_s.size < 3:
        raise InputError("fewer than three different samples: the rate is unknown")
    index = np.arange(stamps_s.size, dtype=np.float64)
    period, first = _line(index, stamps_s)
    gaps = np.diff(stamps_s)
    spread = 1.4826 * float(np.median(np.abs(gaps - np.median(gaps))))
    for _ in range(2):
        longest = max(1.5 * period, period + 5.0 * spread)
        lost = np.where(gaps > longest, np.maximum(np.rint(gaps / period) - 1.0, 0.0), 0.0)
        if lost.sum() > 0.5 * stamps_s.size:
            lost[:] = 0.0  # not a stream that loses most of itself, but one that comes in bursts
        index[1:] = np.cumsum(1.0 + lost)
        period, first = _line(index, stamps_s)
    jitter = float(np.abs(stamps_s - first - period * index).mean())
    return Clock(period, first + period * float(index[-1]), jitter)


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
