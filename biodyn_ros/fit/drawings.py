"""Drawings of a fit's page and of a campaign's: estimates within Table 1, their correlation, their profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from biodyn_core.body.parameters import PARAMETERS, Parameters
from biodyn_core.identification.profiles import Profile
from biodyn_core.identification.uncertainty import Estimate, Uncertainty
from biodyn_ros.base.wording import number, parameter_name, with_interval
from biodyn_ros.reports.drawing import MEASURED_COLOUR, OTHER_COLOUR, PREDICTED_COLOUR, SOFT_COLOUR, drawn

ESTIMATE_COLOUR: Final = OTHER_COLOUR
RANGE_COLOUR: Final = "#d5dce2"
MARKERS: Final[dict[str, Any]] = {
    "identifiable": {"marker": "o", "markerfacecolor": ESTIMATE_COLOUR},
    "weakly identifiable": {"marker": "D", "markerfacecolor": "#a5d0f5"},
    "not identifiable": {"marker": "o", "markerfacecolor": "white"},
    "from the prior": {"marker": "^", "markerfacecolor": "white"},
    "on its bound": {"marker": "s", "markerfacecolor": PREDICTED_COLOUR, "markeredgecolor": PREDICTED_COLOUR},
}
"""The marker of each degree; shape and filling differ as well as colour."""

LABELLED_CORRELATION: Final = 0.5
"""Cells with at least this correlation show their number."""

_WIDTH_IN: Final = 10.4
_PLACE: Final = "place between the bounds of Table 1, logarithmic, no unit"
_PARAMETERS: Final = {parameter.name: parameter for parameter in PARAMETERS}


def place(name: str, value: float) -> float:
    """The position of a value between the bounds of Table 1, 0 to 1, logarithmic."""
    parameter = _PARAMETERS[name]
    return math.log(max(value, 1e-300) / parameter.lower) / math.log(parameter.upper / parameter.lower)


def intervals(estimates: Sequence[Estimate], singles: Sequence[Parameters]) -> Any:
    """Estimates of the joint fit with their 95 % intervals, and those of single cases beneath as ticks."""
    by_name = [dict(zip(_PARAMETERS, parameters.vector().tolist(), strict=True)) for parameters in singles]

    def fill(figure: Any) -> None:
        axes = figure.add_subplot()
        for row, estimate in enumerate(estimates):
            name, parameter = estimate.name, _PARAMETERS[estimate.name]
            axes.plot([0.0, 1.0], [row, row], color=RANGE_COLOUR, lw=5.0, solid_capstyle="butt", zorder=1)
            for values in by_name:
                at = min(max(place(name, values[name]), 0.0), 1.0)
                axes.plot([at, at], [row + 0.12, row + 0.42], color=MEASURED_COLOUR, lw=0.9)
            _interval(axes, estimate, row)
            axes.text(-0.01, row, f"{parameter.lower:g}", ha="right", va="center", fontsize=7, color=SOFT_COLOUR)
            axes.text(1.01, row, f"{parameter.upper:g}", ha="left", va="center", fontsize=7, color=SOFT_COLOUR)
            axes.text(1.08, row, _label(estimate), va="center", fontsize=7.5)
        axes.set_yticks(range(len(estimates)), [parameter_name(estimate.name) for estimate in estimates])
        axes.set_ylim(len(estimates) - 0.3, -0.7)
        axes.set_xlim(-0.11, 1.66)
        axes.set_xticks((0.0, 0.25, 0.5, 0.75, 1.0))
        axes.set_xlabel(_PLACE, color=SOFT_COLOUR, loc="left")
        axes.grid(visible=False, axis="y")
        axes.tick_params(length=2.5, width=0.6)

    return drawn(_WIDTH_IN, 0.6 + 0.31 * len(estimates), fill)


def correlation(found: Uncertainty) -> Any | None:
    """Correlation of the estimates, the lower triangle; None for a single one."""
    names = found.names
    if len(names) < 2:
        return None
    matrix = found.correlation[1:, :-1]

    def fill(figure: Any) -> None:
        from matplotlib.colors import BoundaryNorm

        axes = figure.add_subplot()
        below = np.tril(np.ones(matrix.shape, dtype=bool))
        levels = BoundaryNorm(np.linspace(-1.0, 1.0, 9), 256)
        drawing = axes.imshow(np.ma.masked_where(~below, matrix), cmap="PuOr", norm=levels, interpolation="none")
        for row, column in np.argwhere(below & (np.abs(matrix) >= LABELLED_CORRELATION)).tolist():
            axes.text(column, row, f"{matrix[row, column]:+.2f}", ha="center", va="center", fontsize=6.5, color="white")
        short = [parameter_name(name) for name in names]
        axes.set_xticks(range(len(names) - 1), short[:-1], rotation=55, ha="right", rotation_mode="anchor", fontsize=7)
        axes.set_yticks(range(len(names) - 1), short[1:], fontsize=7)
        axes.grid(visible=False)
        axes.tick_params(length=0.0)
        label = "correlation of the estimates' logarithms, no unit"
        figure.colorbar(drawing, ax=axes, label=label, format="%.2f", ticks=np.linspace(-1.0, 1.0, 9), shrink=0.8)

    return drawn(8.4, 1.6 + 0.33 * len(names), fill)


def profiles(found: Sequence[Profile]) -> Any | None:
    """The profile likelihood of every profiled parameter with its 95 % threshold; None without profiles."""
    if not found:
        return None
    rows = -(-len(found) // 3)

    def fill(figure: Any) -> None:
        grid = figure.add_gridspec(rows, min(3, len(found)))
        for nth, profile in enumerate(found):
            axes = figure.add_subplot(grid[nth // 3, nth % 3])
            _profile(axes, profile)
            unit = _PARAMETERS[profile.name].unit
            axes.set_title(parameter_name(profile.name), loc="left", fontweight="bold")
            axes.set_xlabel("value, no unit" if unit == "-" else f"value, {unit}", color=SOFT_COLOUR)
            if nth % 3 == 0:
                axes.set_ylabel("rise of the objective\nover the 95 % limit, no unit", color=SOFT_COLOUR)

    return drawn(_WIDTH_IN if len(found) > 1 else 5.2, 2.5 * rows, fill)


def subjects(estimates: Sequence[Sequence[Estimate]]) -> Any:
    """Estimates of many subjects side by side, a row for each parameter and a number for each subject."""

    def fill(figure: Any) -> None:
        axes = figure.add_subplot()
        step = 0.7 / max(len(estimates), 1)
        for row, parameter in enumerate(PARAMETERS):
            axes.axhspan(row - 0.42, row + 0.42, color="#f4f6f8" if row % 2 else "white", zorder=0)
            for nth, of_subject in enumerate(estimates):
                at = row - 0.35 + (nth + 0.5) * step
                for estimate in of_subject:
                    if estimate.name == parameter.name:
                        _interval(axes, estimate, at, size=3.5)
                        right = place(parameter.name, estimate.upper)
                        axes.text(right + 0.008, at, str(nth + 1), va="center", fontsize=5.5, color=SOFT_COLOUR)
        axes.set_yticks(range(len(PARAMETERS)), [parameter_name(parameter.name) for parameter in PARAMETERS])
        axes.set_ylim(len(PARAMETERS) - 0.5, -0.5)
        axes.set_xlim(-0.03, 1.05)
        axes.set_xlabel(_PLACE, color=SOFT_COLOUR)
        axes.grid(visible=False, axis="y")
        axes.tick_params(length=2.5, width=0.6)

    return drawn(_WIDTH_IN, 1.0 + len(PARAMETERS) * max(0.3, min(0.09 * len(estimates), 1.2)), fill)


def _interval(axes: Any, estimate: Estimate, row: float, size: float = 5.5) -> None:
    """One estimate; a parameter on its bound has no interval of its own."""
    ends = [place(estimate.name, value) for value in (estimate.lower, estimate.upper)]
    if not estimate.at_bound:
        axes.plot(ends, [row, row], color=ESTIMATE_COLOUR, lw=0.4 * size, solid_capstyle="butt", zorder=2)
    marker = MARKERS["on its bound" if estimate.at_bound else estimate.identifiability]
    axes.plot(place(estimate.name, estimate.value), row, color=ESTIMATE_COLOUR, ms=size, ls="none", zorder=3,
              markeredgewidth=0.9, **marker)  # fmt: skip


def _label(estimate: Estimate) -> str:
    unit = "" if estimate.unit == "-" else f" {estimate.unit}"
    if estimate.at_bound:
        return f"{number(estimate.value)}{unit}, on its bound"
    value, lower, upper = with_interval(estimate.value, estimate.lower, estimate.upper)
    return f"{value} ({lower} to {upper}){unit}, {estimate.identifiability}"


def _profile(axes: Any, profile: Profile) -> None:
    """Rises in multiples of the 95 % limit, and the interval where they are below it."""
    rise = profile.rise / profile.threshold
    axes.plot(profile.values, np.minimum(rise, 4.0), color=ESTIMATE_COLOUR, lw=1.3, marker="o", ms=3.0)
    axes.axhline(1.0, color=SOFT_COLOUR, lw=0.9, ls=(0, (3, 2)))
    for end, left in ((profile.lower, True), (profile.upper, False)):
        if end is None:
            axes.text(0.02 if left else 0.98, 0.94, "open", transform=axes.transAxes, fontsize=7.5, va="top",
                      ha="left" if left else "right", color=PREDICTED_COLOUR)  # fmt: skip
        else:
            axes.axvline(end, color=PREDICTED_COLOUR, lw=0.9, ls=(0, (1.0, 1.4)))
    axes.set_ylim(-0.1, 1.08 * max(1.2, min(4.0, float(rise.max()))))
    axes.tick_params(length=2.5, width=0.6)
