"""Drawings of the residual before and after, over time and frequency, for the pages of fit and trace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.signals.response import SAME_RATE, cross_spectra
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_core.tracing.findings import ComparedEvent
from biodyn_ros.base.wording import words
from biodyn_ros.reports.drawing import MEASURED_COLOUR, OTHER_COLOUR, PREDICTED_COLOUR, SOFT_COLOUR, drawn, say

BEFORE_COLOUR: Final = PREDICTED_COLOUR
AFTER_COLOUR: Final = OTHER_COLOUR
BEFORE_DASHES: Final = (0, (3.0, 1.2))
"""Dashes, because colours alone are not sufficient."""

SHOWN_S: Final = 1.2
"""Time drawn around the strongest instant of an event."""

_WINDOW_S: Final = 0.25
_MAX_HZ: Final = 50.0
_WIDTH_IN: Final = 10.4


def over_time(event: ComparedEvent) -> Any:
    """One event around its strongest instant: two panels per segment, signals above and residuals below."""
    begin, end = _shown(event)
    seconds = np.arange(begin, end) / event.rate_hz

    def fill(figure: Any) -> None:
        outer = figure.add_gridspec(3, 2)
        for place, name in enumerate(reversed(MEASURED_SEGMENTS)):
            column = MEASURED_SEGMENTS.index(name)
            inner = outer[place // 2, place % 2].subgridspec(2, 1, height_ratios=(2, 1), hspace=0.0)
            upper, lower = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
            _signals(upper, lower, seconds, *(values[begin:end, column] for values in _of(event)))
            upper.set_title(words(name), loc="left", fontweight="bold")
            lower.set_xlabel("s since the start of the event", color=SOFT_COLOUR)
        _whole(figure.add_subplot(outer[2, 1]), event, begin, end)
        figure.supylabel("vertical acceleration; below, model minus measured; m/s²", fontsize=8.0, color=SOFT_COLOUR)

    return drawn(_WIDTH_IN, 9.2, fill)


def over_frequency(events: Sequence[ComparedEvent]) -> Any | None:
    """Power of the measurement and both residuals per segment, over `of_spectra` of the events; None if too short."""
    from matplotlib.ticker import NullLocator

    spectra = residual_spectra(events)
    if spectra is None:
        return None
    frequency_hz, power = spectra

    def fill(figure: Any) -> None:
        grid = figure.add_gridspec(1, len(MEASURED_SEGMENTS))
        for column, name in enumerate(MEASURED_SEGMENTS):
            axes = figure.add_subplot(grid[column])
            measured, before, after = power[:, :, column]
            axes.loglog(frequency_hz, measured, color=MEASURED_COLOUR, lw=1.7)
            axes.loglog(frequency_hz, before, color=BEFORE_COLOUR, lw=1.1, ls=BEFORE_DASHES)
            axes.loglog(frequency_hz, after, color=AFTER_COLOUR, lw=1.1)
            axes.set_title(words(name), loc="left", fontweight="bold")
            axes.set_xlabel("Hz", color=SOFT_COLOUR)
            axes.set_xticks([2, 5, 10, 20, 50], ["2", "5", "10", "20", "50"])
            axes.set_xlim(min(frequency_hz[0], 2.0), frequency_hz[-1])
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_minor_locator(NullLocator())  # each tick takes time to draw
            axes.tick_params(length=2.5, width=0.6)
            if not np.isfinite(power[:, :, column]).any():
                say(axes, "not compared")
        figure.supylabel("power spectral density, (m/s²)²/Hz", fontsize=8.0, color=SOFT_COLOUR)

    return drawn(_WIDTH_IN, 2.6, fill)


def of_spectra(events: Sequence[ComparedEvent]) -> list[ComparedEvent]:
    """The events of the spectra: in which no model diverges, with the rate of the first one.

    A model without an answer in an event has less power there than the measurement and the other model.
    """
    return _of_one_rate(stable_events(events))


def stable_events(events: Sequence[ComparedEvent]) -> list[ComparedEvent]:
    """The events in which no model diverges, so that it is all NaN."""
    return [event for event in events if all(np.isfinite(model).any() for model in _of(event)[1:])]


def _of_one_rate(events: Sequence[ComparedEvent]) -> list[ComparedEvent]:
    """The events with the rate of the first one, because a spectrum needs a common rate."""
    return [event for event in events if abs(event.rate_hz / events[0].rate_hz - 1.0) < SAME_RATE]


def residual_spectra(events: Sequence[ComparedEvent]) -> tuple[Floats, Floats] | None:
    """Frequencies (f,) and densities (3, f, 5) of measured, residual before and after, (m/s^2)^2/Hz; None if short."""
    events = of_spectra(events)
    if not events:
        return None
    rate_hz = events[0].rate_hz
    settings = SpectrumSettings(segment_s=1.0, lowest_hz=2.0, highest_hz=min(_MAX_HZ, 0.45 * rate_hz))
    parts = []
    for event in events:
        measured, before, after = _of(event)
        # The input is not used: only the output spectra are needed.
        parts.append((np.zeros(len(measured)), np.hstack([measured, before - measured, after - measured])))
    try:
        spectra = cross_spectra(parts, rate_hz, settings)
    except InputError:
        return None
    density = spectra.output_psd.reshape(-1, 3, len(MEASURED_SEGMENTS)).transpose(1, 0, 2)
    return spectra.frequency_hz, np.where(density > 0.0, density, np.nan)


def _of(event: ComparedEvent) -> tuple[Floats, Floats, Floats]:
    return event.measured_mps2, event.before_mps2, event.after_mps2


def _shown(event: ComparedEvent) -> tuple[int, int]:
    """First and last sample around the largest value, or all of a shorter event."""
    size = np.nan_to_num(np.abs(event.measured_mps2)).max(axis=1)
    length = min(round(SHOWN_S * event.rate_hz), size.size)
    begin = min(max(int(size.argmax()) - length // 2, 0), size.size - length)
    return begin, begin + length


def _signals(upper: Any, lower: Any, seconds: Floats, measured: Floats, before: Floats, after: Floats) -> None:
    upper.plot(seconds, measured, color=MEASURED_COLOUR, lw=2.6)
    upper.plot(seconds, before, color=BEFORE_COLOUR, lw=0.9, ls=BEFORE_DASHES)
    upper.plot(seconds, after, color=AFTER_COLOUR, lw=0.9)
    lower.plot(seconds, before - measured, color=BEFORE_COLOUR, lw=0.9, ls=BEFORE_DASHES)
    lower.plot(seconds, after - measured, color=AFTER_COLOUR, lw=0.9)
    for axes in (upper, lower):
        axes.set_xlim(seconds[0], seconds[-1] + 1e-3)
        axes.tick_params(length=2.5, width=0.6)
    upper.tick_params(labelbottom=False)
    if not np.isfinite(measured).any():
        lower.set_yticks([])
        say(upper, "not compared")


def _whole(axes: Any, event: ComparedEvent, begin: int, end: int) -> None:
    """Residual over the whole event: rms in short windows over segments, percent of each segment's rms."""
    seconds, before, after = windowed(event)
    axes.plot(seconds, before, color=BEFORE_COLOUR, lw=1.1, ls=BEFORE_DASHES)
    axes.plot(seconds, after, color=AFTER_COLOUR, lw=1.1)
    axes.axvspan(begin / event.rate_hz, end / event.rate_hz, color="#eef1f4", zorder=0)
    axes.set_title("whole event, all segments", loc="left", fontweight="bold")
    axes.set_ylabel("residual, % of rms", color=SOFT_COLOUR)
    axes.set_xlabel("s since the start of the event", color=SOFT_COLOUR)
    axes.set_xlim(0.0, len(event.measured_mps2) / event.rate_hz)
    axes.set_ylim(bottom=0.0)


def windowed(event: ComparedEvent) -> tuple[Floats, Floats, Floats]:
    """Centres of windows (w,) in s, and rms of the residual before and after in each, percent of measured rms, (w,)."""
    measured, before, after = _of(event)
    length = max(1, min(round(_WINDOW_S * event.rate_hz), len(measured)))
    count = len(measured) // length
    scale = np.array([_rms(column) for column in measured.T])
    rows = []
    for model in (before, after):
        share = (model - measured) / np.where(scale > 0.0, scale, np.nan)
        rows.append(np.array([100.0 * _rms(share[i * length : (i + 1) * length]) for i in range(count)]))
    return (np.arange(count) + 0.5) * length / event.rate_hz, rows[0], rows[1]


def _rms(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(known**2))) if known.size else math.nan
