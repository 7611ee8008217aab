"""The mapping of validate.json."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

import numpy as np

from biodyn_core.base.segments import HEAD, SEAT, SEGMENTS
from biodyn_core.body.model import CASCADE_FORCES
from biodyn_core.exposure.injury import Hic
from biodyn_core.exposure.meters import Dose
from biodyn_core.recording.recording import WARM_UP_S
from biodyn_core.signals.response import Peak
from biodyn_core.validation.driving_point import DrivingPoint
from biodyn_core.validation.validation import HeadPeaks, Validation
from biodyn_ros import __version__
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.reports.exposure_json import dose_figures, hic_windows
from biodyn_ros.reports.spectra_json import array, power_document, spectra_document, transmissibility_document
from biodyn_ros.validate.report import Report, driving_peaks, is_lower_bound

Document = dict[str, Any]

PRINTED_BAND: Final = (0.80, 0.95)
"""Band of the normalised apparent mass's peak, as printed in the paper (4.1), which cites ISO 5982; not verified."""


def validation_document(report: Report) -> Document:
    """The whole mapping of validate.json."""
    found, recording = report.validation, report.validation.runs[0].recording
    worst_segment, worst_percent = found.worst
    made = {"bag_made_by_model": MADE_BY_MODEL} if report.is_made_by_model else {}
    return {
        "bag": report.bag,
        "case": recording.case,
        "subject": found.subject.name,
        "mass_matrix": found.subject.mass_matrix,
        "role": report.role,
        "path": "zero_phase",
        "limits": asdict(report.limits),
        "rate_hz": found.rate_hz,
        "seconds": found.seconds,
        "warm_up_s": WARM_UP_S,
        "runs": len(found.runs),
        "error": {
            "segments": error_document(found),
            "mean_nrmse_rms_percent": found.mean_nrmse_rms_percent,
            "worst_segment": worst_segment,
            "worst_nrmse_rms_percent": worst_percent,
        },
        "spectra": spectra_document(found.measured, found.predicted, report.spectra),
        "transmissibility": transmissibility_document(found.measured, found.predicted, found.subject),
        "power_spectral_density": power_document(found.measured, found.predicted),
        "stht": _stht(found.head),
        "driving_point": _driving_point(found, report.limits.least_coherence),
        "exposure": _exposure(report),
        "warnings": report.warnings,
        "version": __version__,
        **made,
        "findings": [finding._asdict() for finding in report.findings],
        "verdict": report.verdict,
    }


def error_document(found: Validation) -> Document:
    """Errors over time by measured segment, None without a measurement."""
    return {name: asdict(error) if error else None for name, error in found.errors.items()}


# --- doses -----------------------------------------------------------------------------------------------------------


def _exposure(report: Report) -> Document:
    found = report.validation.exposures
    seat, dri, seat_bound = _dose(found.seat), found.dri, is_lower_bound(found, SEAT)
    document: Document = {
        "channel": "low_passed",
        SEAT: seat and seat | {"suspect_s": found.suspect_s[SEAT], "lower_bound": seat_bound},
        "segments": {
            name: {
                "measured": _dose(found.measured[name]),
                "predicted": _predicted(report, name),
                "suspect_s": found.suspect_s[name],
                "lower_bound": is_lower_bound(found, name),
            }
            for name in SEGMENTS
        },
        "no_interval": found.no_interval or None,
        "dri": {
            "compression": dri.compression, "as_printed": dri.as_printed, "class": dri.band,
            "class_lower_bound": seat_bound and not dri.is_in_highest_band, "lower_bound": seat_bound,
        },
    }  # fmt: skip
    for name, measured in found.measured_hic.items():
        document[name] = {
            "measured": _hic(measured),
            "predicted": _hic(found.predicted_hic[name]),
            "bandwidth_hz": report.hic_bandwidth_hz(name),
        }
        if is_lower_bound(found, HEAD):
            document[name]["lower_bound"] = True
    return document


def _dose(dose: Dose) -> Document | None:
    return dose_figures(dose) | {"counted_s": dose.seconds} if dose.seconds else None


def _predicted(report: Report, name: str) -> Document | None:
    dose = _dose(report.validation.exposures.predicted[name])
    return dose and dose | report.dose_intervals(name)._asdict()


def _hic(found: Hic) -> Document | None:
    """Both definitions for a vertical alone; None if nothing was counted."""
    if found.as_printed <= 0.0:
        return None
    figures = {"as_printed": found.as_printed, "vertical": found.vertical}
    return figures | {"windows_s": hic_windows(found, figures)}


# --- over frequency --------------------------------------------------------------------------------------------------


def _stht(head: HeadPeaks) -> Document:
    """Peaks of seat-to-head transmissibility, and their ratio with its error."""
    document: Document = {
        "least_coherence": head.least_coherence,
        "telling_share": head.coherent_share,
        "measured": _peak(head.measured),
        "predicted": _peak(head.predicted),
        "predicted_anywhere": _peak(head.predicted_anywhere),
        "linear_anywhere": _peak(head.linear_anywhere),
        "peak_ratio": head.ratio.magnitude if head.ratio else None,
        "peak_ratio_relative_error": head.ratio.relative_error if head.ratio else None,
        "frequency_ratio": head.ratio.frequency if head.ratio else None,
    }
    if head.ratio:
        document["measured"]["coherence"] = head.ratio.coherence
    return document


def _driving_point(found: Validation, least_coherence: float) -> Document:
    """Apparent mass and impedance of the model, over this event and linear: no force is measured."""
    over_event, linear = found.driving_point, found.linear_driving_point
    if over_event is None or linear is None:
        return {"refused": CASCADE_FORCES}
    return {
        "seat_force": over_event.form,
        "as_printed": over_event.as_printed,
        "body_mass_kg": over_event.body_mass_kg,
        "upper_body_mass_kg": over_event.upper_body_mass_kg,
        "printed_band": list(PRINTED_BAND),
        "predicted": _point(over_event, least_coherence)
        | {"coherence": array(over_event.coherence), "chance_coherence": over_event.chance_coherence},
        "linear": _point(linear, least_coherence),
    }


def _point(point: DrivingPoint, least_coherence: float) -> Document:
    """One driving point and its peaks."""
    peaks = driving_peaks(point, least_coherence)
    return {
        "apparent_mass_kg": array(np.abs(point.apparent_mass_kg)),
        "phase_deg": array(point.phase_deg),
        "impedance_n_s_per_m": array(np.abs(point.impedance_n_s_per_m)),
        "impedance_phase_deg": array(np.degrees(np.angle(point.impedance_n_s_per_m))),
        "peak": _peak(peaks.apparent_mass),
        "peak_by_body_mass": _peak(peaks.by_body_mass),
        "peak_by_upper_body_mass": _peak(peaks.by_upper_body_mass),
        "impedance_peak": _peak(peaks.impedance),
    }


def _peak(found: Peak | None) -> Document | None:
    return found._asdict() if found else None
