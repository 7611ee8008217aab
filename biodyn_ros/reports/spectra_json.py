"""Mappings of spectra, for `validate.json` and the page of a replay."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import Subject
from biodyn_core.signals.response import CrossSpectra
from biodyn_core.signals.spectrum_settings import SpectrumSettings

Document = dict[str, Any]

_CENTRAL: Final = SEGMENTS.index("central_torso")


def spectra_document(measured: CrossSpectra, predicted: CrossSpectra, settings: SpectrumSettings) -> Document:
    """The frequency grid of all arrays of the document, and the quality of the estimates."""
    by = dict.fromkeys(MEASURED_SEGMENTS, measured)
    return {
        "estimator": "H1, Welch",
        "window": settings.window,
        "segment_s": settings.segment_s,
        "overlap": settings.overlap,
        "step_hz": float(measured.frequency_hz[1] - measured.frequency_hz[0]),
        "bandwidth_hz": measured.bandwidth_hz,
        "frequency_hz": array(measured.frequency_hz),
        "segments": {name: int(by.get(name, predicted).segments[i]) for i, name in enumerate(SEGMENTS)},
        "averages": {name: float(by.get(name, predicted).averages[i]) for i, name in enumerate(SEGMENTS)},
        "chance_coherence": {
            name: float(by.get(name, predicted).chance_coherence[i]) for i, name in enumerate(SEGMENTS)
        },
    }


def transmissibility_document(measured: CrossSpectra, predicted: CrossSpectra, subject: Subject | None) -> Document:
    """Seat to segment, measured and predicted, and of the linear model if a subject is given."""
    exact = None if subject is None else Chain.of(subject).transmissibility(measured.frequency_hz)
    return {
        name: {
            "measured": _estimate(measured, i),
            "predicted": _estimate(predicted, i),
            "linear": None
            if exact is None
            else {"magnitude": array(np.abs(exact[:, i])), "phase_deg": array(np.degrees(np.angle(exact[:, i])))},
        }
        for i, name in enumerate(SEGMENTS)
    }


def _estimate(spectra: CrossSpectra, column: int) -> Document | None:
    if not spectra.segments[column]:
        return None
    return {
        "magnitude": array(np.abs(spectra.h1[:, column])),
        "phase_deg": array(spectra.phase_deg[:, column]),
        "coherence": array(spectra.coherence[:, column]),
        "relative_error": array(spectra.relative_error[:, column]),
    }


def power_document(measured: CrossSpectra, predicted: CrossSpectra) -> Document:
    """Power spectral densities, (m/s^2)^2/Hz, and amplitudes, m/s^2, of sines of the same power."""
    seat = _CENTRAL if predicted.segments[_CENTRAL] else int(np.argmax(predicted.segments))  # has no mask
    channels = {SEAT: {"measured": predicted.input_psd[:, seat]}}
    for i, name in enumerate(SEGMENTS):
        both = {"measured": measured, "predicted": predicted}
        channels[name] = {side: s.output_psd[:, i] for side, s in both.items() if s.segments[i]}
    return {
        name: {
            side: {
                "psd_mps2_squared_per_hz": array(psd),
                "amplitude_mps2": array(np.sqrt(2.0 * psd * measured.bandwidth_hz)),
            }
            for side, psd in sides.items()
        }
        for name, sides in channels.items()
    }


def array(values: Floats) -> list[float | None]:
    """The values with six digits, None for NaN."""
    return [float(f"{value:.6g}") if math.isfinite(value) else None for value in values.tolist()]
