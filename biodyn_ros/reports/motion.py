"""Drawings of motion over time: the strongest event at full rate, and the envelope of a whole record."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from biodyn_core.base.arrays import Floats, Integers
from biodyn_core.base.segments import SEAT, SEGMENTS, SENSORS
from biodyn_core.validation.validation import SegmentError
from biodyn_ros.base.wording import number, words
from biodyn_ros.reports.drawing import (
    BAND_COLOUR,
    DASHED,
    DOTTED,
    MEASURED_COLOUR,
    PREDICTED_COLOUR,
    SOFT_COLOUR,
    drawn,
)
from biodyn_ros.reports.exposure_report import Residual

EVENT_HALF_NS: Final = 1_000_000_000
"""Time drawn on either side of the strongest instant of an event."""

_PANELS: Final = (*reversed(SEGMENTS), SEAT)
"""Two columns from the head down, the seat at the bottom over the full width."""


class Envelope(NamedTuple):
    """Smallest and largest value per bin.

    begins_ns (m,) ascending, low_mps2 and high_mps2 (m, 6), NaN without a sample.
    """

    width_ns: int
    begins_ns: Integers
    low_mps2: Floats
    high_mps2: Floats


@dataclass(frozen=True)
class StrongestEvent:
    """Full-rate samples around the largest measured |acceleration| of seat or head: `peak_mps2`, at `peak_ns`.

    predicted_mps2 (n, 6) by segment at predicted_ns (n,), measured_mps2 (m, 6) by sensor at measured_ns (m,).
    """

    sensor: str
    peak_ns: int
    peak_mps2: float
    predicted_ns: Integers
    predicted_mps2: Floats
    measured_ns: Integers
    measured_mps2: Floats


def overlay(event: StrongestEvent, origin_ns: int, residuals: Mapping[str, Residual | SegmentError | None]) -> Any:
    """Measured and predicted at full rate around the strongest event, one panel per segment and one for the seat."""

    def draw(axes: Any, name: str) -> None:
        measured = event.measured_mps2[:, SENSORS.index(name)] if name in SENSORS else None
        predicted = event.predicted_mps2[:, SEGMENTS.index(name)] if name in SEGMENTS else None
        extent = _extent(measured, predicted)
        if measured is not None:
            axes.plot(*_line(event.measured_ns, measured, origin_ns), color=MEASURED_COLOUR, lw=1.7)
        if predicted is not None:
            clipped = np.clip(predicted, -10.0 * extent, 10.0 * extent)
            axes.plot(*_line(event.predicted_ns, clipped, origin_ns), color=PREDICTED_COLOUR, lw=1.3, ls=DASHED)
        axes.set_ylim(-extent, extent)
        axes.set_title(_note(name, measured, residuals.get(name)), loc="right", color=SOFT_COLOUR, fontsize=8.0)

    return _draw(draw, 7.4, _seconds(event.measured_ns, origin_ns))


def envelopes(predicted: Envelope, measured: Envelope, event: StrongestEvent | None, origin_ns: int) -> Any:
    """Smallest and largest value per bin over the whole record."""

    def draw(axes: Any, name: str) -> None:
        there = _steps(measured, SENSORS.index(name), origin_ns) if name in SENSORS else None
        model = _steps(predicted, SEGMENTS.index(name), origin_ns) if name in SEGMENTS else None
        extent = _extent(np.stack(there[1:]) if there else None, np.stack(model[1:]) if model else None)
        if there:
            axes.fill_between(*there, color=BAND_COLOUR, lw=0.3)
            for edge in there[1:]:
                axes.plot(there[0], edge, color=MEASURED_COLOUR, lw=1.1)
        if model:
            for edge in model[1:]:
                clipped = np.clip(edge, -10.0 * extent, 10.0 * extent)
                axes.plot(model[0], clipped, color=PREDICTED_COLOUR, lw=0.9, ls=DASHED)
        axes.set_ylim(-extent, extent)
        if event is not None:
            axes.axvline(1e-9 * (event.peak_ns - origin_ns), color=SOFT_COLOUR, lw=0.8, ls=DOTTED)

    ends_ns = np.append(measured.begins_ns, measured.begins_ns[-1] + measured.width_ns)
    return _draw(draw, 6.2, _seconds(ends_ns, origin_ns))


def _draw(draw: Callable[[Any, str], None], height_in: float, times_s: Floats) -> Any:
    """Draw the panels over the span of times_s by `draw(axes, name)`, as markup."""

    def fill(figure: Any) -> None:
        grid = figure.add_gridspec(4, 2)
        for place, name in enumerate(_PANELS):
            axes = figure.add_subplot(grid[3, :] if name == SEAT else grid[place // 2, place % 2])
            draw(axes, name)
            axes.set_title(words(name), loc="left", fontweight="bold")
            axes.set_xlim(times_s.min(), times_s.max() + 1e-3)  # a single instant has no span
            axes.tick_params(length=2.5, width=0.6)
        figure.supylabel("vertical acceleration, m/s²", fontsize=8.0, color=SOFT_COLOUR)
        axes.set_xlabel("seconds since the first predicted instant", color=SOFT_COLOUR)

    return drawn(10.4, height_in, fill)


def _steps(envelope: Envelope, column: int, origin_ns: int) -> tuple[Floats, Floats, Floats]:
    """Seconds, minimum and maximum of one channel, each bin over its full width, NaN for missing bins."""
    edges_ns = np.column_stack([envelope.begins_ns, envelope.begins_ns + envelope.width_ns]).ravel()
    apart = 2 * np.flatnonzero(np.diff(envelope.begins_ns) > envelope.width_ns) + 2
    low, high = np.repeat(envelope.low_mps2[:, column], 2), np.repeat(envelope.high_mps2[:, column], 2)
    seconds = _seconds(edges_ns, origin_ns)
    return np.insert(seconds, apart, np.nan), np.insert(low, apart, np.nan), np.insert(high, apart, np.nan)


def _line(stamps_ns: Integers, values: Floats, origin_ns: int) -> tuple[Floats, Floats]:
    """Seconds and values, with a NaN at each jump of stamps, so that no line crosses a gap."""
    steps = np.diff(stamps_ns)
    period = np.median(steps) if steps.size else 0.0
    apart = np.flatnonzero((steps > 5.0 * period) | (steps < 0)) + 1
    return np.insert(_seconds(stamps_ns, origin_ns), apart, np.nan), np.insert(values, apart, np.nan)


def _extent(measured: Floats | None, predicted: Floats | None) -> float:
    """Half the height of a panel: fits the measurement, and a prediction up to three times as large."""
    largest = [
        float(np.nanmax(np.abs(v))) if v is not None and np.isfinite(v).any() else 0.0 for v in (measured, predicted)
    ]
    room = max(largest[0], min(largest[1], 3.0 * largest[0])) if largest[0] > 0.0 else min(largest[1], 1e6)
    return 1.08 * room or 1.0


def _note(name: str, measured: Floats | None, residual: Residual | SegmentError | None) -> str:
    if name == SEAT:
        return "measured: input of the model"
    if measured is None or not np.isfinite(measured).any():
        return "not measured"
    if residual is None:
        return ""
    percent = "" if residual.nrmse_rms_percent is None else f", {number(residual.nrmse_rms_percent)} %"
    return f"whole record: residual {number(residual.rms_mps2)} m/s² rms{percent}"


def _seconds(stamps_ns: Integers, origin_ns: int) -> Floats:
    return np.multiply(stamps_ns - origin_ns, 1e-9, dtype=np.float64)
