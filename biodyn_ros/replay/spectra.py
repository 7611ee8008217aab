"""Spectra of a replay's report, computed during the replay in constant memory."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, N_SEGMENTS, SENSORS
from biodyn_core.pipeline.frames import MeasuredFrames
from biodyn_core.signals.response import CrossSpectra, SpectraMeter
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.signals.waterfall import USABLE, Waterfall, WaterfallMeter
from biodyn_ros.reports.spectra_json import power_document, spectra_document, transmissibility_document

Document = dict[str, Any]

RATE_SAMPLES: Final = 1024
"""The rate is the mean step of the first so many samples, for any cut, without breaks."""

BREAK_STEPS: Final = 1.5
"""A step so many times the longest typical one is a break, as is a step back."""

TYPICAL_PERCENT: Final = 99.0
"""Percentile of the first steps that is the longest typical one: quantised stamps have uneven steps."""

_MAX_HZ: Final = 50.0
_MIN_RATE_HZ: Final = 10.0


class ReplaySpectra:
    """Spectra and waterfall of a replay: `add` the measured part of every push's frames.

    Predictions are masked like the measurements, so that both are of the same instants; no average spans a break of the
    seat. Block cuts change nothing.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[Integers, Floats]] = []
        self._count = 0
        self._last_ns: int | None = None
        self._longest_ns = 0.0
        self._meters: _Meters | None = None

    def add(self, measured: MeasuredFrames) -> None:
        """Add instants, which are processed in batches."""
        if measured.stamps_ns.size:
            self._waiting.append((measured.stamps_ns, np.hstack([measured.accel_mps2, measured.residual_mps2])))
            self._count += measured.stamps_ns.size
        if self._count > (RATE_SAMPLES if self._meters is None else 4 * RATE_SAMPLES):
            self._process()

    def spectra(self) -> Document | None:
        """The mapping of spectra, transmissibility and power_spectral_density; None for too short a record."""
        self._process()
        if self._meters is None:
            return None
        try:
            found = self._meters.welch.spectra()
        except InputError:  # no segment without a mask
            return None
        measured, predicted = _columns(found, 0), _columns(found, N_SEGMENTS)
        return {
            "spectra": spectra_document(measured, predicted, self._meters.welch.settings),
            "transmissibility": _with_sensor(transmissibility_document(measured, predicted, None)),
            "power_spectral_density": _with_sensor(power_document(measured, predicted)),
        }

    def waterfall(self) -> Waterfall | None:
        """Of the five measured segments, then of their residuals; None where there is no second of anything."""
        self._process()
        found = self._meters.waterfall.waterfall() if self._meters else None
        return found if found is not None and found.begins_ns.size else None

    def _process(self) -> None:
        if not self._count:
            return
        stamps_ns, values = (np.concatenate(parts) for parts in zip(*self._waiting, strict=True))
        self._waiting, self._count = [], 0
        if self._meters is None:
            if stamps_ns.size < 2:
                return
            steps = np.diff(stamps_ns[: RATE_SAMPLES + 1])
            self._longest_ns = BREAK_STEPS * float(np.percentile(steps, TYPICAL_PERCENT))
            typical = steps[(steps >= 0) & (steps <= self._longest_ns)]
            step_ns = float(typical.mean()) if typical.size else 0.0
            if not 0.0 < step_ns < 1e9 / _MIN_RATE_HZ:
                return
            self._meters = _Meters(1e9 / step_ns)
        steps = np.diff(stamps_ns, prepend=stamps_ns[0] if self._last_ns is None else self._last_ns)
        self._last_ns = int(stamps_ns[-1])
        breaks = np.flatnonzero((steps < 0) | (steps > self._longest_ns)).tolist()
        for begin, end in zip([0, *breaks], [*breaks, stamps_ns.size], strict=True):
            if begin in breaks:
                self._meters.part()
            if end > begin:
                self._meters.push(stamps_ns[begin:end], values[begin:end])


class _Meters:
    """Two meters of one rate: of averages over the whole record, and of bins of time."""

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.waterfall = WaterfallMeter(rate_hz, 2 * len(MEASURED_SEGMENTS))
        highest_hz = min(_MAX_HZ, USABLE * rate_hz)
        self.welch = SpectraMeter(rate_hz, 2 * N_SEGMENTS, SpectrumSettings(highest_hz=highest_hz))

    def part(self) -> None:
        self.waterfall.part()
        self.welch.part()

    def push(self, stamps_ns: Integers, values: Floats) -> None:
        """Seat, five measured and five residuals by column, (n, 11)."""
        seat, measured, residual = values[:, 0], values[:, 1:6], values[:, 6:]
        self.waterfall.push(stamps_ns, values[:, 1:])
        outputs = np.full((seat.size, 2 * N_SEGMENTS), np.nan)
        outputs[:, MEASURED_SEGMENT_INDEX] = np.where(np.isnan(residual), np.nan, measured)
        outputs[:, N_SEGMENTS + MEASURED_SEGMENT_INDEX] = measured + residual
        self.welch.push(seat, outputs)


def _with_sensor(document: Document) -> Document:
    """Without the central torso, which has no sensor."""
    return {name: of for name, of in document.items() if name in SENSORS}


def _columns(found: CrossSpectra, first: int) -> CrossSpectra:
    """The spectra of the six outputs from `first` on."""
    here = slice(first, first + N_SEGMENTS)
    return CrossSpectra(
        found.frequency_hz, found.input_psd[:, here], found.output_psd[:, here], found.cross[:, here],
        found.segments[here], found.averages[here], found.bandwidth_hz,
    )  # fmt: skip
