"""Validate: the model's forward prediction of an event it was not fitted to, beside what was measured there.

Everything is compared behind the warm-up, low-passed on both sides, and where the measurement is masked the prediction
is left out too. A small error in time passes nothing by itself: the paper's own is below 10 % while its model carries
2.6 times too much to the head.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.arrays import Floats
from biodyn_core.effects import needs_channels, shown
from biodyn_core.errors import InputError
from biodyn_core.exposure import Dose, DoseMeter
from biodyn_core.injury import HIC_LENGTHS_S, DriMeter, HicMeter
from biodyn_core.model import Chain, Response, SeatForce, predict
from biodyn_core.recording import WARM_UP_S, WORTH_A_LINE_S, Recording
from biodyn_core.response import (
    CrossSpectra,
    DrivingPoint,
    Peak,
    SpectrumSettings,
    common_rate_hz,
    cross_spectra,
    driving_point,
    linear_driving_point,
    peak,
)
from biodyn_core.segments import HEAD, MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.subject import Subject
from biodyn_ros import __version__
from biodyn_ros.files import check_directory, make_directory
from biodyn_ros.json_files import write_json
from biodyn_ros.provenance import MADE_BY_MODEL, Role, bag_sha256, role_of, without_note
from biodyn_ros.reading.recordings import RecordingOptions, read_recordings
from biodyn_ros.spectra_json import array, power_document, spectra_document, transmissibility_document
from biodyn_ros.validate.findings import ValidationSettings, findings, verdict

Document = dict[str, Any]

PRINTED_BAND: Final = (0.80, 0.95)
"""The paper's printed band of the normalised apparent mass's peak (4.1), which it ascribes to ISO 5982; unverified."""

_HEAD: Final = SEGMENTS.index(HEAD)
_WINDOW_S: Final = 1.0
"""Of rolling figures, which nobody asks for here."""


@dataclass(frozen=True)
class ValidateOptions:
    """How the event is read, which case it is, how spectra are estimated, and what counts as disagreement."""

    case: str | None = None
    reading: RecordingOptions = field(default_factory=RecordingOptions)
    spectra: SpectrumSettings = field(default_factory=SpectrumSettings)
    limits: ValidationSettings = field(default_factory=ValidationSettings)
    seat_force: SeatForce = "inertia"
    as_printed: bool = False


@dataclass(frozen=True, eq=False)
class Validated:
    """The document of validate.json, and the recordings and predictions behind it, one for each run of the seat.

    predicted: by segment, (n, 6), NaN wherever the measurement is masked; the central torso is masked nowhere.
    """

    document: Document
    recordings: list[Recording]
    responses: list[Response]
    predicted: list[Floats]


@dataclass(frozen=True, eq=False)
class _Event:
    """One recording and its prediction; `predicted` (n, 6) is NaN wherever `measured` (n, 6), by segment, is masked.

    The central torso, which no sensor sees, is masked in `measured` alone.
    """

    recording: Recording
    response: Response
    measured: Floats
    predicted: Floats

    @classmethod
    def of(cls, recording: Recording, subject: Subject) -> _Event:
        channels = recording.named_channels()
        response = predict(subject, recording.seat_mps2, recording.rate_hz, channels)
        if not np.isfinite(response.accel_mps2).all():
            raise InputError(f"{recording.name}: the model of {subject.name} leaves the finite numbers: fit it anew")
        measured = np.full(response.accel_mps2.shape, np.nan)
        measured[:, MEASURED_SEGMENT_INDEX] = recording.measured_mps2
        predicted = shown(subject.effects, response.accel_mps2, recording.rate_hz, channels).copy()
        masked = np.isnan(recording.measured_mps2)
        predicted[:, MEASURED_SEGMENT_INDEX] = np.where(masked, np.nan, predicted[:, MEASURED_SEGMENT_INDEX])
        return cls(recording, response, measured, predicted)

    @property
    def begin(self) -> int:
        """The first sample behind the warm-up."""
        return round(WARM_UP_S * self.recording.rate_hz)

    @property
    def seat(self) -> Floats:
        return self.recording.seat_mps2


def validate(
    bag: str | Path,
    subject: Subject,
    options: ValidateOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Validated:
    """Predict a bag's event from its seat alone and compare; raises InputError as `read_recordings`."""
    options = options or ValidateOptions()
    reading = replace(options.reading, channels=needs_channels(subject.effects))
    recordings = read_recordings(bag, options.case, reading, progress)
    return validate_recordings(recordings, subject, options, str(bag), role_of(subject, bag_sha256(bag)))


def validate_to_directory(
    bag: str | Path,
    subject: Subject,
    directory: Path,
    options: ValidateOptions | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    report: bool = True,
) -> Validated:
    """Validate and write `validate.json` and `validate.html`; a bag that is refused leaves no directory."""
    check_directory(directory)
    if report:
        from biodyn_ros.reports.pages import check_reports, write_drawn  # an extra of its own
        from biodyn_ros.validate.page import validation_page

        check_reports()
    validated = validate(bag, subject, options, progress)
    make_directory(directory)
    write_json(directory / "validate.json", validated.document)
    if report:
        write_drawn(directory / "validate.html", lambda: validation_page(validated))
    return validated


def validate_recordings(
    recordings: Sequence[Recording],
    subject: Subject,
    options: ValidateOptions | None = None,
    bag: str = "",
    role: Role | None = None,
) -> Validated:
    """The same for recordings at hand, the runs of one event; role is what the bag was to the subject's fit."""
    options = options or ValidateOptions()
    events = [_Event.of(recording, subject) for recording in recordings]
    rate_hz = common_rate_hz([recording.rate_hz for recording in recordings])
    measured = cross_spectra([(e.seat[e.begin :], e.measured[e.begin :]) for e in events], rate_hz, options.spectra)
    predicted = cross_spectra([(e.seat[e.begin :], e.predicted[e.begin :]) for e in events], rate_hz, options.spectra)
    responses = [event.response for event in events]
    made, rest = without_note(dict.fromkeys(line for recording in recordings for line in recording.warnings))
    document: Document = {
        "bag": bag or recordings[0].name,
        "case": recordings[0].case,
        "subject": subject.name,
        "mass_matrix": subject.mass_matrix,
        "role": role,
        "path": "zero_phase",
        "limits": asdict(options.limits),
        "rate_hz": rate_hz,
        "seconds": sum(event.seat.size for event in events) / rate_hz,
        "warm_up_s": WARM_UP_S,
        "runs": len(events),
        "error": _errors(events, rate_hz),
        "spectra": spectra_document(measured, predicted, options.spectra),
        "transmissibility": transmissibility_document(measured, predicted, subject),
        "power_spectral_density": power_document(measured, predicted),
        "stht": _stht(measured, predicted, subject, options.limits),
        "driving_point": _driving_point(subject, responses, measured.frequency_hz, options),
        "exposure": _exposure(events, rate_hz),
        "warnings": rest,
        "version": __version__,
    }
    if made:
        document["bag_made_by_model"] = MADE_BY_MODEL
    document["findings"] = list(findings(document, options.limits))
    document["verdict"] = verdict(document["findings"])
    return Validated(document, list(recordings), responses, [event.predicted for event in events])


# --- over time -------------------------------------------------------------------------------------------------------


def _errors(events: Sequence[_Event], rate_hz: float) -> Document:
    """Per measured segment: error over measured rms and over measured range; None for one that was not measured."""
    measured = np.concatenate([event.measured[event.begin :] for event in events])
    predicted = np.concatenate([event.predicted[event.begin :] for event in events])
    segments = {name: _error(predicted[:, i], measured[:, i], rate_hz) for name, i in _measured_columns()}
    known = [error["nrmse_rms_percent"] for error in segments.values() if error]
    known = [percent for percent in known if percent is not None]  # a segment that did not move has no share
    return {"segments": segments, "mean_nrmse_rms_percent": sum(known) / len(known) if known else None}


def _error(predicted: Floats, measured: Floats, rate_hz: float) -> Document | None:
    here = np.isfinite(measured)
    if not here.any():
        return None
    error, truth = predicted[here] - measured[here], measured[here]
    rms, own = math.sqrt(float(np.mean(error**2))), math.sqrt(float(np.mean(truth**2)))
    return {
        "nrmse_rms_percent": _ratio(100.0 * rms, own),
        "nrmse_range_percent": _ratio(100.0 * rms, float(np.ptp(truth))),
        "rms_mps2": rms,
        "measured_rms_mps2": own,
        "compared_s": np.count_nonzero(here) / rate_hz,
    }


def _exposure(events: Sequence[_Event], rate_hz: float) -> Document:
    """Doses, DRI and HIC of the low-passed channels behind the warm-up, measured and predicted alike."""
    doses = DoseMeter("Wk", rate_hz, 1 + 2 * len(SEGMENTS), _WINDOW_S)
    dri = DriMeter(rate_hz, _WINDOW_S)
    hics = {name: [HicMeter(rate_hz, length, _WINDOW_S) for _ in range(2)] for name, length in HIC_LENGTHS_S.items()}
    _count(events, doses, lambda e: np.column_stack([e.seat, e.measured, e.predicted]))
    _count(events, dri, lambda e: e.seat[:, None])
    for measured, predicted in hics.values():
        _count(events, measured, lambda e: _upward(e.measured[:, _HEAD]))
        _count(events, predicted, lambda e: _upward(e.predicted[:, _HEAD]))
    seat, *others = doses.since_reset()
    result = dri.since_reset()
    missing = np.concatenate([np.isnan(event.measured[event.begin :]) for event in events]).sum(axis=0) / rate_hz
    masked = {name: bool(missing[i] > WORTH_A_LINE_S) for name, i in _measured_columns()}
    document: Document = {
        "channel": "low_passed",
        SEAT: _dose(seat),
        "segments": {
            name: {
                "measured": _dose(others[i]),
                "predicted": _dose(others[len(SEGMENTS) + i]),
                "lower_bound": masked.get(name, False),
            }
            for i, name in enumerate(SEGMENTS)
        },
        "dri": {"compression": result.compression, "as_printed": result.as_printed, "class": result.band},
    }
    for name, pair in hics.items():
        document[name] = dict(zip(("measured", "predicted"), (_hic(meter) for meter in pair), strict=True))
        document[name]["bandwidth_hz"] = rate_hz / 2.0
        if masked[HEAD]:
            document[name]["lower_bound"] = True
    return document


def _count(events: Sequence[_Event], meter: Any, rows: Callable[[_Event], Floats]) -> None:
    """Let a meter count what lies behind the warm-up; the first run's warm-up settles its filters."""
    for number_of, event in enumerate(events):
        values = np.ascontiguousarray(rows(event))
        if number_of == 0:
            meter.push(values[: event.begin])
            meter.reset()
        else:
            before, now = events[number_of - 1].recording.stamps_ns[-1], event.recording.stamps_ns[0]
            meter.skip(max(0.0, 1e-9 * float(now - before)))
        meter.push(values[event.begin :])


def _upward(vertical: Floats) -> Floats:
    return np.column_stack([np.zeros((vertical.size, 2)), vertical])


def _dose(dose: Dose) -> Document | None:
    if dose.seconds == 0.0:
        return None
    return {
        "aw_mps2": dose.aw_mps2,
        "mtvv_mps2": dose.mtvv_mps2,
        "crest_factor": dose.crest_factor,
        "vdv_mps175": dose.vdv_mps175,
        "peak_mps2": dose.peak_mps2,
        "counted_s": dose.seconds,
    }


def _hic(meter: HicMeter) -> Document | None:
    """Both definitions that the vertical alone can answer; None where nothing was counted."""
    found = meter.since_reset()
    return {"as_printed": found.as_printed, "vertical": found.vertical} if found.as_printed > 0.0 else None


# --- over frequency --------------------------------------------------------------------------------------------------


def _stht(measured: CrossSpectra, predicted: CrossSpectra, subject: Subject, limits: ValidationSettings) -> Document:
    """Seat-to-head transmissibility's peaks, where the measured coherence can tell, and their ratio with its error."""
    frequency, least = measured.frequency_hz, limits.least_coherence
    linear = peak(frequency, np.abs(Chain.of(subject).transmissibility(frequency)[:, _HEAD]))
    tells, model_tells = (s.tells(least)[:, _HEAD] for s in (measured, predicted))
    anywhere = peak(frequency, np.abs(predicted.h1[:, _HEAD]), model_tells)
    own, model = (peak(frequency, np.abs(s.h1[:, _HEAD]), tells) for s in (measured, predicted))
    document: Document = {
        "least_coherence": max(least, float(measured.chance_coherence[_HEAD])),
        "telling_share": float(np.mean(tells)),
        "measured": _peak(own),
        "predicted": _peak(model),
        "predicted_anywhere": _peak(anywhere),
        "linear_anywhere": _peak(linear),
        "peak_ratio": None,
        "peak_ratio_relative_error": None,
        "frequency_ratio": None,
    }
    if own and model:
        at = int(np.searchsorted(frequency, own.frequency_hz))
        document["measured"]["coherence"] = float(measured.coherence[at, _HEAD])
        document["peak_ratio"] = _ratio(model.magnitude, own.magnitude)
        document["peak_ratio_relative_error"] = float(measured.relative_error[at, _HEAD])
        document["frequency_ratio"] = model.frequency_hz / own.frequency_hz
    return document


def _driving_point(
    subject: Subject, responses: Sequence[Response], frequency_hz: Floats, options: ValidateOptions
) -> Document:
    """Apparent mass and impedance: no force is measured, so both are the model's, over this event and linear."""
    if subject.mass_matrix == "cascade" and not options.as_printed:
        return {
            "refused": "forces under mass_matrix cascade are those of a body three times as heavy: ask for as_printed"
        }
    found = driving_point(subject, responses, options.seat_force, options.as_printed, options.spectra)
    exact = linear_driving_point(subject, frequency_hz, options.seat_force, options.as_printed)
    return {
        "seat_force": options.seat_force,
        "as_printed": options.as_printed,
        "body_mass_kg": found.body_mass_kg,
        "upper_body_mass_kg": found.upper_body_mass_kg,
        "printed_band": list(PRINTED_BAND),
        "predicted": _point(found, options.limits)
        | {"coherence": array(found.coherence), "chance_coherence": found.chance_coherence},
        "linear": _point(exact, options.limits),
    }


def _point(point: DrivingPoint, limits: ValidationSettings) -> Document:
    """One driving point; its peaks only where the coherence can tell."""
    mass, impedance = np.abs(point.apparent_mass_kg), np.abs(point.impedance_n_s_per_m)
    tells = point.tells(limits.least_coherence)
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


# --- numbers --------------------------------------------------------------------------------------------------------


def _measured_columns() -> list[tuple[str, int]]:
    return list(zip(MEASURED_SEGMENTS, MEASURED_SEGMENT_INDEX.tolist(), strict=True))


def _peak(found: Peak | None) -> Document | None:
    return {"frequency_hz": found.frequency_hz, "magnitude": found.magnitude} if found else None


def _ratio(above: float, below: float) -> float | None:
    return above / below if below > 0.0 else None
