"""`exposure.json`: every figure of one recording as the mapping people and scripts read."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

from biodyn_core.exposure import Dose, Hic
from biodyn_core.judgement import SeatExposure
from biodyn_core.limits import Limits
from biodyn_core.pipeline import Exposure, Pipeline
from biodyn_core.segments import HEAD, SEAT, SENSORS
from biodyn_ros import __version__
from biodyn_ros.wording import MODEL, left_range, stuck

EDGE_S: Final = 0.1
"""So much of a comparison may want its sensor where records begin and end, which is at rest."""


def exposure_document(
    pipeline: Pipeline, bag: str, seconds: float, warnings: list[str], project: bool = False
) -> dict[str, Any]:
    """Gather what the pipeline has counted over a recording of `seconds`; project: to 8 h from under 20 minutes too."""
    since, seat = pipeline.exposure(), pipeline.seat(project)
    uncounted = {name: pipeline.status(name).uncounted_s for name in since.sensors}
    return {
        "bag": bag,
        "subject": pipeline.subject.name,
        "mass_matrix": pipeline.subject.mass_matrix,
        "path": pipeline.mode,
        "seconds": seconds,
        "uncounted_s": max(uncounted.values(), default=seconds),
        "window_s": pipeline.settings.window_s,
        "cutoff_hz": pipeline.cutoff_hz,
        "limits": pipeline.limits.deciding.to_dict(),
        "limits_beside": _limits_beside(pipeline.limits, seat),
        "sensors": {name: _sensor(pipeline, name, dose) for name, dose in since.sensors.items()},
        # Predicted from the seat alone, whose losses are theirs. Held-out errors come with the fit of a subject, but
        # nothing ties them to this vehicle and seat, so no prediction is validated.
        "predicted": {
            name: _predicted(pipeline, dose) | {"status": "not_validated"} for name, dose in since.predicted.items()
        },
        "measured_low_passed": {name: _compared(pipeline, name, since) for name in since.measured_low_passed},
        "also_weighted": {
            weighting: {name: _sensor(pipeline, name, dose) for name, dose in doses.items()}
            for weighting, doses in since.also.items()
        },
        "seat": _seat(seat, since) if seat else None,
        "dri": _dri(since, pipeline.lower_bound(SEAT)),
        "hic15": _hic(since.hic15, pipeline.lower_bound(HEAD)),
        "hic36": _hic(since.hic36, pipeline.lower_bound(HEAD)),
        "residual": {
            name: {"nrmse_rms_percent": percent if math.isfinite(percent) else None, "rms_mps2": rms}
            for name, (rms, percent) in since.residual.items()
        },
        "latency": {output: latency._asdict() for output, latency in pipeline.latency().items()},
        "warnings": warnings,
        "version": __version__,
    }


def sensor_warnings(pipeline: Pipeline) -> list[str]:
    """What every sensor's conditioning has to say, one line each."""
    lines = []
    for name in SENSORS:
        status = pipeline.status(name)
        if status.fault:
            lines.append(status.fault)
        elif status.rate_hz is None:
            lines.append(f"{name}: nothing counted, gravity never became known")
        lines += [f"{name}: {text}" for text in status.warnings]
        if status.flat:
            lines.append(f"{name}: {stuck(status.flat)}")
        if clipped := pipeline.clipped(name):
            lines.append(f"{name}: {clipped} samples clipped: doses and peaks are lower bounds")
        missing = pipeline.missing_s(name)
        if missing > 0.0:
            lines.append(f"{name}: {missing:.3f} s missing: doses and peaks are lower bounds")
    if pipeline.divergences:
        lines.append(f"{MODEL}: {left_range(pipeline.divergences)}")
    return lines


def _dose(dose: Dose) -> dict[str, Any]:
    return {
        "aw_mps2": dose.aw_mps2,
        "mtvv_mps2": dose.mtvv_mps2,
        "crest_factor": dose.crest_factor,
        "vdv_mps175": dose.vdv_mps175,
        "peak_mps2": dose.peak_mps2,
    }


def _sensor(pipeline: Pipeline, name: str, dose: Dose) -> dict[str, Any]:
    return _dose(dose) | {
        "clipped_samples": pipeline.clipped(name),
        "missing_s": pipeline.missing_s(name),
        "lower_bound": pipeline.lower_bound(name),
    }


def _compared(pipeline: Pipeline, name: str, since: Exposure) -> dict[str, Any]:
    """A low-passed sensor's figures: what the seat lost, and instants that found no sample, are missing too."""
    doses, found = since.measured_low_passed, _sensor(pipeline, name, since.measured_low_passed[name])
    unanswered_s = doses[SEAT].seconds - doses[name].seconds if SEAT in doses else 0.0
    seat_s = pipeline.missing_s(SEAT) + (unanswered_s if unanswered_s > EDGE_S else 0.0)
    return found | {"missing_s": max(found["missing_s"], seat_s), "lower_bound": found["lower_bound"] or seat_s > 0.0}


def _predicted(pipeline: Pipeline, dose: Dose) -> dict[str, Any]:
    """A prediction's figures: what the seat lost, and what the model itself did not answer, is missing."""
    found, own_s = _sensor(pipeline, SEAT, dose), pipeline.unpredicted_s
    return found | {"missing_s": found["missing_s"] + own_s, "lower_bound": found["lower_bound"] or own_s > 0.0}


def _seat(seat: SeatExposure, since: Exposure) -> dict[str, Any]:
    document = dataclasses.asdict(seat)
    del document["beside"]
    ratios = {
        ratio.name: {
            "value": ratio.value, "threshold": ratio.threshold, "exceeded": ratio.exceeded, "clause": ratio.clause,
        }
        for ratio in seat.shock_ratios
    }  # fmt: skip
    return document | {"shock_ratios": {"axis": seat.axis, **ratios}, "msdv_mps15": since.msdv_mps15}


def _limits_beside(limits: Limits, seat: SeatExposure | None) -> list[dict[str, Any]]:
    """The sets of limits that do not decide, each with the judgement by it once there is one."""
    judged = [dataclasses.asdict(judgement) for judgement in seat.beside] if seat else [{} for _ in limits.beside]
    return [each.to_dict() | judgement for each, judgement in zip(limits.beside, judged, strict=True)]


def _dri(since: Exposure, lower_bound: bool) -> dict[str, Any] | None:
    dri = since.dri
    return dri and {
        "compression": dri.compression, "as_printed": dri.as_printed, "class": dri.band, "time_s": dri.time_s,
        "lower_bound": lower_bound,
    }  # fmt: skip


def _hic(hic: Hic | None, lower_bound: bool) -> dict[str, Any] | None:
    return dataclasses.asdict(hic) | {"lower_bound": lower_bound} if hic else None
