"""The summary of a recording for the terminal."""

from __future__ import annotations

from biodyn_core.exposure.injury import Hic
from biodyn_core.exposure.joint_forces import JOINT_NAMES
from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.limits import KINDS, LimitSet
from biodyn_ros.base.wording import (
    FORCES_NOT_MEASURED,
    LIFTS_OFF,
    bound,
    dri_band,
    duration,
    ends,
    misfit_line,
    number,
    partly_tested,
    sentence,
    span,
    table,
    words,
)
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.reports.exposure_report import ChannelExposure, ExposureReport, MisfitTime
from biodyn_ros.reports.intervals import Interval
from biodyn_ros.reports.verdict import HORIZONTAL, shocks, time_left, zone_text


def summary(report: ExposureReport) -> str:
    """Summary: the seat against its limits, exposure by sensor, prediction and residual, warnings."""
    seconds, status = report.run.seconds, words(report.prediction_status)
    marks = ", ".join(f"{mark.name} at {mark.time_s:.3f} s" for mark in report.marks)
    lines = [
        f"{report.bag}  subject {report.subject} ({report.mass_matrix})",
        f"{seconds:.1f} s, {report.uncounted_s:.2f} s of it uncounted, until gravity was known",
        "",
        *(_seat_lines(report.seat, report.limits.deciding) if report.seat else ["seat: nothing counted"]),
        *_injury_lines(report),
        *([f"marked: {marks}"] if marks else []),
        "",
        f"{'':14s}{'aw':>9s}{'VDV':>11s}{'predicted':>12s}{'VDV':>11s}{'residual rms':>15s}{'NRMSE':>9s}",
        f"{'':14s}{'m/s^2':>9s}{'m/s^1.75':>11s}{'aw m/s^2':>12s}{'m/s^1.75':>11s}{'m/s^2':>15s}{'%':>9s}",
        *(_row(name, report) for name in dict.fromkeys([*report.sensors, *report.predicted])),
        "",
        *_interval_lines(report),
        *_joint_lines(report),
        *_misfit_lines(report),
        f"aw, VDV: Wk, vertical; measured before, predicted after the low-pass. Predictions are a model's: {status}.",
        *(f"note: {text}" for text in (*report.warnings, *([MADE_BY_MODEL] if report.is_made_by_model else []))),
    ]
    return "\n".join(lines)


def _row(name: str, report: ExposureReport) -> str:
    aw, vdv = _aw_and_vdv(report.sensors.get(name))
    predicted_aw, predicted_vdv = _aw_and_vdv(report.predicted.get(name))
    rms, percent = map(number, report.residual.get(name, (None, None)))
    return f"{name:14s}{aw:>9s}{vdv:>11s}{predicted_aw:>12s}{predicted_vdv:>11s}{rms:>15s}{percent:>9s}"


def _aw_and_vdv(channel: ChannelExposure | None) -> tuple[str, str]:
    if channel is None:
        return number(None), number(None)
    dose, losses = channel
    return bound(dose.aw_mps2, losses.mean_lower_bound), bound(dose.vdv_mps175, losses.lower_bound)


def _seat_lines(seat: SeatExposure, limits: LimitSet) -> list[str]:
    a8 = f"{bound(seat.a8_so_far_mps2, seat.lower_bound)} m/s^2 of {_pair(limits.action_a8_mps2, limits.limit_a8_mps2)}"
    vdv_limits = _pair(limits.action_vdv_mps175, limits.limit_vdv_mps175)
    vdv = f"{bound(seat.vdv_so_far_mps175, seat.lower_bound)} m/s^1.75 of {vdv_limits}"
    return [
        f"SEAT: {zone_text(seat).upper()}",
        sentence(seat.zone_reason),
        f"seat A(8) so far {a8}, VDV so far {vdv} ({limits.source})",
        *_projected(seat),
        *(time_left(kind, seat) for kind in KINDS),
        f"Governed by {seat.governing}, axis {seat.axis}. {HORIZONTAL[seat.horizontal]}",
        shocks(seat),
        *(f"also {each.source}: {zone_text(each).lower()}" for each in seat.additional),
    ]


def _pair(action: float | None, limit: float | None) -> str:
    return "no value stated" if action is None else f"{action:g} / {limit:g}"


def _projected(seat: SeatExposure) -> list[str]:
    if seat.projected_from_s is None:
        return []
    a8 = bound(seat.a8_projected_8h_mps2, seat.projected_lower_bound)
    vdv = bound(seat.vdv_projected_8h_mps175, seat.projected_lower_bound)
    raised = ", which losses within strong motion make uncertain" if seat.is_estimate else ""
    return [
        f"projected to 8 h from {duration(seat.projected_from_s)} counted: A(8) {a8} m/s^2, VDV {vdv} m/s^1.75{raised}"
    ]


def _injury_lines(report: ExposureReport) -> list[str]:
    dri, hic = report.dri, report.hic15
    lines = []
    if dri:
        lower = report.is_dri_lower_bound
        lines.append(
            f"DRI {bound(dri.compression, lower)} (compression, {dri_band(dri, lower)}; "
            f"as printed {bound(dri.as_printed, lower)}); a criterion for a single upward pulse, not a dose"
        )
    if hic:
        resultant, vertical, as_printed = (
            bound(each, report.is_hic_lower_bound) for each in (hic.resultant, hic.vertical, hic.as_printed)
        )
        lines.append(
            f"HIC15 of the head {resultant} resultant{_window(hic)}, {vertical} vertical, "
            f"{as_printed} with 1 g as printed"
        )
    return lines


def _interval_lines(report: ExposureReport) -> list[str]:
    """The predictions with their 95 % intervals, from the head down."""
    if not report.predicted:
        return []
    if report.no_interval:
        return [*report.interval_notes, ""]
    title = ("predicted, with 95 % interval", "aw, m/s^2", "VDV, m/s^1.75", "compression below, N")
    rows = [_interval_row(name, report) for name in reversed(report.predicted)]
    return [*table([title, *rows], left=(0,)), *report.interval_notes, ""]


def _interval_row(name: str, report: ExposureReport) -> tuple[str, ...]:
    (aw, vdv), intervals = _aw_and_vdv(report.predicted[name]), report.dose_intervals(name)
    compression, compression_interval_n = number(None), None
    if joint := report.joint_forces.get(name):
        compression = bound(joint.force.compression_n, joint.losses.lower_bound)
        compression_interval_n = report.force_intervals(name).compression_interval_n
    return (
        words(name),
        _with_ends(aw, intervals.aw_interval_mps2),
        _with_ends(vdv, intervals.vdv_interval_mps175),
        _with_ends(compression, compression_interval_n),
    )


def _with_ends(figure: str, interval: Interval | None) -> str:
    return figure if interval is None else f"{figure} ({ends(interval)})"


def _joint_lines(report: ExposureReport) -> list[str]:
    """The predicted forces, from the head down."""
    if not report.joint_forces:
        return []
    rows = [
        (
            JOINT_NAMES[name],
            *(bound(peak_n, losses.lower_bound) for peak_n in (force.compression_n, force.tension_n)),
            bound(force.rms_n, losses.mean_lower_bound),
            number(static_n),
        )
        for name, (force, losses, static_n) in reversed(report.joint_forces.items())
    ]
    assumed = f"for the assumed {number(report.body_mass_kg)} kg; {FORCES_NOT_MEASURED}"
    return [
        *table([("force in the joint, N", "compression", "tension", "rms", "static weight"), *rows], left=(0,)),
        f"Forces: predicted, without the static weight, {assumed}.",
        *([LIFTS_OFF] if report.lifts_off else []),
        "",
    ]


def _misfit_lines(report: ExposureReport) -> list[str]:
    """The times in which the model does not fit, and how to trace them."""
    if report.not_monitored:
        return [f"Does the model fit? Unknown: {report.not_monitored}."]
    if not report.misfits:
        return [f"The model fits as it did in its held-out events{partly_tested(report.monitored)}."]
    lines = [misfit_line(one.segment, _span_of(one), one.ratio) for one in report.misfits]
    if "@" not in report.bag:
        first = report.misfits[0]
        end = "" if first.end_s is None else f"{first.end_s:.0f}"
        lines.append(f"to search for the cause: biodyn trace {report.bag}@{first.begin_s:.0f}..{end} ...")
    return lines


def _span_of(one: MisfitTime) -> str:
    return f"from {one.begin_s:.0f} s" + ("" if one.end_s is None else f" to {one.end_s:.0f} s")


def _window(hic: Hic) -> str:
    window = hic.windows_s["resultant"]
    return f" ({span(window)} s after counting began)" if window else ""
