"""Snapshots: the content of the live page, four times a second, as one plain mapping of texts and numbers."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable
from dataclasses import asdict, replace
from itertools import takewhile
from typing import Any, Final
from uuid import uuid4

import numpy as np

from biodyn_core.base.quantiles import NORMAL_95
from biodyn_core.base.segments import HEAD, N_SEGMENTS, N_SENSORS, SEAT, SEGMENTS, SENSORS
from biodyn_core.body.origin import origin_of
from biodyn_core.exposure.limit_assessment import SeatExposure
from biodyn_core.exposure.limits import KINDS, LimitSet, Measure
from biodyn_core.exposure.losses import Losses
from biodyn_core.pipeline.exposure import Exposure
from biodyn_core.pipeline.frames import Frames, joined
from biodyn_core.pipeline.intervals import AccelSpread
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.shocks import Shock, Shocks
from biodyn_ros import __version__
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.wording import ORIGIN, partly_tested, words
from biodyn_ros.node.health import SILENT_AFTER_S, Mark, Status, seat_fault, silences_s
from biodyn_ros.reports.downsampling import Bins, MinMaxDownsampler
from biodyn_ros.reports.exposure_json import dri_document
from biodyn_ros.reports.exposure_report import ChannelExposure
from biodyn_ros.reports.intervals import figure_interval, force_intervals
from biodyn_ros.reports.meter import meter_readings
from biodyn_ros.reports.verdict import left, seat_verdict

LEAST_SEAT_MPS2: Final = 0.05
"""Below this weighted acceleration of the seat a transmissibility would be that of the sensors' noise."""

ROWS: Final = (*reversed(SEGMENTS), SEAT)
"""From the head down."""

HEAD_COLUMN: Final = SENSORS.index(HEAD), SEGMENTS.index(HEAD)


class SnapshotBuilder:
    """`add` every push's frames, `update` a few times a second, `snapshot` while the page is open."""

    def __init__(self, shock_mps2: float) -> None:
        self._frames: list[Frames] = []
        self._shock_mps2 = shock_mps2
        self._shocks = Shocks(shock_mps2)
        self._predicted, self._measured = MinMaxDownsampler(N_SEGMENTS), MinMaxDownsampler(N_SENSORS)
        self._bins: dict[str, Bins] = {}
        self._last_spread: AccelSpread | None = None
        self._source = uuid4().hex

    def add(self, frames: Frames) -> None:
        """Add one push's frames; they must not be written to afterwards."""
        self._frames.append(frames)

    def update(self) -> None:
        """Process the frames since the last update: shocks, and complete bins of the strip chart."""
        frames, self._frames = joined(self._frames), []
        self._shocks.push(*frames)
        self._predicted.add(*frames.predicted[:2])
        self._measured.add(frames.measured.stamps_ns, frames.measured.accel_mps2)
        self._bins = {"predicted": self._predicted.take(), "measured": self._measured.take()}

    def snapshot(self, pipeline: Pipeline, statuses: list[Status], marks: Iterable[Mark]) -> dict[str, Any]:
        """The content of the page now, finite numbers and texts alone."""
        by_name = {status.of: status for status in statuses}
        run, seat, rolling = pipeline.run_status(), pipeline.seat(), pipeline.exposure(True, silences_s(by_name))
        since, seat_losses = pipeline.exposure(), pipeline.losses(SEAT)
        channel = ChannelExposure(since.sensors[SEAT], seat_losses) if SEAT in since.sensors else None
        fault, rolling_losses = seat_fault(by_name), {name: pipeline.counter.rolling_losses(name) for name in SENSORS}
        seat_suspect_s = rolling_losses[SEAT].suspect_s  # left out of the figures of every segment
        rows_lost = {name: losses._replace(suspect_s=seat_suspect_s) for name, losses in rolling_losses.items()}
        bounds = {name for name, losses in rows_lost.items() if losses.mean_lower_bound}
        force_bound = rolling_losses[SEAT].lower_bound or run.unpredicted_s > 0.0
        extrapolated = run.is_extrapolating and seat is not None
        return {
            "version": __version__,
            "source": self._source,
            "subject": pipeline.subject.name,
            "mass_matrix": pipeline.subject.mass_matrix,
            "origin": ORIGIN[origin_of(pipeline.subject)],
            "of_group": origin_of(pipeline.subject) == "group",
            "window_s": pipeline.settings.window_s,
            "shock_mps2": self._shock_mps2,
            "limits": pipeline.limits.deciding.to_dict(),
            "seconds": run.seconds,
            "verdict": vars(seat_verdict(seat, channel and seat_losses, fault)),
            "seat": _seat(seat, pipeline.limits.deciding, seat_losses, fault) if seat else None,
            "meter": asdict(readings) if (readings := meter_readings(seat, channel)) else None,
            "rows": _rows(rolling, by_name, bounds, force_bound),
            "prediction": _status(by_name["prediction"]) | {"extrapolated": extrapolated},
            "no_interval": pipeline.no_interval or None,
            "fit": _fit(pipeline),
            "exposure": _status(by_name["exposure"]) if "exposure" in by_name else None,
            "dri": dri_document(since.dri, seat_losses.lower_bound),
            "shocks": [_shock(shock, _lowered(shock, pipeline)) for shock in self._shocks.latest()],
            "strip": {name: _strip(bins) for name, bins in self._bins.items()} | self._errors(pipeline),
            "marks": [asdict(mark) for mark in marks],
        }

    def _errors(self, pipeline: Pipeline) -> dict[str, Any]:
        """The seconds since the last snapshot with the 95 % interval of true minus predicted acceleration, as a strip.

        A second follows its bins, when it is complete.
        """
        intervals = pipeline.predictor and pipeline.predictor.intervals
        recent = list(intervals.recent) if intervals else []
        new = list(takewhile(lambda one: one is not self._last_spread, reversed(recent)))[::-1]
        if not new:
            return {}
        self._last_spread = new[-1]
        half_mps2 = NORMAL_95 * np.array([one.accel_mps2 for one in new])
        return {"error": _strip(Bins(np.array([one.begin_ns for one in new]), -half_mps2, half_mps2))}


def _status(status: Status) -> dict[str, Any]:
    return {"level": status.level, "message": status.message}


def _fit(pipeline: Pipeline) -> dict[str, Any]:
    """Whether the model fits, None while unknown; the misfits of now, why it is unknown, and what was tested."""
    lasting, unknown = pipeline.fit_monitor.lasting(), pipeline.fit_unknown
    return {
        "fits": None if unknown else not lasting,
        "misfits": [
            {"name": words(one.segment), "since_s": 1e-9 * one.begin_ns, "ratio": one.ratio} for one in lasting
        ],
        "unknown": unknown,
        "tested": partly_tested(pipeline.fit_monitor.tested),
    }


def _seat(seat: SeatExposure, limits: LimitSet, losses: Losses, fault: str) -> dict[str, Any]:
    """The seat against its limits: both measures with their values, the governing one, and the time left in words.

    The time left is withheld during a fault.
    """
    seat = replace(seat, withheld=fault) if fault else seat
    action, limit = limits.values("action"), limits.values("limit")
    figures: tuple[tuple[Measure, str, str, float, str], ...] = (
        ("a8", "A(8)", "m/s^2", seat.a8_so_far_mps2, seat.a8_axis),
        ("vdv", "VDV", "m/s^1.75", seat.vdv_so_far_mps175, seat.vdv_axis),
    )
    return {
        "figures": [
            {
                "name": name, "unit": unit, "so_far": so_far, "axis": words(axis), "governs": seat.governing == measure,
                "action": action.get(measure), "limit": limit.get(measure),
            }
            for measure, name, unit, so_far, axis in figures
        ],
        "lower_bound": seat.lower_bound,
        "counted_s": seat.seconds,
        "missing_s": losses.missing_s,
        "suspect_s": seat.suspect_s,
        "left": {kind: left(kind, seat) for kind in KINDS},
    }  # fmt: skip


def _rows(
    rolling: Exposure, statuses: dict[str, Status], lower_bounds: Container[str], force_lower_bound: bool
) -> list[dict[str, Any]]:
    """From the head down: weighted acceleration of the window, measured and predicted, and each sensor's status.

    Both figures of a segment, their ratios to the seat and the residual are over the same samples. The peaks of force
    are of the joint below the segment. Intervals are 95 %. lower_bounds: the sensors whose means are lower bounds;
    force_lower_bound: whether peaks of force are, which missing samples lower too.
    """
    rows = []
    for name in ROWS:
        found, model, seat_mps2, settles = _compared_mps2(rolling, name)
        rms_mps2, percent = rolling.residual.get(name, (None, None))
        force, spread = rolling.joint_forces.get(name), rolling.spreads.get(name)
        rows.append(
            {
                "name": words(name),
                "measured_mps2": found,
                "measured_lower_bound": name in lower_bounds or settles,
                "predicted_mps2": model,
                "predicted_lower_bound": SEAT in lower_bounds or settles,
                "predicted_interval_mps2": figure_interval(model, spread.accel.of_means) if model and spread else None,
                "measured_ratio": _ratio(found, seat_mps2) if name != SEAT else None,
                "predicted_ratio": _ratio(model, seat_mps2),
                "compression_n": force.compression_n if force else None,
                "compression_interval_n": force_intervals(force, spread).compression_interval_n if force else None,
                "tension_n": force.tension_n if force else None,
                "force_lower_bound": force_lower_bound,
                "residual_mps2": rms_mps2,
                "residual_percent": percent if percent is not None and math.isfinite(percent) else None,
                "measured_column": SENSORS.index(name) if name in SENSORS else None,
                "predicted_column": SEGMENTS.index(name) if name in SEGMENTS else None,
                "sensor": _sensor(statuses[name]) if name in SENSORS else None,
            }
        )
    return rows


def _compared_mps2(rolling: Exposure, name: str) -> tuple[float | None, float | None, float, bool]:
    """Weighted acceleration measured and predicted (None: unknown), and of the seat over the same samples, m/s^2.

    The last value is whether they contain the time of samples that are in no figure, because a weighting settles.
    """
    if name == SEAT:
        dose = rolling.measured_low_passed.get(SEAT)
        return (dose.aw_mps2, None, dose.aw_mps2, dose.left_out_s > 0.0) if dose else (None, None, 0.0, False)
    if name not in rolling.compared:
        return None, None, 0.0, False
    measured, predicted, seat = rolling.compared[name]
    return measured.aw_mps2 if measured else None, predicted.aw_mps2, seat.aw_mps2, predicted.left_out_s > 0.0


def _sensor(status: Status) -> dict[str, Any]:
    """A sensor's status, with rate and lag while it sends."""
    values = status.values
    sends = bool(values["silent_s"]) and float(values["silent_s"]) <= SILENT_AFTER_S
    numbers = {key: float(values[key]) if values[key] and sends else None for key in ("rate_hz", "lag_ms")}
    return _status(status) | numbers


def _ratio(figure: float | None, seat_mps2: float) -> float | None:
    return None if figure is None or seat_mps2 < LEAST_SEAT_MPS2 else figure / seat_mps2


def _lowered(shock: Shock, pipeline: Pipeline) -> set[str]:
    """The sensors whose peaks of a shock are lower bounds; one before the last reset has the losses before it."""
    counter = pipeline.counter
    is_before = counter.reset_ns is not None and shock.begin_ns < counter.reset_ns
    found = {name: counter.lost_before_reset[name] if is_before else pipeline.losses(name) for name in SENSORS}
    return {name for name, losses in found.items() if losses.with_suspect().mean_lower_bound}


def _shock(shock: Shock, lower_bounds: Container[str]) -> dict[str, Any]:
    """A shock: its time, and the peaks of seat and head."""
    sensor, segment = HEAD_COLUMN
    return {
        "at_s": 1e-9 * shock.peak_ns,
        "seat_mps2": shock.seat_mps2,
        "seat_lower_bound": SEAT in lower_bounds,
        "head_measured_mps2": finite(float(shock.measured_mps2[sensor])),
        "head_lower_bound": HEAD in lower_bounds,
        "head_predicted_mps2": finite(float(shock.predicted_mps2[segment])),
    }


def _strip(bins: Bins) -> dict[str, Any]:
    """Bins with their begin in seconds, columns by channel; None where a channel has no value."""
    return {
        "begin_s": (1e-9 * bins.begins_ns).round(1).tolist(),
        "low": [[finite(value) for value in row] for row in bins.low_mps2.round(3).tolist()],
        "high": [[finite(value) for value in row] for row in bins.high_mps2.round(3).tolist()],
    }
