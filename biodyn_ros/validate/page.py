"""The page of a validation: one HTML file with agreement, disagreement and undecided criteria."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from biodyn_core.base.segments import HEAD, MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import CASCADE_FORCES
from biodyn_core.exposure.meters import Dose
from biodyn_core.recording.recording import WARM_UP_S
from biodyn_core.signals.response import Peak
from biodyn_core.signals.waterfall import Waterfall, WaterfallMeter
from biodyn_core.validation.exposures import Exposures
from biodyn_core.validation.predicted_run import PredictedRun
from biodyn_core.validation.validation import Validation
from biodyn_ros import __version__
from biodyn_ros.base.wording import words
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.reports.doses import VDV_LABEL, Pair, doses, injury
from biodyn_ros.reports.frequency import driving_point, powers, residual_channels, transmissibility, waterfall
from biodyn_ros.reports.motion import EVENT_HALF_NS, StrongestEvent, overlay
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.validate.document import validation_document
from biodyn_ros.validate.report import Report, driving_peaks, is_lower_bound

_TONE: Final = {"agrees": "good", "disagrees": "bad", "undecided": "warn"}
_HEADLINE: Final = {
    "agrees": "Agrees: all criteria are within their limits",
    "disagrees": "Disagrees with the measurement",
    "undecided": "Undecided: the recording is not sufficient for all criteria",
}
_PEAKS: Final = (
    "apparent mass, kg", "apparent mass over body mass", "apparent mass over upper-body mass", "impedance, N s/m"
)  # fmt: skip


def validation_page(report: Report) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    found, document = report.validation, validation_document(report)  # the drawings over frequency take the document
    event = strongest_event(found)
    origin_ns = int(found.runs[0].recording.stamps_ns[0])
    residual = residual_waterfall(found)
    worst_segment, worst_percent = found.worst
    return render(
        "validate.html.j2",
        report=report,
        found=found,
        case=found.runs[0].recording.case,
        warm_up_s=WARM_UP_S,
        version=__version__,
        note=MADE_BY_MODEL if report.is_made_by_model else None,
        tone=tone(report.verdict, report.is_made_by_model),
        headline=_HEADLINE[report.verdict],
        disagreeing=[each.text for each in report.findings if each.status == "disagrees"],
        undecided=[each.text for each in report.findings if each.status != "disagrees"],
        limitations=limitations(found),
        segments=MEASURED_SEGMENTS,
        worst_segment=worst_segment,
        worst_percent=worst_percent,
        event=event,
        event_s=1e-9 * (event.peak_ns - origin_ns) if event else None,
        overlay_svg=overlay(event, origin_ns, found.errors) if event else None,
        transmissibility_svg=transmissibility(document, report.limits.least_coherence),
        powers_svg=powers(document),
        driving_svg=driving_point(document),
        refused=CASCADE_FORCES,
        peaks=list(_peaks(report)),
        doses_svg=doses(_doses(report), VDV_LABEL),
        injury_svg=injury(_dri(found.exposures), _hic(found.exposures)),
        width_ns=residual.width_ns if residual else None,
        waterfall_svg=waterfall(residual, residual_channels(worst_segment), origin_ns)
        if residual and worst_segment
        else None,
    )


def tone(verdict: str, is_made_by_model: bool) -> str:
    """The tone of the verdict; never green for a recording made by the model."""
    found = _TONE[verdict]
    return "none" if found == "good" and is_made_by_model else found


def limitations(found: Validation) -> list[str]:
    """Limits of the results on the page."""
    lines = [
        "A small error over time alone is no validation: transmissibility and doses must agree too.",
        "No force was measured: apparent mass and impedance are of the model alone.",
        "One event says nothing about other roads, seats and postures.",
    ]
    unmeasured = [words(name) for name, error in found.errors.items() if error is None]
    if unmeasured:
        lines.append(f"Not measured, so not validated: {', '.join(unmeasured)}.")
    return lines


def strongest_event(found: Validation) -> StrongestEvent | None:
    """The largest measured acceleration of seat or head after the warm-up, with its surroundings; None without any."""
    best: tuple[float, str, PredictedRun, int] | None = None
    head = SEGMENTS.index(HEAD)
    for run in found.runs:
        for name, values in ((SEAT, run.seat_mps2), (HEAD, run.measured_mps2[:, head])):
            felt = np.nan_to_num(np.abs(values[run.begin :]), nan=-1.0)
            if felt.size and felt.max() > (best[0] if best else -1.0):
                best = float(felt.max()), name, run, run.begin + int(felt.argmax())
    if best is None:
        return None
    peak, name, run, at = best
    stamps = run.recording.stamps_ns
    near = np.abs(stamps - stamps[at]) <= EVENT_HALF_NS
    measured = np.column_stack([run.seat_mps2, run.recording.measured_mps2])[near]
    return StrongestEvent(name, int(stamps[at]), peak, stamps[near], run.predicted_mps2[near], stamps[near], measured)


def residual_waterfall(found: Validation) -> Waterfall | None:
    """Waterfall of all measured segments, then of their residuals, after the warm-up; None without a whole second."""
    meter = WaterfallMeter(found.rate_hz, 2 * len(MEASURED_SEGMENTS))
    for run in found.runs:
        measured = run.recording.measured_mps2[run.begin :]
        residual = run.predicted_mps2[run.begin :, MEASURED_SEGMENT_INDEX] - measured
        meter.push(run.recording.stamps_ns[run.begin :], np.hstack([measured, residual]))
        meter.part()
    residuals = meter.waterfall()
    return residuals if residuals.begins_ns.size else None


def _peaks(report: Report) -> Iterator[tuple[str, Peak | None, Peak | None]]:
    """Rows of the table of peaks: title, predicted, linear."""
    found, least_coherence = report.validation, report.limits.least_coherence
    if found.driving_point and found.linear_driving_point:
        points = (found.driving_point, found.linear_driving_point)
        yield from zip(_PEAKS, *(driving_peaks(point, least_coherence) for point in points), strict=True)


def _doses(report: Report) -> list[Pair]:
    found, rows = report.validation.exposures, []
    for name in reversed(SEGMENTS):
        values = [_vdv(dose) for dose in (found.measured[name], found.predicted[name])]
        lower, note = is_lower_bound(found, name), ", not measured" if values[0] is None else ""
        interval = report.dose_intervals(name).vdv_interval_mps175
        rows.append(Pair(words(name), *values, lower, lower, note, interval))
    vdv = _vdv(found.seat)
    return [*rows, Pair(words(SEAT), vdv, None, vdv is not None and is_lower_bound(found, SEAT))]


def _vdv(dose: Dose) -> float | None:
    return dose.vdv_mps175 if dose.seconds else None


def _dri(found: Exposures) -> list[Pair]:
    lower = is_lower_bound(found, SEAT)
    values = {"compression": found.dri.compression, "as printed, |z|": found.dri.as_printed}
    return [Pair(title, value, None, lower) for title, value in values.items()]


def _hic(found: Exposures) -> list[Pair]:
    rows, lower = [], is_lower_bound(found, HEAD)
    for name, measured in found.measured_hic.items():
        counted = [hic if hic.as_printed > 0.0 else None for hic in (measured, found.predicted_hic[name])]
        for key, title in (("as_printed", "|vertical + 1 g|"), ("vertical", "|vertical|")):
            values = [getattr(hic, key) if hic else None for hic in counted]
            rows.append(Pair(f"{name.upper()} {title}", *values, lower, lower))
    return rows
