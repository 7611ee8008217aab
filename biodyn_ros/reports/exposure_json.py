"""`exposure.json`: all results of one recording as a mapping."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

from biodyn_core.base.segments import HEAD, SEAT, SENSORS
from biodyn_core.base.wording import counted
from biodyn_core.exposure.injury import Hic
from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.limits import Limits
from biodyn_core.exposure.losses import Losses
from biodyn_core.exposure.meters import Dose
from biodyn_core.pipeline.exposure import Exposure
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_ros import __version__
from biodyn_ros.base.wording import MODEL, left_range, stuck

EDGE_S: Final = 0.1
"""Part of a comparison that may lack its sensor at the start and end of a record, at rest."""


def exposure_document(
    pipeline: Pipeline, bag: str, seconds: float, warnings: list[str], project: bool = False
) -> dict[str, Any]:
    """Gather what the pipeline has counted over a recording of `seconds`; project: to 8 h from under 20 minutes too."""
    since, seat, run = pipeline.exposure(), pipeline.seat(project), pipeline.run_status()
    uncounted = {name: pipeline.status(name).uncounted_s for name in since.sensors}
    lost = {name: pipeline.losses(name) for name in SENSORS}
    status = "extrapolated" if run.is_extrapolating else "not_validated"
    return {
        "bag": bag,
        "subject": pipeline.subject.name,
        "mass_matrix": pipeline.subject.mass_matrix,
        "path": pipeline.mode,
        "seconds": seconds,
        "uncounted_s": max(uncounted.values(), default=seconds),
        "window_s": pipeline.settings.window_s,
        "cutoff_hz": run.cutoff_hz,
        "limits": pipeline.limits.deciding.to_dict(),
        "limits_beside": _limits_beside(pipeline.limits, seat),
        "sensors": {name: _figures(dose, lost[name]) for name, dose in since.sensors.items()},
        # Predictions use the seat alone and have its losses. Held-out errors of a fit are of another vehicle and
        # seat, so no prediction is validated.
        "predicted": {
            name: _figures(dose, _and_absent(lost[SEAT], run.unpredicted_s)) | {"status": status}
            for name, dose in since.predicted.items()
        },
        "measured_low_passed": {
            name: _figures(dose, _lost_beside(name, since.measured_low_passed, lost))
            for name, dose in since.measured_low_passed.items()
        },
        "also_weighted": {
            weighting: {name: _figures(dose, lost[name]) for name, dose in doses.items()}
            for weighting, doses in since.further.items()
        },
        "seat": _seat(seat, since) if seat else None,
        "dri": _dri(since, lost[SEAT].lower_bound),
        "hic15": _hic(since.hic15, lost[HEAD].lower_bound),
        "hic36": _hic(since.hic36, lost[HEAD].lower_bound),
        "residual": {
            name: {"nrmse_rms_percent": percent if math.isfinite(percent) else None, "rms_mps2": rms}
            for name, (rms, percent) in since.residual.items()
        },
        "latency": {output: latency._asdict() for output, latency in run.latency.items()},
        "warnings": warnings,
        "version": __version__,
    }


def sensor_warnings(pipeline: Pipeline, sensors: Iterable[str]) -> list[str]:
    """Warnings about the conditioning of these sensors and about the model, one line each."""
    lines = []
    for name in sensors:
        status = pipeline.status(name)
        if status.fault:
            lines.append(status.fault)
        elif status.rate_hz is None:
            lines.append(f"{name}: nothing counted, gravity was not found")
        lines += [f"{name}: {text}" for text in status.warnings]
        if status.set_back_s > 0.0:
            lines.append(f"{name}: its stamps jumped back by {status.set_back_s:.3f} s in total: was its clock set?")
        if status.flat:
            lines.append(f"{name}: {stuck(status.flat)}")
        lost = pipeline.losses(name)
        if lost.clipped:
            lines.append(f"{name}: {counted(lost.clipped, 'sample')} clipped: doses and peaks are lower bounds")
        if lost.missing_s > 0.0:
            lines.append(f"{name}: {lost.missing_s:.3f} s missing: doses and peaks are lower bounds")
    if divergences := pipeline.run_status().divergences:
        lines.append(f"{MODEL}: {left_range(divergences)}")
    return lines


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


def _figures(dose: Dose, lost: Losses) -> dict[str, Any]:
    # A mean is a lower bound where samples are clipped or stuck, not where some are missing.
    return dose_figures(dose) | {
        "clipped_samples": lost.clipped, "missing_s": lost.missing_s, "lower_bound": lost.lower_bound,
        "aw_lower_bound": lost.clipped > 0 or lost.flat_s > 0.0,
    }  # fmt: skip


def _and_absent(lost: Losses, seconds: float) -> Losses:
    return lost._replace(absent_s=lost.absent_s + seconds)


def _lost_beside(name: str, doses: Mapping[str, Dose], lost: Mapping[str, Losses]) -> Losses:
    """Losses of a low-passed sensor: with those of the seat, and instants without a sample."""
    if name == SEAT:
        return lost[SEAT]
    alone_s = doses[SEAT].seconds - doses[name].seconds if SEAT in doses else 0.0
    beside_s = lost[SEAT].missing_s + (alone_s if alone_s > EDGE_S else 0.0)
    return _and_absent(lost[name], max(0.0, beside_s - lost[name].missing_s))


def _seat(seat: SeatExposure, since: Exposure) -> dict[str, Any]:
    document = dataclasses.asdict(seat)
    del document["additional"]
    ratios = {
        ratio.name: {
            "value": ratio.value, "threshold": ratio.threshold, "exceeded": ratio.exceeded, "clause": ratio.clause,
        }
        for ratio in seat.shock_ratios
    }  # fmt: skip
    return document | {"shock_ratios": {"axis": seat.axis, **ratios}, "msdv_mps15": since.msdv_mps15}


def _limits_beside(limits: Limits, seat: SeatExposure | None) -> list[dict[str, Any]]:
    """The additional sets of limits, each with its assessment if available."""
    assessed = [dataclasses.asdict(each) for each in seat.additional] if seat else [{} for _ in limits.additional]
    return [each.to_dict() | assessment for each, assessment in zip(limits.additional, assessed, strict=True)]


def _dri(since: Exposure, lower_bound: bool) -> dict[str, Any] | None:
    dri = since.dri
    return dri and {
        "compression": dri.compression, "as_printed": dri.as_printed, "class": dri.band, "time_s": dri.time_s,
        "lower_bound": lower_bound,
    }  # fmt: skip


def _hic(hic: Hic | None, lower_bound: bool) -> dict[str, Any] | None:
    if hic is None:
        return None
    return dataclasses.asdict(hic) | {"windows_s": hic_windows(hic, hic.windows_s), "lower_bound": lower_bound}


def hic_windows(hic: Hic, definitions: Iterable[str]) -> dict[str, list[float] | None]:
    """Start and end of the window with the largest HIC, by definition; None if HIC is zero."""
    windows = {name: hic.windows_s[name] for name in definitions}
    return {name: None if window is None else list(window) for name, window in windows.items()}
