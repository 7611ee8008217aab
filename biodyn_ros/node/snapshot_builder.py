"""What the live page shows, gathered beside the ride: four times a second one plain mapping of words and numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, Final

from biodyn_core.base.segments import HEAD, N_SEGMENTS, N_SENSORS, SEAT, SEGMENTS, SENSORS
from biodyn_core.pipeline.frames import Frames, joined
from biodyn_core.pipeline.pipeline import Exposure, Pipeline
from biodyn_core.pipeline.shocks import Shock, Shocks
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.wording import left, words
from biodyn_ros.node.health import ERROR, SILENT_AFTER_S, Mark, Status
from biodyn_ros.reports.downsampling import Bins, MinMaxDownsampler
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.meter import meter_readings
from biodyn_ros.reports.verdict import seat_verdict

STILL_MPS2: Final = 0.05
"""A seat that shakes less moves nobody: a transmissibility would be that of the sensors' noise."""

ROWS: Final = (*reversed(SEGMENTS), SEAT)
"""From the head down."""

HEAD_COLUMN: Final = SENSORS.index(HEAD), SEGMENTS.index(HEAD)


class SnapshotBuilder:
    """`add` every push's frames, `gather` a few times a second, `snapshot` when somebody looks."""

    def __init__(self, shock_mps2: float) -> None:
        self._frames: list[Frames] = []
        self._shock_mps2 = shock_mps2
        self._shocks = Shocks(shock_mps2)
        self._predicted, self._measured = MinMaxDownsampler(N_SEGMENTS), MinMaxDownsampler(N_SENSORS)
        self._bins: dict[str, Bins] = {}

    def add(self, frames: Frames) -> None:
        """Take one push's frames; they must not be written to afterwards."""
        self._frames.append(frames)

    def gather(self) -> None:
        """Look at what came: shocks, and the bins of the strip that are complete since the last look."""
        frames, self._frames = joined(self._frames), []
        self._shocks.push(*frames)
        self._predicted.add(*frames.predicted)
        self._measured.add(frames.measured.stamps_ns, frames.measured.accel_mps2)
        self._bins = {"predicted": self._predicted.take(), "measured": self._measured.take()}

    def snapshot(self, pipeline: Pipeline, statuses: list[Status], marks: Iterable[Mark]) -> dict[str, Any]:
        """Everything that the page shows of this moment, finite numbers and texts alone."""
        document = exposure_document(pipeline, "", pipeline.seconds(), [])
        by_name = {status.of: status for status in statuses}
        seat, doubt = document["seat"], _doubt(by_name)
        return {
            "version": __version__,
            "subject": document["subject"],
            "mass_matrix": document["mass_matrix"],
            "window_s": document["window_s"],
            "shock_mps2": self._shock_mps2,
            "limits": document["limits"],
            "seconds": document["seconds"],
            "verdict": vars(seat_verdict(document, doubt)),
            "seat": _seat(seat, document, doubt) if seat else None,
            "meter": asdict(readings) if (readings := meter_readings(document)) else None,
            "rows": _rows(pipeline.exposure(rolling=True), by_name, document["sensors"]),
            "prediction": _status(by_name["prediction"]) | {"extrapolated": _extrapolated(document)},
            "exposure": _status(by_name["exposure"]) if "exposure" in by_name else None,
            "dri": document["dri"],
            "shocks": [_shock(shock, document["sensors"]) for shock in self._shocks.latest()],
            "strip": {name: _strip(bins) for name, bins in self._bins.items()},
            "marks": [asdict(mark) for mark in marks],
        }


def _doubt(statuses: dict[str, Status]) -> str:
    """What is wrong with the seat now that the figures since reset need not show yet."""
    seat, prediction = statuses[SEAT], statuses["prediction"]
    if seat.level == ERROR or int(seat.values["publishers"]) > 1:
        return f"seat: {seat.message}"
    return "" if seat.values["rate_hz"] else prediction.message


def _extrapolated(document: dict[str, Any]) -> bool:
    return any(each["status"] == "extrapolated" for each in document["predicted"].values())


def _status(status: Status) -> dict[str, Any]:
    return {"level": status.level, "message": status.message}


def _seat(seat: dict[str, Any], document: dict[str, Any], doubt: str) -> dict[str, Any]:
    """The seat against its limits: both measures with their values, who governs, and the time left in words.

    Nobody is promised time while there is a doubt.
    """
    seat = seat | ({"withheld": doubt} if doubt else {})
    limits = document["limits"]
    figures = (
        ("A(8)", "a8", "m/s^2", seat["a8_so_far_mps2"], seat["a8_axis"], "a8_mps2"),
        ("VDV", "vdv", "m/s^1.75", seat["vdv_so_far_mps175"], seat["vdv_axis"], "vdv_mps175"),
    )
    return {
        "figures": [
            {
                "name": name, "unit": unit, "so_far": so_far, "axis": words(axis), "governs": seat["governing"] == key,
                "action": limits[f"action_{suffix}"], "limit": limits[f"limit_{suffix}"],
            }
            for name, key, unit, so_far, axis, suffix in figures
        ],
        "lower_bound": seat["lower_bound"],
        "counted_s": seat["seconds"],
        "missing_s": document["sensors"][SEAT]["missing_s"],
        "left": {kind: left(kind, seat) for kind in ("action", "limit")},
    }  # fmt: skip


def _rows(rolling: Exposure, statuses: dict[str, Status], sensors: dict[str, Any]) -> list[dict[str, Any]]:
    """From the head down: weighted acceleration of the window, measured and predicted, and how each sensor does.

    Both figures of a segment, their ratios to the seat and the residual count the same samples.
    """
    rows = []
    for name in ROWS:
        found, model, seat_mps2 = _side_by_side(rolling, name)
        rms_mps2, percent = rolling.residual.get(name, (None, None))
        rows.append(
            {
                "name": words(name),
                "measured_mps2": found,
                "measured_lower_bound": _at_least(name, sensors),
                "predicted_mps2": model,
                "predicted_lower_bound": _at_least(SEAT, sensors),
                "measured_ratio": _ratio(found, seat_mps2) if name != SEAT else None,
                "predicted_ratio": _ratio(model, seat_mps2),
                "residual_mps2": rms_mps2,
                "residual_percent": percent if percent is not None and math.isfinite(percent) else None,
                "measured_column": SENSORS.index(name) if name in SENSORS else None,
                "predicted_column": SEGMENTS.index(name) if name in SEGMENTS else None,
                "sensor": _sensor(statuses[name]) if name in SENSORS else None,
            }
        )
    return rows


def _side_by_side(rolling: Exposure, name: str) -> tuple[float | None, float | None, float]:
    """Weighted acceleration measured and predicted (None: not known), and of the seat over the same samples, m/s^2."""
    if name == SEAT:
        dose = rolling.measured_low_passed.get(SEAT)
        return (dose.aw_mps2, None, dose.aw_mps2) if dose and dose.seconds > 0.0 else (None, None, 0.0)
    if name not in rolling.compared:
        return None, None, 0.0
    measured, predicted, seat = rolling.compared[name]
    return measured.aw_mps2 if measured else None, predicted.aw_mps2, seat.aw_mps2


def _sensor(status: Status) -> dict[str, Any]:
    """How a sensor does, with its rate and lag, which one that is silent has no more."""
    values = status.values
    sends = bool(values["silent_s"]) and float(values["silent_s"]) <= SILENT_AFTER_S
    numbers = {key: float(values[key]) if values[key] and sends else None for key in ("rate_hz", "lag_ms")}
    return _status(status) | numbers


def _ratio(figure: float | None, seat_mps2: float) -> float | None:
    return None if figure is None or seat_mps2 < STILL_MPS2 else figure / seat_mps2


def _at_least(name: str, sensors: dict[str, Any]) -> bool:
    """Whether a sensor clipped or stuck since reset, so that it felt more than it says."""
    return name in sensors and sensors[name]["aw_lower_bound"]


def _shock(shock: Shock, sensors: dict[str, Any]) -> dict[str, Any]:
    """A shock: when, and how hard it hit seat and head."""
    sensor, segment = HEAD_COLUMN
    return {
        "at_s": 1e-9 * shock.peak_ns,
        "seat_mps2": shock.seat_mps2,
        "seat_lower_bound": _at_least(SEAT, sensors),
        "head_measured_mps2": finite(float(shock.measured_mps2[sensor])),
        "head_lower_bound": _at_least(HEAD, sensors),
        "head_predicted_mps2": finite(float(shock.predicted_mps2[segment])),
    }


def _strip(bins: Bins) -> dict[str, Any]:
    """Bins with their beginnings in seconds, columns by channel; None where a channel gave nothing."""
    return {
        "begin_s": (1e-9 * bins.begins_ns).round(1).tolist(),
        "low": [[finite(value) for value in row] for row in bins.low_mps2.round(3).tolist()],
        "high": [[finite(value) for value in row] for row in bins.high_mps2.round(3).tolist()],
    }
