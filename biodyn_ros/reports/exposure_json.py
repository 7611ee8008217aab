"""The mapping of `exposure.json`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from biodyn_core.exposure.injury import Dri, Hic
from biodyn_core.exposure.joint_forces import JOINT_NAMES
from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.limits import Limits
from biodyn_core.exposure.meters import Dose
from biodyn_core.exposure.shock_ratios import ShockRatio
from biodyn_ros import __version__
from biodyn_ros.reading.provenance import MADE_BY_MODEL
from biodyn_ros.reports.exposure_report import ChannelExposure, ExposureReport, JointExposure

Document = dict[str, Any]


def exposure_document(report: ExposureReport) -> Document:
    """The whole mapping of exposure.json."""
    status = {"status": report.prediction_status}
    made = {"bag_made_by_model": MADE_BY_MODEL} if report.is_made_by_model else {}
    return {
        "bag": report.bag,
        "subject": report.subject,
        "mass_matrix": report.mass_matrix,
        "path": report.path,
        "seconds": report.run.seconds,
        "uncounted_s": report.uncounted_s,
        "window_s": report.window_s,
        "cutoff_hz": report.run.cutoff_hz,
        "limits": report.limits.deciding.to_dict(),
        "limits_beside": _additional_limits(report.limits, report.seat),
        "sensors": _channels(report.sensors),
        "predicted": {
            name: figures | report.dose_intervals(name)._asdict() | status
            for name, figures in _channels(report.predicted).items()
        },
        "measured_low_passed": _channels(report.measured_low_passed),
        "also_weighted": {weighting: _channels(channels) for weighting, channels in report.also_weighted.items()},
        "seat": _seat(report.seat, report.msdv_mps15) if report.seat else None,
        "dri": dri_document(report.dri, report.is_dri_lower_bound),
        "hic15": _hic(report.hic15, report.is_hic_lower_bound),
        "hic36": _hic(report.hic36, report.is_hic_lower_bound),
        "residual": {
            name: {"nrmse_rms_percent": residual.nrmse_rms_percent, "rms_mps2": residual.rms_mps2}
            for name, residual in report.residual.items()
        },
        "joint_forces": {
            name: _joint(name, found) | report.force_intervals(name)._asdict() | status
            for name, found in report.joint_forces.items()
        },
        "origin": report.origin,
        "no_interval": report.no_interval or None,
        "body_mass_kg": report.body_mass_kg,
        "lifts_off": report.lifts_off,
        "misfits": [one._asdict() for one in report.misfits],
        "not_monitored": report.not_monitored or None,
        "monitored": list(report.monitored),
        "latency": {output: latency._asdict() for output, latency in report.run.latency.items()},
        "warnings": list(report.warnings),
        "version": __version__,
        "time": dict(report.times),
        "marks": [mark._asdict() for mark in report.marks],
        **made,
    }


def dose_figures(dose: Dose) -> dict[str, float | None]:
    """The values of one channel by their names in all documents."""
    return {
        "aw_mps2": dose.aw_mps2,
        "mtvv_mps2": dose.mtvv_mps2,
        "mtvv_linear_mps2": dose.mtvv_linear_mps2,
        "mtvv_exponential_mps2": dose.mtvv_exponential_mps2,
        "crest_factor": dose.crest_factor,
        "vdv_mps175": dose.vdv_mps175,
        "peak_mps2": dose.peak_mps2,
    }


def dri_document(dri: Dri | None, lower_bound: bool) -> Document | None:
    """The Dynamic Response Index; None before the seat has counted."""
    return dri and {
        "compression": dri.compression, "as_printed": dri.as_printed, "class": dri.band,
        "class_lower_bound": lower_bound and not dri.is_in_highest_band, "time_s": dri.time_s,
        "lower_bound": lower_bound,
    }  # fmt: skip


def hic_windows(hic: Hic, definitions: Iterable[str]) -> dict[str, list[float] | None]:
    """Start and end of the window with the largest HIC, by definition; None if HIC is zero."""
    windows = {name: hic.windows_s[name] for name in definitions}
    return {name: None if window is None else list(window) for name, window in windows.items()}


def _channels(channels: Mapping[str, ChannelExposure]) -> dict[str, Document]:
    return {
        name: dose_figures(dose)
        | {
            "clipped_samples": lost.clipped, "missing_s": lost.missing_s, "suspect_s": lost.suspect_s,
            "lower_bound": lost.lower_bound, "aw_lower_bound": lost.mean_lower_bound,
        }
        for name, (dose, lost) in channels.items()
    }  # fmt: skip


def _joint(name: str, joint: JointExposure) -> Document:
    force = joint.force
    return {
        "joint": JOINT_NAMES[name], "compression_n": force.compression_n, "tension_n": force.tension_n,
        "rms_n": force.rms_n, "static_n": joint.static_n, "lower_bound": joint.losses.lower_bound,
        "rms_lower_bound": joint.losses.mean_lower_bound,
    }  # fmt: skip


def _seat(seat: SeatExposure, msdv_mps15: float | None) -> Document:
    document = dataclasses.asdict(seat)
    del document["additional"]
    ratios = {
        ratio.name: {
            "value": ratio.value, "threshold": ratio.threshold, "exceeded": _exceeded(ratio, seat),
            "clause": ratio.clause,
        }
        for ratio in seat.shock_ratios
    }  # fmt: skip
    return document | {"shock_ratios": {"axis": seat.axis, **ratios}, "msdv_mps15": msdv_mps15}


def _exceeded(ratio: ShockRatio, seat: SeatExposure) -> bool | None:
    """Whether a ratio is above its threshold; None where lower bounds leave it undecided."""
    return None if seat.lower_bound and not ratio.exceeded else ratio.exceeded


def _additional_limits(limits: Limits, seat: SeatExposure | None) -> list[Document]:
    """The additional sets of limits, each with its assessment if available."""
    assessed = [dataclasses.asdict(each) for each in seat.additional] if seat else [{} for _ in limits.additional]
    return [each.to_dict() | assessment for each, assessment in zip(limits.additional, assessed, strict=True)]


def _hic(hic: Hic | None, lower_bound: bool) -> Document | None:
    if hic is None:
        return None
    return dataclasses.asdict(hic) | {"windows_s": hic_windows(hic, hic.windows_s), "lower_bound": lower_bound}
