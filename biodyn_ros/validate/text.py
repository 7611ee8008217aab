"""A validation as text for the terminal."""

from __future__ import annotations

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.model import CASCADE_FORCES
from biodyn_core.recording.recording import WARM_UP_S
from biodyn_core.signals.response import Peak
from biodyn_core.validation.driving_point import DrivingPoint
from biodyn_core.validation.validation import HeadPeaks, Validation
from biodyn_ros.base.wording import bound, ends, number, words
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.validate.report import Report, driving_peaks, is_lower_bound


def text_of(report: Report) -> str:
    """The report as text for the terminal."""
    found = report.validation
    subject = found.subject
    lines = [
        f"{report.bag}  case {found.runs[0].recording.case}  subject {subject.name} ({subject.mass_matrix})",
        f"{found.seconds:.1f} s, the first {WARM_UP_S:g} s of each run are warm-up",
        _error_line(found),
        "",
        "segment         error/rms  error/range   aw m/s^2 measured predicted   VDV m/s^1.75 measured predicted"
        + ("" if found.exposures.no_interval else "  95 % interval"),
        *(_row(name, report) for name in MEASURED_SEGMENTS),
        *report.interval_notes,
        "",
        _head_line(found.head),
        _driving_line(found.driving_point, report.limits.least_coherence),
        "",
        f"verdict: {report.verdict}",
        *(f"  {finding.status}: {finding.text}" for finding in report.findings),
        *(f"warning: {line}" for line in report.warnings),
        *([MADE_BY_MODEL] if report.is_made_by_model else []),
    ]
    return "\n".join(lines)


def _error_line(found: Validation) -> str:
    """The mean error beside that of the worst segment."""
    segment, percent = found.worst
    if segment is None:
        return "error/rms: no segment was measured"
    return f"error/rms: mean {number(found.mean_nrmse_rms_percent)} %, worst {words(segment)} {number(percent)} %"


def _row(name: str, report: Report) -> str:
    found = report.validation
    error, measured, predicted = found.errors[name], found.exposures.measured[name], found.exposures.predicted[name]
    if error is None or not measured.seconds:
        return f"{words(name):<15} not measured"
    by_rms, by_range = (f"{number(each)} %" for each in (error.nrmse_rms_percent, error.nrmse_range_percent))
    # Missing samples make no mean a lower bound, suspect ones do: their time counts.
    lower, mean_lower = is_lower_bound(found.exposures, name), found.exposures.suspect_s[name] > 0.0
    aw, aw_model = (bound(dose.aw_mps2, mean_lower) for dose in (measured, predicted))
    vdv, vdv_model = bound(measured.vdv_mps175, lower), bound(predicted.vdv_mps175, lower)
    row = f"{words(name):<15} {by_rms:>9}  {by_range:>11}  {aw:>18} {aw_model:>9}  {vdv:>22} {vdv_model:>9}"
    interval = report.dose_intervals(name).vdv_interval_mps175
    return f"{row}  {ends(interval)}" if interval else row


def _head_line(head: HeadPeaks) -> str:
    if head.ratio is None or head.ratio.magnitude is None or head.measured is None or head.predicted is None:
        return "seat-to-head transmissibility: the measured coherence is too low"
    return (
        f"seat-to-head transmissibility: measured {_at(head.measured)} (coherence {head.ratio.coherence:.2f}),"
        f" predicted {_at(head.predicted)}, ratio {number(head.ratio.magnitude)}"
    )


def _driving_line(point: DrivingPoint | None, least_coherence: float) -> str:
    if point is None:
        return f"apparent mass: {CASCADE_FORCES}"
    peaks, how = driving_peaks(point, least_coherence), " as printed" if point.as_printed else ""
    how += ", without effects in joint 1" if point.lacks_effects else ""
    if peaks.apparent_mass is None or peaks.by_body_mass is None or peaks.by_upper_body_mass is None:
        return f"apparent mass, predicted{how}: the coherence is too low"
    return (
        f"apparent mass, predicted{how}: {_at(peaks.apparent_mass, ' kg')},"
        f" {number(peaks.by_body_mass.magnitude)} by body mass,"
        f" {number(peaks.by_upper_body_mass.magnitude)} by upper-body mass"
    )


def _at(peak: Peak, unit: str = "") -> str:
    return f"{number(peak.magnitude)}{unit} at {number(peak.frequency_hz)} Hz"
