"""`exposure.json`: every figure of one recording as the mapping people and scripts read."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from biodyn_core.exposure import Dose, Hic
from biodyn_core.pipeline import Exposure, Pipeline
from biodyn_core.segments import SEAT, SENSORS
from biodyn_ros import __version__

PROJECTION_AFTER_S = 20.0 * 60.0
"""Shorter records do not carry a projection to eight hours."""


def exposure_document(pipeline: Pipeline, bag: str, seconds: float, warnings: list[str]) -> dict[str, Any]:
    """Gather what the pipeline has counted over a recording of `seconds`."""
    since = pipeline.exposure()
    uncounted = {name: pipeline.status(name).uncounted_s for name in since.sensors}
    return {
        "bag": bag,
        "subject": pipeline.subject.name,
        "mass_matrix": pipeline.subject.mass_matrix,
        "path": "causal",
        "seconds": seconds,
        "uncounted_s": max(uncounted.values(), default=seconds),
        "window_s": pipeline.settings.window_s,
        "limits": pipeline.limits.to_dict(),
        "sensors": {name: _sensor(pipeline, name, dose) for name, dose in since.sensors.items()},
        # Held-out errors come with the fit of a subject; until a file carries them no prediction is validated.
        "predicted": {name: _dose(dose) | {"status": "not_validated"} for name, dose in since.predicted.items()},
        "measured_low_passed": {
            name: _sensor(pipeline, name, dose) for name, dose in since.measured_low_passed.items()
        },
        "seat": _seat(pipeline),
        "dri": _dri(since),
        "hic15": _hic(since.hic15),
        "hic36": _hic(since.hic36),
        "residual": {
            name: {"nrmse_rms_percent": percent if math.isfinite(percent) else None, "rms_mps2": rms}
            for name, (rms, percent) in since.residual.items()
        },
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
        if status.clipped:
            lines.append(f"{name}: {status.clipped} samples clipped: doses and peaks are lower bounds")
        missing = pipeline.missing_s(name)
        if missing > 0.0:
            lines.append(f"{name}: {missing:.3f} s missing: doses and peaks are lower bounds")
    if pipeline.divergences:
        lines.append(f"the model left the finite numbers {pipeline.divergences} times and was put back to rest")
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
        "clipped_samples": pipeline.status(name).clipped,
        "missing_s": pipeline.missing_s(name),
        "lower_bound": pipeline.lower_bound(name),
    }


def _seat(pipeline: Pipeline) -> dict[str, Any] | None:
    seat = pipeline.seat()
    if seat is None:
        return None
    scale = 8.0 * 3600.0 / seat.seconds if seat.seconds >= PROJECTION_AFTER_S else None
    document = dataclasses.asdict(seat)
    del document["seconds"]
    return document | {
        "a8_projected_8h_mps2": seat.a8_so_far_mps2 * math.sqrt(scale) if scale else None,
        "vdv_projected_8h_mps175": seat.vdv_so_far_mps175 * scale**0.25 if scale else None,
        "lower_bound": pipeline.lower_bound(SEAT),
    }


def _dri(since: Exposure) -> dict[str, Any] | None:
    dri = since.dri
    return dri and {
        "compression": dri.compression, "as_printed": dri.as_printed, "class": dri.band, "time_s": dri.time_s,
    }  # fmt: skip


def _hic(hic: Hic | None) -> dict[str, Any] | None:
    return dataclasses.asdict(hic) if hic else None
