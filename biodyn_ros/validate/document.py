"""The mapping of validate.json, and the runs behind it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from biodyn_core.base.segments import HEAD, SEAT, SEGMENTS
from biodyn_core.body.model import CASCADE_FORCES
from biodyn_core.exposure.injury import Hic
from biodyn_core.exposure.meters import Dose
from biodyn_core.recording.recording import WARM_UP_S
from biodyn_core.signals.response import Peak, peak
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.validation.driving_point import DrivingPoint
from biodyn_core.validation.validation import Exposures, HeadPeaks, PredictedRun, Validation
from biodyn_ros import __version__
from biodyn_ros.reading.provenance import MADE_BY_MODEL, Role, without_note
from biodyn_ros.reports.exposure_json import dose_figures, hic_windows
from biodyn_ros.reports.spectra_json import array, power_document, spectra_document, transmissibility_document
from biodyn_ros.validate.findings import findings, verdict
from biodyn_ros.validate.settings import ValidationSettings

Document = dict[str, Any]

PRINTED_BAND: Final = (0.80, 0.95)
"""The paper's printed band of the normalised apparent mass's peak (4.1), which it ascribes to ISO 5982; unverified."""


@dataclass(frozen=True, eq=False)
class Validated:
    """The document of validate.json, and the runs of the seat behind it."""

    document: Document
    runs: tuple[PredictedRun, ...]


def validation_document(
    found: Validation,
    bag: str,
    role: Role | None,
    spectra: SpectrumSettings,
    limits: ValidationSettings,
    cutoff_hz: float,
) -> Document:
    """All that was compared, with the findings and the verdict by these limits.

    role is what the bag was to the fit; cutoff_hz is of the low-pass that everything lies behind.
    """
    recordings = [run.recording for run in found.runs]
    made, rest = without_note(dict.fromkeys(line for recording in recordings for line in recording.warnings))
    worst_segment, worst_percent = found.worst
    document: Document = {
        "bag": bag or recordings[0].name,
        "case": recordings[0].case,
        "subject": found.subject.name,
        "mass_matrix": found.subject.mass_matrix,
        "role": role,
        "path": "zero_phase",
        "limits": asdict(limits),
        "rate_hz": found.rate_hz,
        "seconds": found.seconds,
        "warm_up_s": WARM_UP_S,
        "runs": len(found.runs),
        "error": {
            "segments": {name: asdict(error) if error else None for name, error in found.errors.items()},
            "mean_nrmse_rms_percent": found.mean_nrmse_rms_percent,
            "worst_segment": worst_segment,
            "worst_nrmse_rms_percent": worst_percent,
        },
        "spectra": spectra_document(found.measured, found.predicted, spectra),
        "transmissibility": transmissibility_document(found.measured, found.predicted, found.subject),
        "power_spectral_density": power_document(found.measured, found.predicted),
        "stht": _stht(found.head),
        "driving_point": _driving_point(found, limits.least_coherence),
        "exposure": _exposure(found.exposures, cutoff_hz),
        "warnings": rest,
        "version": __version__,
    }
    if made:
        document["bag_made_by_model"] = MADE_BY_MODEL
    document["findings"] = list(findings(document, limits))
    document["verdict"] = verdict(document["findings"])
    return document


# --- doses -----------------------------------------------------------------------------------------------------------


def _exposure(found: Exposures, cutoff_hz: float) -> Document:
    misread = SEAT in found.masked  # then all that it drives lacks something too
    seat = _dose(found.seat)
    document: Document = {
        "channel": "low_passed",
        SEAT: seat and seat | {"lower_bound": misread},
        "segments": {
            name: {
                "measured": _dose(found.measured[name]),
                "predicted": _dose(found.predicted[name]),
                "lower_bound": misread or name in found.masked,
            }
            for name in SEGMENTS
        },
        "dri": {
            "compression": found.dri.compression, "as_printed": found.dri.as_printed, "class": found.dri.band,
            "lower_bound": misread,
        },
    }  # fmt: skip
    for name, measured in found.measured_hic.items():
        document[name] = {
            "measured": _hic(measured),
            "predicted": _hic(found.predicted_hic[name]),
            "bandwidth_hz": min(measured.bandwidth_hz, cutoff_hz),
        }
        if misread or HEAD in found.masked:
            document[name]["lower_bound"] = True
    return document


def _dose(dose: Dose) -> Document | None:
    return dose_figures(dose) | {"counted_s": dose.seconds} if dose.seconds else None


def _hic(found: Hic) -> Document | None:
    """Both definitions that the vertical alone can answer; None where nothing was counted."""
    if found.as_printed <= 0.0:
        return None
    figures = {"as_printed": found.as_printed, "vertical": found.vertical}
    return figures | {"windows_s": hic_windows(found, figures)}


# --- over frequency --------------------------------------------------------------------------------------------------


def _stht(head: HeadPeaks) -> Document:
    """Seat-to-head transmissibility's peaks, and their ratio with its error."""
    document: Document = {
        "least_coherence": head.least_coherence,
        "telling_share": head.telling_share,
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
    """Apparent mass and impedance: no force is measured, so both are the model's, over this event and linear."""
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
    """One driving point; its peaks only where the coherence can tell."""
    mass, impedance = np.abs(point.apparent_mass_kg), np.abs(point.impedance_n_s_per_m)
    tells = point.is_coherent(least_coherence)
    peaks = {
        "peak": mass, "peak_by_body_mass": point.by_body_mass, "peak_by_upper_body_mass": point.by_upper_body_mass,
        "impedance_peak": impedance,
    }  # fmt: skip
    return {
        "apparent_mass_kg": array(mass),
        "phase_deg": array(point.phase_deg),
        "impedance_n_s_per_m": array(impedance),
        "impedance_phase_deg": array(np.degrees(np.angle(point.impedance_n_s_per_m))),
        **{name: _peak(peak(point.frequency_hz, values, tells)) for name, values in peaks.items()},
    }


def _peak(found: Peak | None) -> Document | None:
    return found._asdict() if found else None
