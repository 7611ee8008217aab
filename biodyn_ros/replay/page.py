"""The report of a replay: one HTML file with exposure, predictions, measurements and residual."""

from __future__ import annotations

from typing import Any

from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.exposure.limit_assessment import HORIZONTAL_FACTOR
from biodyn_ros.base.wording import ZONE, words
from biodyn_ros.replay.traces import Traces
from biodyn_ros.reports.doses import VDV_LABEL, Pair, doses
from biodyn_ros.reports.frequency import powers, residual_channels, transmissibility, waterfall
from biodyn_ros.reports.meter import meter_readings
from biodyn_ros.reports.motion import envelopes, overlay
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.reports.verdict import seat_verdict
from biodyn_ros.validate.settings import LEAST_COHERENCE


def replay_page(document: dict[str, Any], traces: Traces) -> str:
    """The report of a replay from the mapping of `exposure.json` and the traces of its frames.

    Raises InputError where jinja2 or matplotlib is missing.
    """
    check_reports()
    event, predicted, measured, origin_ns = traces.event(), traces.predicted(), traces.measured(), traces.first_ns
    return render(
        "replay.html.j2",
        document=document,
        verdict=seat_verdict(document),
        meter=meter_readings(document),
        zones=ZONE,
        flagged=_flagged(document["seat"]),
        segments=[name for name in SEGMENTS if name in document["predicted"]],
        sensors=[name for name in SENSORS if name in document["sensors"]],
        worst=_worst_residual(document),
        seat_axes=_seat_axes(document["seat"]),
        event=event,
        event_s=1e-9 * (event.peak_ns - origin_ns) if event else None,
        bin_s=1e-9 * max(predicted.width_ns, measured.width_ns),
        overlay_svg=overlay(event, origin_ns, document) if event else None,
        envelope_svg=envelopes(predicted, measured, event, origin_ns) if measured.begins_ns.size else None,
        **frequency_parts(document, traces, origin_ns),
    )


def frequency_parts(document: dict[str, Any], traces: Traces, origin_ns: int) -> dict[str, Any]:
    """The drawings over frequency, and of doses; None for a drawing without data."""
    spectra, found, worst = traces.spectra.spectra(), traces.spectra.waterfall(), _worst_residual(document)
    return {
        "bandwidth_hz": spectra["spectra"]["bandwidth_hz"] if spectra else None,
        "transmissibility_svg": transmissibility(spectra, LEAST_COHERENCE) if spectra else None,
        "powers_svg": powers(spectra) if spectra else None,
        "width_ns": found.width_ns if found else None,
        "waterfall_svg": waterfall(found, residual_channels(worst[0]), origin_ns) if found and worst else None,
        "doses_svg": doses(_doses(document), VDV_LABEL) if document["predicted"] else None,
    }


def _flagged(seat: dict[str, Any] | None) -> bool:
    """Whether a ratio of ISO 2631-1 requires additional evaluation."""
    return seat is not None and any(r["exceeded"] for r in seat["shock_ratios"].values() if isinstance(r, dict))


def _seat_axes(seat: dict[str, Any] | None) -> list[tuple[str, float, float, float]]:
    """Axis, factor k, aw and VDV without k, for every known axis."""
    if seat is None:
        return []
    aw, vdv = seat["aw_weighted_mps2"], seat["vdv_weighted_mps175"]
    return [(axis, 1.0 if axis == "z" else HORIZONTAL_FACTOR, aw[axis], vdv[axis]) for axis in aw]


def _worst_residual(document: dict[str, Any]) -> tuple[str, float] | None:
    shares = {name: residual["nrmse_rms_percent"] for name, residual in document["residual"].items()}
    known = {name: share for name, share in shares.items() if share is not None}
    worst = max(known, key=lambda name: known[name], default=None)
    return (worst, known[worst]) if worst else None


def _doses(document: dict[str, Any]) -> list[Pair]:
    """VDV from the head down to the seat, predicted and measured after the low-pass."""
    rows = []
    for name in (*reversed(SEGMENTS), SEAT):
        sides = [document[of].get(name) for of in ("measured_low_passed", "predicted")]
        values = [side["vdv_mps175"] if side else None for side in sides]
        bounds = [bool(side and side["lower_bound"]) for side in sides]
        rows.append(Pair(words(name), *values, *bounds, "" if sides[0] else ", not measured"))
    return rows
