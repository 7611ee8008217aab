"""Drawings over frequency: transmissibility with its coherence, spectra, apparent mass and impedance, the waterfall.

Measured is drawn solid, predicted dashed, the linear model dash-dotted; a line is thin where the coherence is too low.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import HEAD, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.signals.waterfall import Waterfall
from biodyn_ros.base.wording import words
from biodyn_ros.reports.drawing import (
    BAND_COLOUR,
    DASHED,
    DOTTED,
    MEASURED_COLOUR,
    OTHER_COLOUR,
    PREDICTED_COLOUR,
    SOFT_COLOUR,
    drawn,
    say,
)

Document = dict[str, Any]

DASH_DOTTED: Final = (0, (6.0, 1.5, 1.0, 1.5))

_STYLES: Final[dict[str, Any]] = {
    "measured": {"color": MEASURED_COLOUR, "lw": 1.7},
    "predicted": {"color": PREDICTED_COLOUR, "lw": 1.3, "ls": DASHED},
    "linear": {"color": OTHER_COLOUR, "lw": 0.9, "ls": DASH_DOTTED},
}
_WIDTH_IN: Final = 10.4
_TICKS_HZ: Final = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100)
_FEW_TICKS_HZ: Final = (0.2, 1, 5, 20, 50)
_FREQUENCY: Final = "frequency, Hz"
_STEP_DB: Final = 6.0
_LEVELS: Final = 8


def transmissibility(document: Document, least_coherence: float) -> Any:
    """Seat to every segment, two panels each: magnitude above, coherence below."""
    frequency_hz = _values(document["spectra"]["frequency_hz"])
    found = document["transmissibility"]
    names = [name for name in reversed(SEGMENTS) if name in found]
    span = _decades([of[side]["magnitude"] for of in found.values() for side in of if of[side]])

    def fill(figure: Any) -> None:
        rows = -(-len(names) // 3)
        outer = figure.add_gridspec(rows, 3)
        for place, name in enumerate(names):
            inner = outer[place // 3, place % 3].subgridspec(2, 1, height_ratios=(2.4, 1), hspace=0.0)
            upper, lower = figure.add_subplot(inner[0]), figure.add_subplot(inner[1])
            least = max(least_coherence, document["spectra"]["chance_coherence"][name])
            _transmitted(upper, lower, frequency_hz, found[name], least)
            upper.set_ylim(*span)
            upper.set_title(words(name), loc="left", fontweight="bold")
            upper.tick_params(labelbottom=False)
            if place % 3 == 0:
                upper.set_ylabel("|segment / seat|, no unit", color=SOFT_COLOUR)
                lower.set_ylabel("coherence", color=SOFT_COLOUR)
            lower.set_xlabel(_FREQUENCY, color=SOFT_COLOUR)

    return drawn(_WIDTH_IN, 3.5 * -(-len(names) // 3), fill)


def powers(document: Document) -> Any:
    """Amplitude spectrum and power spectral density of the seat and every segment, one column each."""
    frequency_hz = _values(document["spectra"]["frequency_hz"])
    power = document["power_spectral_density"]
    names = [SEAT, *(name for name in SEGMENTS if name in power)]
    kinds = (("amplitude_mps2", "amplitude, m/s²", "linear"), ("psd_mps2_squared_per_hz", "PSD, (m/s²)²/Hz", "log"))

    def fill(figure: Any) -> None:
        grid = figure.add_gridspec(2, len(names))
        for row, (key, label, scale) in enumerate(kinds):
            for column, name in enumerate(names):
                axes = figure.add_subplot(grid[row, column])
                for side, of in power[name].items():
                    values = _values(of[key])
                    axes.plot(frequency_hz, np.where(values > 0.0, values, np.nan), **_STYLES[side])
                axes.set_yscale(scale)
                _frequency_axis(axes, frequency_hz, _FEW_TICKS_HZ)
                if not power[name]:
                    say(axes, "not measured")
                if row == 0:
                    axes.set_title(words(name), loc="left", fontweight="bold")
                    if "predicted" in power[name] and "measured" not in power[name]:
                        axes.set_xlabel("not measured", color=SOFT_COLOUR, fontsize=7.0)
                    axes.set_ylim(bottom=0.0)
                    axes.tick_params(labelbottom=False)
                else:
                    axes.set_xlabel("Hz", color=SOFT_COLOUR)
                if column == 0:
                    axes.set_ylabel(label, color=SOFT_COLOUR)

    return drawn(_WIDTH_IN, 4.3, fill)


def driving_point(document: Document) -> Any:
    """Seat to head, apparent mass and impedance, one row each: magnitudes on the left, phases on the right."""

    def fill(figure: Any) -> None:
        grid = figure.add_gridspec(3, 2)
        head, *point = [[figure.add_subplot(grid[row, column]) for column in range(2)] for row in range(3)]
        _seat_to_head(head, document)
        _driving_point(point, document)
        titles = ("seat to head", "apparent mass of the body", "impedance of the body")
        labels = ("|head / seat|, no unit", "|force / acceleration|, kg", "|force / velocity|, N s/m")
        for pair, title, label in zip((head, *point), titles, labels, strict=True):
            _frame(pair, title, label, _values(document["spectra"]["frequency_hz"]))

    return drawn(_WIDTH_IN, 8.2, fill)


def waterfall(
    found: Waterfall, channels: Sequence[tuple[str, int]], origin_ns: int, since: str = "the first predicted instant"
) -> Any:
    """Power over time and frequency of channels (title, column), one panel each, with a common scale.

    since: the instant at origin_ns, for the axis.
    """
    width_s = 1e-9 * found.width_ns
    numbers = (found.begins_ns - found.begins_ns[0]) // found.width_ns
    begin_s = 1e-9 * float(found.begins_ns[0] - origin_ns)
    size = int(numbers[-1]) + 1
    step_hz = float(found.frequency_hz[1] - found.frequency_hz[0])
    edges = (
        begin_s,
        begin_s + size * width_s,
        found.frequency_hz[0] - step_hz / 2,
        found.frequency_hz[-1] + step_hz / 2,
    )
    levels = _levels(found.density[:, :, [column for _, column in channels]])

    def fill(figure: Any) -> None:
        from matplotlib.colors import BoundaryNorm

        grid = figure.add_gridspec(len(channels), 1)
        every, drawing = [], None
        for row, (title, column) in enumerate(channels):
            axes = figure.add_subplot(grid[row])
            picture = np.full((found.frequency_hz.size, size), np.nan)
            picture[:, numbers] = _decibels(found.density[:, :, column]).T
            drawing = axes.imshow(
                np.ma.masked_invalid(picture), origin="lower", aspect="auto", extent=edges, cmap="YlOrBr",
                norm=BoundaryNorm(levels, 256, extend="both"), interpolation="none",
            )  # fmt: skip
            axes.set_title(title, loc="left", fontweight="bold")
            axes.set_ylabel(_FREQUENCY, color=SOFT_COLOUR)
            axes.patch.set(hatch="////", edgecolor=BAND_COLOUR)  # visible where nothing is drawn
            axes.grid(visible=False)
            every.append(axes)
        every[-1].set_xlabel(f"seconds since {since}", color=SOFT_COLOUR)
        label = "power, dB re 1 (m/s²)²/Hz"
        figure.colorbar(drawing, ax=every, label=label, format="%.0f", ticks=levels, pad=0.01, aspect=30)

    return drawn(_WIDTH_IN, 0.6 + 2.0 * len(channels), fill)


def residual_channels(name: str) -> list[tuple[str, int]]:
    """A measured segment and its residual, as channels of a waterfall of all measured segments and all residuals."""
    column = MEASURED_SEGMENTS.index(name)
    return [
        (f"{words(name)}, measured", column),
        (f"{words(name)}, predicted minus measured", column + len(MEASURED_SEGMENTS)),
    ]


# --- panels ----------------------------------------------------------------------------------------------------------


def _transmitted(upper: Any, lower: Any, frequency_hz: Floats, found: Document, least: float) -> None:
    """One segment's magnitude and coherence; thin below the least coherence."""
    measured = found["measured"]
    reliable = None if measured is None else _values(measured["coherence"]) > least
    for side in ("measured", "predicted", "linear"):
        if found[side] is not None:
            _line(upper, frequency_hz, found[side]["magnitude"], reliable, side)
    for side in ("measured", "predicted"):
        if found[side] is not None:
            lower.plot(frequency_hz, _values(found[side]["coherence"]), **_STYLES[side])
    if measured or found["predicted"]:
        lower.axhline(least, color=SOFT_COLOUR, lw=0.8, ls=DOTTED)
    upper.set_yscale("log")
    lower.set_ylim(0.0, 1.08)
    lower.set_yticks((0.0, 0.5, 1.0))
    for axes in (upper, lower):
        _frequency_axis(axes, frequency_hz)
    if measured is None and found["predicted"] is None:
        say(upper, "not measured")
    elif measured is None:
        _note_missing(upper, "not measured")


def _seat_to_head(pair: Sequence[Any], document: Document) -> None:
    """Magnitude and phase of the head over the seat, measured, predicted and of the linear model."""
    frequency_hz, found = _values(document["spectra"]["frequency_hz"]), document["transmissibility"][HEAD]
    reliable = _reliable(found, "measured", document)
    for axes, key in zip(pair, ("magnitude", "phase_deg"), strict=True):
        for side in ("measured", "predicted", "linear"):
            if found[side] is not None:
                _line(axes, frequency_hz, found[side][key], reliable, side, phase=key == "phase_deg")
    if found["measured"] is None:
        _note_missing(pair[0], "head not measured")


def _driving_point(pairs: Sequence[Sequence[Any]], document: Document) -> None:
    """Magnitude and phase of apparent mass and impedance, unless forces are refused."""
    frequency_hz, point = _values(document["spectra"]["frequency_hz"]), document["driving_point"]
    if "refused" in point:
        for axes in (axes for pair in pairs for axes in pair):
            say(axes, "refused, see below")
        return
    reliable = _reliable(point, "predicted", document)
    rows = (("apparent_mass_kg", "phase_deg"), ("impedance_n_s_per_m", "impedance_phase_deg"))
    for pair, keys in zip(pairs, rows, strict=True):
        for axes, key in zip(pair, keys, strict=True):
            for side in ("predicted", "linear"):
                _line(axes, frequency_hz, point[side][key], reliable, side, phase=key.endswith("phase_deg"))
    _masses(pairs[0][0], point)


def _frame(pair: Sequence[Any], title: str, label: str, frequency_hz: Floats) -> None:
    """Title, labels and axes of a magnitude and its phase."""
    magnitude, phase = pair
    magnitude.set_title(title, loc="left", fontweight="bold")
    magnitude.set_ylabel(label, color=SOFT_COLOUR)
    phase.set_ylabel("phase, degrees", color=SOFT_COLOUR)
    phase.set_ylim(-190.0, 190.0)
    phase.set_yticks((-180, -90, 0, 90, 180))
    for axes in pair:
        _frequency_axis(axes, frequency_hz)
        axes.set_xlabel(_FREQUENCY, color=SOFT_COLOUR)
    magnitude.set_ylim(bottom=0.0)


def _line(
    axes: Any,
    frequency_hz: Floats,
    values: Sequence[float | None],
    reliable: Flags | None,
    side: str,
    phase: bool = False,
) -> None:
    """A line, thin where it is not reliable; full for `reliable` None and for the linear model."""
    whole, style = _values(values), _STYLES[side]
    if phase:
        whole = _unwound(whole)
    if reliable is None or side == "linear":
        axes.plot(frequency_hz, whole, **style)
        return
    axes.plot(frequency_hz, whole, **style | {"lw": 0.6})
    if reliable.any():
        axes.plot(frequency_hz, np.where(reliable, whole, np.nan), **style)
    alone = reliable & ~np.append(reliable[1:], False) & ~np.append(False, reliable[:-1])  # a point is no line
    if alone.any():
        axes.plot(frequency_hz[alone], whole[alone], ls="none", marker=".", ms=4.0, color=style["color"])


def _reliable(of: Document, side: str, document: Document) -> Flags | None:
    """Frequencies at which the coherence of the measured head, or of the predicted force, is sufficient."""
    if of[side] is None:
        return None
    chance = of[side].get("chance_coherence", document["spectra"]["chance_coherence"][HEAD])
    return np.asarray(_values(of[side]["coherence"]) > max(chance, document["limits"]["least_coherence"]))


def _masses(axes: Any, point: Document) -> None:
    """The apparent mass at rest, and the paper's printed band of its peak."""
    body, upper = point["body_mass_kg"], point["upper_body_mass_kg"]
    axes.axhspan(*(share * body for share in point["printed_band"]), color="#eef1f4", zorder=0)
    axes.axhline(upper, color=SOFT_COLOUR, lw=0.8, ls=DOTTED)
    secondary = axes.secondary_yaxis("right", functions=(lambda kg: kg / body, lambda share: share * body))
    secondary.set_ylabel("over body mass, no unit", color=SOFT_COLOUR)


def _frequency_axis(axes: Any, frequency_hz: Floats, ticks_hz: Sequence[float] = _TICKS_HZ) -> None:
    """A logarithmic axis with few ticks, because each takes time to draw."""
    from matplotlib.ticker import NullLocator

    axes.set_xscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
    first, last = float(frequency_hz[0]), float(frequency_hz[-1])
    shown = [tick for tick in ticks_hz if first <= tick * 1.001 and tick * 0.999 <= last]
    axes.set_xticks(shown, [f"{tick:g}" for tick in shown])
    axes.set_xlim(min([first, *shown]), max([last, *shown]))
    axes.tick_params(length=2.5, width=0.6)


def _note_missing(axes: Any, text: str) -> None:
    """Note a missing line in a panel."""
    axes.set_title(text, loc="right", color=SOFT_COLOUR, fontsize=7.5)


def _decades(of: Sequence[Sequence[float | None]]) -> tuple[float, float]:
    """Whole decades around all values, three at most, as a common scale of all panels."""
    known = np.array([value for values in of for value in values if value])
    if not known.size:
        return 0.1, 10.0
    upper = math.ceil(math.log10(known.max()) - 1e-9)
    lower = max(math.floor(math.log10(known.min())), upper - 3)
    return 10.0**lower, 10.0 ** max(upper, lower + 1)


def _unwound(phase_deg: Floats) -> Floats:
    """NaN where a phase wraps, so that no line crosses the panel."""
    apart = np.append(False, np.abs(np.diff(phase_deg)) > 180.0)
    return np.where(apart, np.nan, phase_deg)


def _decibels(density: Floats) -> Floats:
    return np.asarray(10.0 * np.log10(np.maximum(density, 1e-300)))


def _levels(density: Floats) -> Floats:
    """Edges of the colour levels: the largest and seven steps below; lower values have the lightest colour."""
    known = density[np.isfinite(density)]
    most = float(known.max()) if known.size else 1.0
    top = _STEP_DB * np.ceil(10.0 * np.log10(max(most, 1e-12)) / _STEP_DB)
    return np.asarray(top + _STEP_DB * np.arange(-_LEVELS, 1.0))


def _values(of: Sequence[float | None]) -> Floats:
    return np.array([np.nan if value is None else value for value in of])
