"""The report of a replay: one HTML file with exposure, predictions, measurements and residual."""

from __future__ import annotations

from typing import Any

from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.exposure.joint_forces import JOINT_NAMES
from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.losses import Losses
from biodyn_core.exposure.seat_axes import HORIZONTAL_FACTOR
from biodyn_ros import __version__
from biodyn_ros.base.wording import FORCES_NOT_MEASURED, LIFTS_OFF, words
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.replay.traces import Traces
from biodyn_ros.reports.doses import VDV_LABEL, Pair, doses
from biodyn_ros.reports.exposure_report import ChannelExposure, ExposureReport
from biodyn_ros.reports.frequency import powers, residual_channels, transmissibility, waterfall
from biodyn_ros.reports.meter import AxisReading, axis_reading, meter_readings
from biodyn_ros.reports.motion import envelopes, overlay
from biodyn_ros.reports.pages import check_reports, render
from biodyn_ros.reports.verdict import seat_verdict, zone_text
from biodyn_ros.validate.settings import LEAST_COHERENCE


def replay_page(report: ExposureReport, traces: Traces) -> str:
    """The report of a replay and the traces of its frames as HTML.

    Raises InputError where jinja2 or matplotlib is missing.
    """
    check_reports()
    event, predicted, measured, origin_ns = traces.event(), traces.predicted(), traces.measured(), traces.first_ns
    seat, channel = report.seat, report.sensors.get(SEAT)
    return render(
        "replay.html.j2",
        report=report,
        seat=seat,
        seat_losses=channel.losses if channel else None,
        verdict=seat_verdict(seat, channel.losses if channel else None),
        meter=meter_readings(seat, channel),
        zone_text=zone_text,
        made_by_model=MADE_BY_MODEL,
        version=__version__,
        flagged=seat is not None and any(ratio.exceeded for ratio in seat.shock_ratios),
        joints=[
            (JOINT_NAMES[name], joint, report.force_intervals(name))
            for name, joint in reversed(report.joint_forces.items())
        ],
        forces_not_measured=FORCES_NOT_MEASURED,
        lifts_off=LIFTS_OFF,
        segments=[name for name in SEGMENTS if name in report.predicted],
        sensors=[name for name in SENSORS if name in report.sensors],
        worst=_worst_residual(report),
        seat_axes=_seat_axes(seat, channel.losses) if seat and channel else [],
        event=event,
        event_s=1e-9 * (event.peak_ns - origin_ns) if event else None,
        bin_s=1e-9 * max(predicted.width_ns, measured.width_ns),
        overlay_svg=overlay(event, origin_ns, report.residual) if event else None,
        envelope_svg=envelopes(predicted, measured, event, origin_ns) if measured.begins_ns.size else None,
        **frequency_parts(report, traces, origin_ns),
    )


def frequency_parts(report: ExposureReport, traces: Traces, origin_ns: int) -> dict[str, Any]:
    """The drawings over frequency, and of doses; None for a drawing without data."""
    spectra, found, worst = traces.spectra.spectra(), traces.spectra.waterfall(), _worst_residual(report)
    return {
        "bandwidth_hz": spectra["spectra"]["bandwidth_hz"] if spectra else None,
        "transmissibility_svg": transmissibility(spectra, LEAST_COHERENCE) if spectra else None,
        "powers_svg": powers(spectra) if spectra else None,
        "width_ns": found.width_ns if found else None,
        "waterfall_svg": waterfall(found, residual_channels(worst[0]), origin_ns) if found and worst else None,
        "doses_svg": doses(_doses(report), VDV_LABEL) if report.predicted else None,
    }


def _seat_axes(seat: SeatExposure, losses: Losses) -> list[tuple[AxisReading, float]]:
    """The reading and the factor k of every known axis."""
    return [
        (axis_reading(axis, seat, losses), 1.0 if axis == "z" else HORIZONTAL_FACTOR) for axis in seat.aw_weighted_mps2
    ]


def _worst_residual(report: ExposureReport) -> tuple[str, float] | None:
    shares = [(name, residual.nrmse_rms_percent) for name, residual in report.residual.items()]
    known = [(name, share) for name, share in shares if share is not None]
    return max(known, key=lambda pair: pair[1], default=None)


def _doses(report: ExposureReport) -> list[Pair]:
    """VDV from the head down to the seat, predicted and measured after the low-pass."""
    rows = []
    for name in (*reversed(SEGMENTS), SEAT):
        (measured, measured_bound), (predicted, predicted_bound) = (
            _vdv(channels.get(name)) for channels in (report.measured_low_passed, report.predicted)
        )
        note = ", not measured" if measured is None else ""
        interval = report.dose_intervals(name).vdv_interval_mps175 if name in report.predicted else None
        rows.append(Pair(words(name), measured, predicted, measured_bound, predicted_bound, note, interval))
    return rows


def _vdv(channel: ChannelExposure | None) -> tuple[float | None, bool]:
    return (channel.dose.vdv_mps175, channel.losses.lower_bound) if channel else (None, False)
