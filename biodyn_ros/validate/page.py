"""The page of a validation: one HTML file that shows what agrees, what does not, and what cannot be told."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from biodyn_core.base.segments import HEAD, MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.signals.waterfall import Waterfall, WaterfallMeter
from biodyn_core.validation.validation import PredictedRun
from biodyn_ros.base.wording import words
from biodyn_ros.reports.doses import VDV_LABEL, Pair, doses, injury
from biodyn_ros.reports.frequency import driving_point, powers, residual_channels, transmissibility, waterfall
from biodyn_ros.reports.motion import EVENT_HALF_NS, StrongestEvent, overlay
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.validate.document import Validated

Document = dict[str, Any]

_TONE: Final = {"agrees": "good", "disagrees": "bad", "undecided": "warn"}
_HEADLINE: Final = {
    "agrees": "Agrees: nothing that was looked at lies outside its limits",
    "disagrees": "Disagrees with the measurement",
    "undecided": "Undecided: the recording cannot tell everything",
}


def validation_page(validated: Validated) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    check_reports()
    document = validated.document
    event = strongest_event(validated)
    origin_ns = int(validated.runs[0].recording.stamps_ns[0])
    found, shown = residual_waterfall(validated), document["error"]["worst_segment"]
    return render(
        "validate.html.j2",
        document=document,
        tone=tone(document),
        headline=_HEADLINE[document["verdict"]],
        disagreeing=[each["text"] for each in document["findings"] if each["status"] == "disagrees"],
        untold=[each["text"] for each in document["findings"] if each["status"] != "disagrees"],
        doubts=doubts(document),
        segments=MEASURED_SEGMENTS,
        event=event,
        event_s=1e-9 * (event.peak_ns - origin_ns) if event else None,
        overlay_svg=overlay(event, origin_ns, {"residual": _residuals(document)}) if event else None,
        transmissibility_svg=transmissibility(document, document["limits"]["least_coherence"]),
        powers_svg=powers(document),
        driving_svg=driving_point(document),
        doses_svg=doses(_doses(document), VDV_LABEL),
        injury_svg=injury(_dri(document["exposure"]["dri"]), _hic(document["exposure"])),
        shown=shown,
        width_ns=found.width_ns if found else None,
        waterfall_svg=waterfall(found, residual_channels(shown), origin_ns) if found and shown else None,
    )


def tone(document: Document) -> str:
    """Of the verdict; green never for a recording that the model made itself."""
    found = _TONE[document["verdict"]]
    return "none" if found == "good" and "bag_made_by_model" in document else found


def doubts(document: Document) -> list[str]:
    """What the page must not be taken for."""
    said = [
        "A small error over time passes nothing by itself: transmissibility and doses have to agree too.",
        "No force was measured: apparent mass and impedance are the model's alone.",
        "One event says nothing of other roads, other seats and other postures.",
    ]
    unmeasured = [words(name) for name, error in document["error"]["segments"].items() if error is None]
    if unmeasured:
        said.append(f"Nothing is known of {', '.join(unmeasured)}: not measured here.")
    return said


def strongest_event(validated: Validated) -> StrongestEvent | None:
    """What surrounds the largest measured acceleration of seat or head behind the warm-up; None where nothing is."""
    best: tuple[float, str, PredictedRun, int] | None = None
    head = SEGMENTS.index(HEAD)
    for run in validated.runs:
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


def residual_waterfall(validated: Validated) -> Waterfall | None:
    """Of all measured segments, then of all their residuals, behind the warm-up; None where there is no second."""
    meter = WaterfallMeter(validated.document["rate_hz"], 2 * len(MEASURED_SEGMENTS))
    for run in validated.runs:
        measured = run.recording.measured_mps2[run.begin :]
        residual = run.predicted_mps2[run.begin :, MEASURED_SEGMENT_INDEX] - measured
        meter.push(run.recording.stamps_ns[run.begin :], np.hstack([measured, residual]))
        meter.part()
    found = meter.waterfall()
    return found if found.begins_ns.size else None


def _residuals(document: Document) -> Document:
    return {name: error for name, error in document["error"]["segments"].items() if error}


def _doses(document: Document) -> list[Pair]:
    exposure = document["exposure"]
    rows = []
    for name in reversed(SEGMENTS):
        of = exposure["segments"][name]
        values = [of[side]["vdv_mps175"] if of[side] else None for side in ("measured", "predicted")]
        rows.append(Pair(words(name), *values, of["lower_bound"], of["lower_bound"], _missing(of)))
    seat = exposure[SEAT]
    return [*rows, Pair(words(SEAT), seat["vdv_mps175"] if seat else None, None, bool(seat and seat["lower_bound"]))]


def _missing(of: Document) -> str:
    return ", not measured" if of["measured"] is None else ""


def _dri(dri: Document) -> list[Pair]:
    lower = dri["lower_bound"]
    return [
        Pair("compression", dri["compression"], None, lower), Pair("as printed, |z|", dri["as_printed"], None, lower)
    ]  # fmt: skip


def _hic(exposure: Document) -> list[Pair]:
    rows = []
    for name in ("hic15", "hic36"):
        of = exposure[name]
        lower = of.get("lower_bound", False)
        for key, title in (("as_printed", "|vertical + 1 g|"), ("vertical", "|vertical|")):
            values = [of[side][key] if of[side] else None for side in ("measured", "predicted")]
            rows.append(Pair(f"{name.upper()} {title}", *values, lower, lower))
    return rows
