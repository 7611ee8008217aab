"""Delay and interpolation: the measured frames compared with the theory of filter and interpolator."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SEAT, SENSORS
from biodyn_core.conditioning.alignment import half_width
from biodyn_core.pipeline.frames import Frames
from conformance import record, twins
from conformance.record import START_NS, Stream
from conformance.table import Row, RowTable

Floats = NDArray[np.float64]

RATES_HZ: Final = (250.0, 500.0, 1000.0, 1129.3, 2000.0)
CUTOFF_HZ: Final = 100.0
SECONDS: Final = 6.0
STEADY_S: Final = (3.0, 5.0)
"""Time span in which the filter has settled and all neighbours exist."""

DELAY_HZ: Final = (1.0, 2.0, 5.0, 10.0, 30.0, 100.0)
LAG_TOLERANCE_S: Final = 1e-6
GAIN_TOLERANCE: Final = 1e-3
INTERPOLATION_TOLERANCE: Final = 0.005
TOP_HZ: Final = 100.3
LATE_SAMPLES: Final = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)
AMPLITUDE_MPS2: Final = 5.0


class _Grid:
    """Collects the measured frames of a replay: instants (n,) s since the start, and the sensors (n, 6)."""

    def __init__(self, streams: Mapping[str, Stream]) -> None:
        self._parts: list[tuple[NDArray[np.int64], Floats]] = []
        self.replayed = record.replayed(streams, each=self._add)
        self.time_s = np.concatenate([stamps - START_NS for stamps, _ in self._parts]) * 1e-9
        self.accel_mps2 = np.concatenate([accel for _, accel in self._parts])
        steady = (self.time_s > STEADY_S[0]) & (self.time_s < STEADY_S[1])
        self.time_s, self.accel_mps2 = self.time_s[steady], self.accel_mps2[steady]

    def _add(self, frames: Frames) -> None:
        self._parts.append((frames.measured.stamps_ns, frames.measured.accel_mps2))

    def phasor(self, sensor: str, frequency_hz: float) -> complex:
        """Complex amplitude of a sine in a sensor's column, by least squares; relative to the truth at the stamps."""
        angle = 2.0 * np.pi * frequency_hz * self.time_s
        basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones(angle.size)])
        s, c, _ = np.linalg.lstsq(basis, self.accel_mps2[:, SENSORS.index(sensor)], rcond=None)[0]
        return complex(s, c) / AMPLITUDE_MPS2


def sine(time_s: Floats, frequency_hz: float) -> Floats:
    """A sine with a rise of half a second."""
    rise = np.clip((time_s - record.BEGIN_S) / 0.5, 0.0, 1.0)
    return AMPLITUDE_MPS2 * np.sin(0.5 * np.pi * rise) ** 2 * np.sin(2.0 * np.pi * frequency_hz * time_s)


# --- delay -----------------------------------------------------------------------------------------------------------


def filter_delay_s(rate_hz: float) -> float:
    """Group delay at 0 Hz of the 4th-order Butterworth low-pass by the bilinear transform, from its pole angles."""
    angles = (math.pi / 8.0, 3.0 * math.pi / 8.0)
    return sum(math.cos(angle) for angle in angles) / (rate_hz * math.tan(math.pi * CUTOFF_HZ / rate_hz))


def filter_gain(frequency_hz: float, rate_hz: float) -> complex:
    """Gain of that low-pass, by its analog prototype at the prewarped frequency."""
    s = 1j * math.tan(math.pi * frequency_hz / rate_hz) / math.tan(math.pi * CUTOFF_HZ / rate_hz)
    quadratics = (s * s + 2.0 * math.cos(k * math.pi / 8.0) * s + 1.0 for k in (1, 3))
    return 1.0 / math.prod(quadratics, start=1.0 + 0j)


def delay_rows(rate_hz: float) -> list[Row]:
    """Gain and remaining lag of sines, one per sensor, after subtraction of the filter's delay from the stamps."""
    time = record.instants(rate_hz, SECONDS)
    streams = {s: record.stream(s, time, sine(time, f)) for s, f in zip(SENSORS, DELAY_HZ, strict=True)}
    grid = _Grid(streams)
    delay_s = filter_delay_s(rate_hz)
    found_ms = 1e3 * (grid.replayed.pipeline.status(SEAT).filter_delay_s or math.nan)
    what = f"delay taken off at {rate_hz:g} Hz"
    rows = [Row(what, found_ms, 1e3 * delay_s, 1e3 * LAG_TOLERANCE_S, "ms", absolute=True)]
    for sensor, frequency in zip(SENSORS, DELAY_HZ, strict=True):
        what = f"sine of {frequency:g} Hz at {rate_hz:g} Hz"
        rows += _against_theory(what, grid.phasor(sensor, frequency), frequency, rate_hz, delay_s)
    return rows


def _against_theory(what: str, found: complex, frequency_hz: float, rate_hz: float, delay_s: float) -> list[Row]:
    omega = 2.0 * math.pi * frequency_hz
    wanted = filter_gain(frequency_hz, rate_hz) * cmath.exp(1j * omega * delay_s)
    lags_ms = (-1e3 * cmath.phase(found) / omega, -1e3 * cmath.phase(wanted) / omega)
    return [
        Row(f"gain, {what}", abs(found), abs(wanted), GAIN_TOLERANCE),
        Row(f"lag, {what}", *lags_ms, 1e3 * LAG_TOLERANCE_S, "ms", absolute=True),
    ]


# --- interpolation ---------------------------------------------------------------------------------------------------


def interpolation_rows(rate_hz: float) -> list[Row]:
    """Largest error of sensors with a delay of a fraction of a sample, interpolated at the seat's instants."""
    streams = {}
    for sensor, late in zip(SENSORS, LATE_SAMPLES, strict=True):
        time = record.instants(rate_hz, SECONDS, late)
        streams[sensor] = record.stream(sensor, time, sine(time, TOP_HZ))
    grid = _Grid(streams)
    amplitude = AMPLITUDE_MPS2 * abs(filter_gain(TOP_HZ, rate_hz))
    apart = 100.0 * np.abs(grid.accel_mps2 - grid.accel_mps2[:, :1]).max(axis=0) / amplitude
    rows = []
    for late, error in zip(LATE_SAMPLES[1:], apart[1:].tolist(), strict=True):
        what, allowed = f"{late:g} samples late at {rate_hz:g} Hz", 100.0 * INTERPOLATION_TOLERANCE
        rows.append(Row(f"{what}, error", error, 0.0, allowed, "%", absolute=True))
        theory = 100.0 * lagrange_error(late, rate_hz)
        rows.append(Row(f"{what}, by theory", error, theory, 0.02 * allowed, "%", absolute=True))
    return rows


def lagrange_error(late_samples: float, rate_hz: float) -> float:
    """Largest relative error of a sine interpolated by the Lagrange polynomial of its nearest neighbours."""
    half = half_width(rate_hz, CUTOFF_HZ)
    nodes = np.arange(1.0 - half, half + 1.0)
    angle = 2j * np.pi * TOP_HZ / rate_hz
    at = 1.0 - late_samples
    return float(abs(twins.lagrange(nodes, np.exp(angle * nodes), at) - np.exp(angle * at)))


def mixed_rows() -> list[Row]:
    """Sensors of different rates on the seat's grid."""
    frequency, seat_hz = 30.0, 1129.3
    rates = dict(zip(SENSORS, (seat_hz, 1000.0, 500.0, 2000.0, 1129.9, 400.0), strict=True))
    streams = {}
    for sensor, rate_hz in rates.items():
        time = record.instants(rate_hz, SECONDS)
        streams[sensor] = record.stream(sensor, time, sine(time, frequency))
    grid = _Grid(streams)
    rows = []
    for sensor, rate_hz in rates.items():
        what = f"{frequency:g} Hz, sampled at {rate_hz:g} Hz, read at {seat_hz:g} Hz"
        rows += _against_theory(what, grid.phasor(sensor, frequency), frequency, rate_hz, filter_delay_s(rate_hz))
    return rows


# --- sections --------------------------------------------------------------------------------------------------------

DELAY_WORDS: Final = f"""\
From the measured frames, six sines at once; lag: delay of the sine against the truth at the stamp of the frame.
Reference: the 4th-order Butterworth low-pass in closed form, warped by the bilinear transform, less its group delay at
0 Hz, which is subtracted from the stamps. Tolerance: {1e6 * LAG_TOLERANCE_S:g} µs and {100.0 * GAIN_TOLERANCE:g} %."""
MIXED_WORDS: Final = "The same for sensors of different rates, interpolated to the instants of the seat."
INTERPOLATION_WORDS: Final = f"""\
From the measured frames: five sensors measure the sine of the seat of {TOP_HZ:g} Hz (100 Hz would meet few phases
only), with clocks late by a part of a sample; largest difference from the frame of the seat, per amplitude. Tolerance:
{100.0 * INTERPOLATION_TOLERANCE:g} % at 100 Hz. Reference for the theory: Lagrange's polynomial through as many
neighbours."""


def sections() -> list[RowTable]:
    """All sections; about three seconds."""
    delay = tuple(row for rate_hz in RATES_HZ for row in delay_rows(rate_hz))
    interpolation = tuple(row for rate_hz in RATES_HZ for row in interpolation_rows(rate_hz))
    return [
        RowTable("Delay", DELAY_WORDS, delay),
        RowTable("Rates", MIXED_WORDS, tuple(mixed_rows())),
        RowTable("Interpolation", INTERPOLATION_WORDS, interpolation),
    ]
